"""Laws of the stop of everybody."""

import asyncio
import tempfile
import time
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Refusal, Stage, StimulationAction
from firmware_protocol.messages import Action, StimulationResult
from firmware_protocol.units import EVERYBODY, NS_PER_S, NodeId
from gateway.journal_file import JournalWrite
from gateway.radio import Fate, RadioOutcome
from gateway.stimulation.parts import stop_of
from gateway.stimulation.stop_all import REACHABLE_NS
from tests.gateway.fake_air import PATIENT, QUICK, Site, a_command, a_site, remember
from tests.gateway.fake_radio import until

_ALL = StimulationAction.STOP_ALL


async def _heard(site: Site, *, command_id: str = "all") -> tuple[list[CommandStage], list[CommandStage]]:
    """Stop everybody; return the stages of the whole, and those of its parts."""
    parts: list[CommandStage] = []
    site.gate.listen(lambda _request, stage: parts.append(stage) if stage.part_of else None)
    return await site.stages(EVERYBODY, _ALL, command_id=command_id), parts


def test_everybody_is_told_at_once_and_then_each_those_under_control_first(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 21), controlled=lambda: (NodeId(17), NodeId(4))) as site:
            site.air.n_radios = 2
            stages, parts = await _heard(site)
            assert [stage.stage for stage in stages] == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
            assert "all 20 biobots" in stages[-1].reason
            frames = site.air.frames
            assert [frame.node for frame in frames[:5]] == [None, None, 17, 4, 1]
            assert len({frame.message.command for frame in frames}) == 1, "one number: who heard several obeys once"
            assert all(frame.is_urgent and frame.message.action is Action.STOP for frame in frames)
            assert all(frame.message.duration_ms == 0 for frame in frames), "no train"
            assert {stage.node for stage in parts if stage.stage is Stage.BIOBOT_CONFIRMED} == set(range(1, 21))
            assert {stage.part_of for stage in parts} == {"all"}
            again = await site.stages(EVERYBODY, _ALL, command_id="all")
            assert again == stages, "a repeated id is answered, not obeyed"

    asyncio.run(story())


def test_a_biobot_that_answers_the_broadcast_is_not_sent_to_again(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 21)) as site:
            site.air.answers = lambda _node, _n: False
            stopping = asyncio.ensure_future(_heard(site))
            await until(lambda: bool(site.air.frames), what="the broadcast")
            for node in range(1, 21):
                site.air.reply(node, site.air.frames[0].message)
            stages, parts = await stopping
            assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
            assert sum(stage.is_final for stage in parts) == 20
            assert len(site.air.sent_to(20)) <= 1

    asyncio.run(story())


def test_who_does_not_confirm_is_named(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 21), config=QUICK) as site:
            site.air.answers = lambda node, _n: node > 12
            stages, parts = await _heard(site)
            assert stages[-1].stage is Stage.UNKNOWN
            assert "12 of 20 biobots within reach did not confirm: 1, 2, 3, 4, 5, 6, 7, 8, 9, 10 and 2 more" in stages[-1].reason
            assert sum(stage.stage is Stage.UNKNOWN for stage in parts) == 12
            assert len(site.air.sent_to(1)) == 3, "again and again"
            assert len([frame for frame in site.air.frames if frame.node is None]) == 3
            ends = [stage.node for stage in parts if stage.is_final]
            assert len(ends) == len(set(ends)) == 20, "each has one end"

    asyncio.run(story())


def test_whoever_an_earlier_process_heard_of_late_is_within_reach_and_sent_to_until_it_confirms(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", config=QUICK) as site:
            remember(site, 1, 2)
            site.air.answers = lambda _node, _n: False
            stages, parts = await _heard(site)
            assert stages[-1].stage is Stage.UNKNOWN
            assert "2 of 2 biobots within reach did not confirm: 1, 2" in stages[-1].reason
            assert [len(site.air.sent_to(node)) for node in (1, 2)] == [3, 3]
            assert {stage.reason for stage in parts if stage.is_final} == {"no answer to 3 stops and 3 broadcasts; look at the animal"}
            site.air.answers = lambda _node, n_sent: n_sent == 5
            stages, _ = await _heard(site, command_id="more")
            assert (stages[-1].stage, stages[-1].reason) == (Stage.BIOBOT_CONFIRMED, "all 2 biobots within reach have confirmed")

    asyncio.run(story())


@pytest.mark.parametrize("is_answered", [False, True])
def test_who_was_not_heard_of_late_has_the_time_of_an_answer_and_nobody_confirms_for_it(tmp_path: Path, is_answered: bool) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", config=PATIENT) as site:
            old_ns = time.monotonic_ns() - REACHABLE_NS - 1
            remember(site, 1, 2, heard_ns={NodeId(1): old_ns, NodeId(2): old_ns})
            site.air.answers = lambda node, _n: is_answered and node == 1
            stages, parts = await _heard(site)
            assert [len(site.air.sent_to(node)) for node in (1, 2)] == [1, 1]
            (accepted,) = (stage for stage in parts if stage.node == 2 and stage.stage is Stage.ACCEPTED)
            (end,) = (stage for stage in parts if stage.node == 2 and stage.is_final)
            assert (end.stage, end.reason) == (Stage.UNKNOWN, "no answer to 1 stop and 1 broadcast; look at the animal")
            assert end.wall_ns - accepted.wall_ns >= PATIENT.stop_retry_s * NS_PER_S
            if is_answered:
                assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
                assert (
                    stages[-1].reason
                    == "all 1 biobots within reach have confirmed; 1 others were not heard of late, and did not confirm either: 2"
                )
            else:
                assert stages[-1].stage is Stage.UNKNOWN
                assert "nobody has confirmed: none of 1, 2 was heard of late" in stages[-1].reason

    asyncio.run(story())


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=6))
@settings(max_examples=15)
def test_that_all_have_confirmed_is_never_said_where_nobody_has(biobots: list[tuple[bool, bool]]) -> None:
    """Each biobot: whether it was heard of late, and whether it answers."""
    numbered = dict(enumerate(biobots, start=1))

    async def story(path: Path) -> None:
        async with a_site(path, config=QUICK) as site:
            now_ns = time.monotonic_ns()
            remember(
                site, *numbered, heard_ns={NodeId(n): now_ns - 2 * REACHABLE_NS for n, (is_near, _) in numbered.items() if not is_near}
            )
            site.air.answers = lambda node, _n: numbered[node][1]
            stages, parts = await _heard(site)
            confirmed = {stage.node for stage in parts if stage.stage is Stage.BIOBOT_CONFIRMED}
            assert confirmed == {n for n, (_, answers) in numbered.items() if answers}
            near = {n for n, (is_near, _) in numbered.items() if is_near}
            is_sure = near <= confirmed and bool(confirmed or not numbered)
            assert stages[-1].stage is (Stage.BIOBOT_CONFIRMED if is_sure else Stage.UNKNOWN)
            assert all(str(n) in stages[-1].reason for n in numbered if n not in confirmed and not is_sure)

    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(story(Path(folder) / "j"))


def test_where_a_radio_goes_down_the_real_number_of_frames_is_told_and_why(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", 1, config=QUICK) as site:

            def goes_down(_node: NodeId, _n: int) -> bool:
                site.air.is_down = True
                return False

            site.air.answers = goes_down
            _, parts = await _heard(site)
            assert parts[-1].stage is Stage.UNKNOWN
            assert "no answer to 1 stop and 1 broadcast; radio r0 takes nothing now: it is not connected; look at" in parts[-1].reason
            site.air.is_down = False
            stages = await site.stages(1, StimulationAction.STOP)
            assert "no answer to 1 stop; radio r takes nothing now: it is not connected; look at the animal" in stages[-1].reason
            stages = await site.stages(1, StimulationAction.STOP)
            assert stages[-1].stage is Stage.FAILED
            assert "nothing could be sent; radio r takes nothing now: it is not connected; look at the animal" in stages[-1].reason

    asyncio.run(story())


def test_who_is_unwilling_or_left_to_newer_stops_has_not_confirmed(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", 5, 6, config=QUICK) as site:
            site.air.answers = lambda node, _n: node == 6
            stopping = asyncio.ensure_future(_heard(site))
            await until(lambda: bool(site.air.sent_to(5)), what="it is sent to")
            newer = [asyncio.ensure_future(site.stages(5, StimulationAction.STOP)) for _ in range(9)]
            stages, _ = await stopping
            assert stages[-1].stage is Stage.UNKNOWN
            assert "1 of 2 biobots within reach did not confirm: 5" in stages[-1].reason
            await asyncio.gather(*newer)
            site.air.answers = lambda _node, _n: True
            site.air.result = StimulationResult.REFUSED_LIMIT
            stages, _ = await _heard(site, command_id="more")
            assert stages[-1].stage is Stage.UNKNOWN
            assert "2 of 2" in stages[-1].reason

    asyncio.run(story())


def test_of_many_the_newest_alone_goes_on_from_biobot_to_biobot(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 41), config=PATIENT) as site:
            site.air.answers = lambda _node, _n: False
            first = asyncio.ensure_future(site.stages(EVERYBODY, _ALL))
            await until(lambda: bool(site.air.sent_to(1)), what="the first is under way")
            site.air.answers = lambda _node, _n: True
            ends = await asyncio.gather(first, *(site.stages(EVERYBODY, _ALL) for _ in range(50)))
            assert ends[-1][-1].stage is Stage.BIOBOT_CONFIRMED
            assert all(stages[-1].stage is Stage.UNKNOWN and "a newer stop of all" in stages[-1].reason for stages in ends[:-1])
            numbers = [frame.message.command for frame in site.air.frames if frame.node is None]
            assert len(set(numbers)) == 51, "each has told everybody"
            assert {frame.message.command for frame in site.air.frames if frame.node is not None} <= {numbers[0], numbers[-1]}
            assert not site.gate._book.running()

    asyncio.run(story())


def test_one_that_gives_way_before_it_sent_to_a_biobot_takes_its_answer_to_the_broadcast_all_the_same(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 7), config=PATIENT) as site:
            site.air.stuck = {"r0"}
            site.air.answers = lambda _node, _n: False

            def has_its_parts(name: str) -> bool:
                return sum(one.part_of == name for one in site.gate._book.running()) == 6

            stopping: list[asyncio.Task[list[CommandStage]]] = []
            for name in ("first", "second", "third"):
                stopping.append(asyncio.ensure_future(site.stages(EVERYBODY, _ALL, command_id=name)))
                await until(partial(has_its_parts, name), what="it has its parts")
            broadcasts = [frame.message for frame in site.air.frames if frame.node is None]
            first, second = await asyncio.gather(*stopping[:2])
            for message in broadcasts:
                for node in range(1, 7):
                    site.air.reply(node, message)
            third = await stopping[-1]
            assert [stages[-1].stage for stages in (first, second)] == [Stage.UNKNOWN] * 2
            assert all("a newer stop of all" in stages[-1].reason for stages in (first, second))
            assert third[-1].stage is Stage.BIOBOT_CONFIRMED
            assert site.health.counters()["command.late_replies"] >= 12
            assert "command.broken" not in site.health.counters()

    asyncio.run(story())


def test_a_radio_gets_the_next_frames_when_it_has_sent_those_before_and_holds_no_other_up(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", *range(1, 41), config=PATIENT) as site:
            site.air.n_radios, site.air.stuck = 2, {"r1"}
            stopping = asyncio.ensure_future(_heard(site))
            await until(lambda: len({frame.node for frame in site.air.frames if frame.radio == "r0"}) == 20, what="one radio has told all")
            held = [frame for frame in site.air.frames if frame.radio == "r1" and frame.node is not None]
            assert [frame.node for frame in held] == [1, 3, 5], "the other was given no more than it may hold"
            site.air.stuck.clear()
            for frame in held:
                assert frame.node is not None
                frame.sending.set_result(RadioOutcome(fate=Fate.SENT))
                site.air.reply(frame.node, frame.message)
            stages, _ = await stopping
            assert "all 40 biobots" in stages[-1].reason

    asyncio.run(story())


def test_without_a_biobot_the_broadcast_is_all_and_without_a_radio_it_fails(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", config=QUICK) as site:
            stages, _ = await _heard(site)
            assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
            site.air.fate = Fate.UNKNOWN
            assert (await site.stages(EVERYBODY, _ALL))[-1].stage is Stage.UNKNOWN
            site.air.is_down = True
            failed = (await site.stages(EVERYBODY, _ALL))[-1]
            assert failed.stage is Stage.FAILED
            assert "no radio is up" in failed.reason
        async with a_site(tmp_path / "k", 1, 2, config=QUICK) as site:
            site.air.is_down = True
            stages, parts = await _heard(site)
            assert stages[-1].stage is Stage.FAILED
            assert "not connected" in stages[-1].reason
            assert [stage.stage for stage in parts if stage.is_final] == [Stage.FAILED] * 2

    asyncio.run(story())


def test_it_keeps_all_that_waits_from_being_sent(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", 1, 2, 3) as site:
            waiting = [asyncio.ensure_future(site.stages(node, StimulationAction.START)) for node in (1, 2, 3)]
            await asyncio.sleep(0)
            stages, _ = await _heard(site)
            assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
            assert [(await one)[-1].refusal for one in waiting] == [Refusal.OVERTAKEN] * 3
            assert {frame.message.action for frame in site.air.frames} == {Action.STOP}

    asyncio.run(story())


def test_it_works_on_a_full_disk(tmp_path: Path) -> None:
    async def story() -> None:
        async with a_site(tmp_path / "j", 1, 2) as site:
            connection = site.journal._file._connection
            (n_pages,) = connection.execute("PRAGMA page_count").fetchone()
            connection.execute(f"PRAGMA max_page_count = {n_pages}")
            site.journal.append(JournalWrite(node=(NodeId(9), bytes(1 << 20))))
            await until(lambda: site.journal.fault is not None, what="the disk is full")
            stages, _ = await _heard(site)
            assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
            connection.execute("PRAGMA max_page_count = 1000000")

    asyncio.run(story())


@given(st.text("abcXYZ019._-", min_size=1, max_size=64), st.integers(0, 0xFFFE))
def test_the_parts_have_ids_of_their_own_that_are_fit_to_be_ids(command_id: str, node: int) -> None:
    part = stop_of(a_command(EVERYBODY, _ALL, command_id=command_id), NodeId(node), suffix=str(node))
    assert 1 <= len(part.command_id) <= 64
    assert part.command_id != command_id
    assert part.command_id.endswith(f".{node}")
