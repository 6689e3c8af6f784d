"""Laws of the gate, on a real journal and with radios and biobots that do as the test says."""

import asyncio
import itertools
import sqlite3
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from msgspec.structs import replace

from firmware_protocol.contract.commands import CommandStage, PulseRequest, Refusal, Stage, StimulationAction, StimulationRequest
from firmware_protocol.contract.records import Mode
from firmware_protocol.messages import Action, Capability, Hello, StimulateReply, StimulationResult, WireMode
from firmware_protocol.units import EVERYBODY, Milliseconds, Nanoseconds, NodeId
from gateway.config import StimulationTable
from gateway.journal_file import JournalReader, JournalWrite
from gateway.radio import Fate
from tests.gateway.fake_air import PATIENT, QUICK, Frame, Site, a_command, a_site, remember
from tests.gateway.fake_radio import until

_STOP, _START, _LEFT = StimulationAction.STOP, StimulationAction.START, StimulationAction.TURN_LEFT
_NO_TRAIN = PulseRequest(duration_ms=0)


def _run(
    path: Path,
    *nodes: int,
    story: Callable[[Site], Awaitable[None]],
    is_killed: bool = False,
    config: StimulationTable = PATIENT,
) -> None:
    async def run() -> None:
        async with a_site(path, *(nodes or (5,)), is_killed=is_killed, config=config) as site:
            await story(site)

    asyncio.run(run())


def _told(stages: list[CommandStage]) -> list[Stage]:
    return [stage.stage for stage in stages]


def test_a_command_for_a_number_no_biobot_can_have_is_refused_and_harms_nobody(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        for node in (0xFFFF, 1 << 63, (1 << 64) - 1):
            for action in (_START, _STOP):
                (stage,) = await site.stages(node, action)
                assert (stage.stage, stage.refusal) == (Stage.REFUSED, Refusal.UNKNOWN_BIOBOT)
                assert "not known" in stage.reason
        assert _told(await site.stages(5, _STOP))[-1] is Stage.BIOBOT_CONFIRMED
        assert len(site.air.frames) == 1

    _run(tmp_path / "j", story=story)


def test_a_stop_has_a_train_in_its_first_frame_alone_and_what_follows_waits_for_it(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.n_elsewhere = 1
        site.air.answers = lambda _node, n_sent: n_sent >= 5
        stages = await site.stages(5, _STOP, command_id="stop")
        assert _told(stages) == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
        sent = site.air.sent_to(5)
        assert [message.duration_ms for message in sent] == [500, *[0] * (len(sent) - 1)]
        assert len(sent) >= 5, "over both radios, again and again"
        assert len({message.command for message in sent}) == 1
        (refused,) = await site.stages(5, _START)
        assert refused.refusal is Refusal.GAP
        again = await site.stages(5, _STOP)
        assert _told(again)[-1] is Stage.BIOBOT_CONFIRMED, "a stop is never refused"
        assert site.air.sent_to(5)[-1].duration_ms == 0, "but where no train is admitted, it has none"

    _run(tmp_path / "j", story=story)


def test_what_was_given_counts_after_a_restart_whatever_is_done_to_the_wall_clock(tmp_path: Path) -> None:
    async def give(site: Site) -> None:
        assert _told(await site.stages(5, _START, command_id="start"))[-1] is Stage.BIOBOT_CONFIRMED

    async def ask_a_year_later() -> None:
        async with a_site(tmp_path / "j", 5, wall_clock=lambda: time.time_ns() + 365 * 86_400 * 10**9) as site:
            stages = await site.stages(5, _START, command_id="start")
            assert _told(stages) == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED], "answered, and not obeyed"
            late = a_command(5, _START)
            heard: list[CommandStage] = []
            await site.gate.handle(replace(late, issued_wall_ns=Nanoseconds(late.issued_wall_ns + 365 * 86_400 * 10**9)), heard.append)
            assert heard[-1].refusal is Refusal.GAP
            assert site.air.frames == []

    _run(tmp_path / "j", story=give)
    asyncio.run(ask_a_year_later())


def test_after_a_kill_no_biobot_gets_a_train_before_one_that_is_not_on_record_must_be_over(tmp_path: Path) -> None:
    async def nothing(_: Site) -> None:
        pass

    async def ask(site: Site) -> None:
        (refused,) = await site.stages(5, _START)
        assert refused.refusal is Refusal.GAP
        assert "not stopped in good order" in refused.reason
        assert _told(await site.stages(5, _STOP))[-1] is Stage.BIOBOT_CONFIRMED
        assert site.air.sent_to(5)[-1].duration_ms == 0

    async def start(site: Site) -> None:
        assert _told(await site.stages(5, _START))[-1] is Stage.BIOBOT_CONFIRMED

    _run(tmp_path / "j", story=nothing)
    _run(tmp_path / "j", story=start)
    _run(tmp_path / "k", story=nothing, is_killed=True)
    _run(tmp_path / "k", story=ask)


def test_no_number_on_the_wire_is_used_by_two_processes(tmp_path: Path) -> None:
    numbers: list[int] = []

    async def stop(site: Site) -> None:
        await site.stages(5, _STOP)
        numbers.append(site.air.frames[0].message.command)

    for _ in range(3):
        _run(tmp_path / "j", story=stop, is_killed=True)
    assert numbers[1] - numbers[0] > 1_000, "stops that did not come to disk had numbers too"
    assert numbers[2] > numbers[1]


def test_a_stop_is_sent_where_the_journal_cannot_be_read_and_nothing_else_is(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        assert isinstance(site.gate._reader, JournalReader)
        site.gate._reader.close()
        (stage,) = await site.stages(5, _LEFT)
        assert stage.refusal is Refusal.JOURNAL
        assert "cannot be read" in stage.reason
        assert site.air.frames == []
        assert _told(await site.stages(5, _STOP))[-1] is Stage.BIOBOT_CONFIRMED
        assert len(site.air.frames) == 1

    _run(tmp_path / "j", story=story)


def test_a_fault_in_one_command_ends_that_command_alone(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.is_broken = True
        stage = (await site.stages(5, _STOP))[-1]
        assert stage.stage is Stage.UNKNOWN
        assert "nobody thought of" in stage.reason
        site.air.is_broken = False
        assert _told(await site.stages(5, _STOP))[-1] is Stage.BIOBOT_CONFIRMED

    _run(tmp_path / "j", story=story)


def test_a_listener_that_fails_keeps_no_stop_from_its_end(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        heard: list[Stage] = []

        def fail(_: object) -> None:
            raise ValueError("not me")

        site.gate.listen(lambda _request, stage: fail(stage))
        site.gate.listen(lambda _request, stage: heard.append(stage.stage))
        site.gate.listen_to_accounts(fail)
        await site.gate.handle(a_command(5, _STOP), fail)
        assert heard == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
        assert site.health.counters()["command.broken_listener"] >= 6

    _run(tmp_path / "j", story=story)


def test_a_stop_whose_train_is_beyond_a_limit_says_that_it_has_none_and_why(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        accepted, *_, last = await site.stages(5, _STOP, pulse=PulseRequest(amplitude_mv=60_000))
        assert last.stage is Stage.BIOBOT_CONFIRMED
        assert accepted.reason.startswith("it is stopped without a train: it asks for amplitude_mv = 60000 mV, but")
        assert site.air.frames[-1].message.duration_ms == 0
        accepted, *_ = await site.stages(5, _STOP)
        assert accepted.reason == ""
        assert site.air.frames[-1].message.duration_ms > 0
        accepted, *_ = await site.stages(5, _STOP)
        assert "it is stopped without a train: " in accepted.reason, "too soon after the one before"

    _run(tmp_path / "j", story=story)


def test_a_biobot_not_heard_since_the_start_is_stopped_and_never_stimulated(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        remember(site, 6)
        for action in (_START, _LEFT, StimulationAction.TURN_RIGHT):
            (refused,) = await site.stages(6, action)
            assert refused.refusal is Refusal.UNFIT_BIOBOT
            assert "not heard since the gateway started" in refused.reason
        assert site.air.frames == []
        assert _told(await site.stages(6, _STOP))[-1] is Stage.BIOBOT_CONFIRMED

    _run(tmp_path / "j", story=story)


def test_walls_are_followed_without_a_train_unless_one_is_asked_for_and_by_nobody_who_cannot(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        walls = StimulationAction.FOLLOW_WALLS
        for node, capabilities in ((5, Capability.STIMULATION | Capability.FOLLOW_WALLS), (6, Capability.STIMULATION)):
            known = site.nodes.find(NodeId(node))
            assert known is not None
            site.nodes.introduce(known, Hello(eui64=node, firmware=1, beacon_period_ms=0, capabilities=capabilities))
        for node in (6, 7):  # one says that it cannot, one has said nothing
            (refused,) = await site.stages(node, walls)
            assert refused.refusal is Refusal.UNFIT_BIOBOT
            assert "follow walls" in refused.reason
        assert site.air.frames == []
        assert _told(await site.stages(5, walls))[-1] is Stage.BIOBOT_CONFIRMED
        assert _told(await site.stages(5, walls, pulse=PulseRequest(duration_ms=300)))[-1] is Stage.BIOBOT_CONFIRMED
        (refused,) = await site.stages(5, walls, pulse=PulseRequest(duration_ms=300))
        assert refused.refusal is Refusal.GAP, "a train is a train"
        assert _told(await site.stages(5, walls))[-1] is Stage.BIOBOT_CONFIRMED, "what gives none waits for none"
        assert [(one.action, one.duration_ms) for one in site.air.sent_to(5)] == [(Action.FOLLOW_WALLS, ms) for ms in (0, 300, 0)]

    _run(tmp_path / "j", 5, 6, 7, story=story)


def test_a_commander_that_is_not_there_gets_nothing_but_stops(tmp_path: Path) -> None:
    async def story() -> None:
        there = {"anna"}
        async with a_site(tmp_path / "j", 5, 6, is_commander_there=there.__contains__) as site:
            assert (await site.stages(5, _LEFT, commander="bert", hold_ms=1_000))[-1].refusal is Refusal.NO_COMMANDER
            (endless,) = await site.stages(5, _LEFT, commander="anna")
            assert endless.refusal is Refusal.NO_HOLD
            assert "'anna'" in endless.reason
            assert not site.air.frames
            assert _told(await site.stages(5, _LEFT, commander="anna", hold_ms=1_000))[-1] is Stage.BIOBOT_CONFIRMED
            assert _told(await site.stages(6, _STOP, commander="bert"))[-1] is Stage.BIOBOT_CONFIRMED

    asyncio.run(story())


def test_a_turn_of_nothing_is_refused_and_says_what_is_missing(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        for pulse, missing in ((PulseRequest(duration_ms=0), "duration_ms is 0"), (PulseRequest(amplitude_mv=0), "amplitude_mv is 0")):
            (refused,) = await site.stages(5, _LEFT, pulse=pulse)
            assert refused.refusal is Refusal.PULSE
            assert missing in refused.reason
        assert not site.air.frames

    _run(tmp_path / "j", story=story)


def test_a_command_gives_its_own_pulse_within_the_limits(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        (refused,) = await site.stages(5, _LEFT, pulse=PulseRequest(frequency_hz=80))
        assert refused.refusal is Refusal.PULSE
        await site.stages(5, _LEFT, pulse=PulseRequest(frequency_hz=55, duration_ms=100))
        (sent,) = site.air.sent_to(5)
        assert (sent.frequency_hz, sent.duration_ms, sent.amplitude_mv) == (55, 100, QUICK.amplitude_mv)
        account = site.gate.account_of(NodeId(5))
        assert account is not None
        assert (account.n_trains, account.on_ms, account.n_refused, account.n_commands) == (1, 100, 1, 2)

    _run(tmp_path / "j", story=story)


def test_every_stage_but_the_last_says_by_when_the_next_one_comes_and_keeps_to_it(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        for fate, last in ((Fate.SENT, "the radio has sent it"), (Fate.NO_ACK, "no answer within")):
            site.air.fate = fate
            node = 5 if fate is Fate.SENT else 6
            stages = await site.stages(node, _START)
            assert stages[-1].stage is Stage.UNKNOWN
            assert last in stages[-1].reason
            assert all(stage.operator == "tester" for stage in stages)
            for before, after in itertools.pairwise(stages):
                assert before.deadline_wall_ns is not None
                assert after.wall_ns <= before.deadline_wall_ns + 10**9, "the machine may be busy"
            assert stages[-1].deadline_wall_ns is None
            assert len(site.air.sent_to(node)) == 1, "never sent again"

    _run(tmp_path / "j", 5, 6, story=story, config=QUICK)


def test_a_stop_overtakes_what_waits_for_the_disk_or_for_the_line(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        waiting = asyncio.ensure_future(site.stages(5, _START, command_id="for-the-disk"))
        await asyncio.sleep(0)
        assert site.air.frames == []
        stopping = asyncio.ensure_future(site.stages(5, _STOP))
        (overtaken,) = await waiting
        assert (overtaken.stage, overtaken.refusal) == (Stage.REFUSED, Refusal.OVERTAKEN)
        assert _told(await stopping)[-1] is Stage.BIOBOT_CONFIRMED
        site.air.is_stuck = True
        heard: list[CommandStage] = []
        unwritten = asyncio.ensure_future(site.gate.handle(a_command(6, _START), heard.append))
        await until(lambda: bool(heard), what="it is on disk, and its frame waits")
        stopping = asyncio.ensure_future(site.stages(6, _STOP))
        await unwritten
        assert _told(heard) == [Stage.ACCEPTED, Stage.REFUSED]
        assert heard[-1].refusal is Refusal.OVERTAKEN
        site.air.is_stuck = False
        assert _told(await stopping)[-1] is Stage.BIOBOT_CONFIRMED
        assert {frame.message.action.name for frame in site.air.frames if _is_sent(frame)} == {"STOP"}
        assert [frame.n_waiting for frame in site.air.frames if frame.is_urgent][:2] == [0, 0], (
            "a port may take at once what waits behind it"
        )
        for node in (5, 6):
            account = site.gate.account_of(NodeId(node))
            assert account is not None
            assert account.n_trains == account.n_trains_in_window <= 1, "a train that was taken back counts nowhere"

    _run(tmp_path / "j", 5, 6, story=story)


def _is_sent(frame: Frame) -> bool:
    return frame.sending.done() and frame.sending.result().fate is Fate.SENT


def test_a_frame_that_the_line_does_not_take_is_taken_back_with_its_train(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.fate = Fate.NOT_SENT
        stages = await site.stages(5, _START)
        assert _told(stages) == [Stage.ACCEPTED, Stage.FAILED]
        site.air.fate = Fate.SENT
        assert _told(await site.stages(5, _START))[-1] is Stage.BIOBOT_CONFIRMED, "no train was given, so none must be waited for"

    _run(tmp_path / "j", story=story)


def test_what_the_backpack_refuses_gave_no_train(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.result = StimulationResult.REFUSED_LIMIT
        assert _told(await site.stages(5, _START))[-1] is Stage.FAILED
        site.air.result = StimulationResult.DONE
        assert _told(await site.stages(5, _START))[-1] is Stage.BIOBOT_CONFIRMED

    _run(tmp_path / "j", story=story)


def test_an_answer_after_the_last_stage_is_put_on_record_and_changes_no_outcome(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        assert _told(await site.stages(5, _START, command_id="late"))[-1] is Stage.UNKNOWN
        before = site.gate.account_of(NodeId(5))
        site.air.reply(5, site.air.frames[0].message)
        assert _told(await site.stages(5, _START, command_id="late"))[-1] is Stage.UNKNOWN
        after = site.gate.account_of(NodeId(5))
        assert before is not None
        assert after is not None
        assert (after.n_unknown, after.n_confirmed) == (1, 0)
        assert after.ready_in_ms < before.ready_in_ms + 1_000
        await site.journal.drain()
        reader = site.journal.reader()
        assert [entry.kind for entry in reader.read_audit(command_id="late")][-1] == "late_reply"
        reader.close()

    _run(tmp_path / "j", story=story, config=QUICK)


def test_a_train_that_another_biobot_got_counts_for_that_one(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        starting = asyncio.ensure_future(site.stages(5, _START))
        await until(lambda: bool(site.air.frames), what="the frame")
        site.air.reply(6, site.air.frames[0].message)
        (refused,) = await site.stages(6, _START)
        assert refused.refusal is Refusal.GAP
        assert _told(await starting)[-1] is Stage.UNKNOWN

    _run(tmp_path / "j", 5, 6, story=story, config=QUICK)


def test_a_biobot_has_no_more_commands_under_way_than_its_backpack_can_keep(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        no_train = PulseRequest(duration_ms=0)
        running = [asyncio.ensure_future(site.stages(5, _START, pulse=no_train)) for _ in range(6)]
        ends = [(await one)[-1] for one in running]
        assert sum(end.refusal is Refusal.TOO_MANY for end in ends) == 2
        stops = [asyncio.ensure_future(site.stages(5, _STOP)) for _ in range(20)]
        ends = [(await one)[-1] for one in stops]
        assert all(end.stage is Stage.UNKNOWN for end in ends)
        assert sum("newer stops" in end.reason for end in ends) == 12, "a stop is sent all the same, and takes the oldest one's place"
        assert len([frame for frame in site.air.frames if frame.message.action.name == "STOP"]) >= 20

    _run(tmp_path / "j", story=story, config=QUICK)


def test_a_stop_with_the_id_of_another_command_stops_all_the_same(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        assert _told(await site.stages(5, _START, command_id="one"))[-1] is Stage.BIOBOT_CONFIRMED
        assert _told(await site.stages(5, _STOP, command_id="one"))[-1] is Stage.BIOBOT_CONFIRMED
        assert (await site.stages(5, _LEFT, command_id="one"))[-1].refusal is Refusal.ID_REUSED
        assert [message.action.name for message in site.air.sent_to(5)] == ["START", "STOP"]

    _run(tmp_path / "j", story=story)


def test_what_was_issued_before_a_stop_moves_nobody_after_it_over_a_restart_too(tmp_path: Path) -> None:
    older = [a_command(node, _START) for node in (5, 5, 6, 6)]

    async def stop(site: Site) -> None:
        for action, node, late in ((_STOP, 5, older[0]), (StimulationAction.STOP_ALL, EVERYBODY, older[2])):
            await site.stages(node, action, pulse=_NO_TRAIN)
            refused = await _told_of(site, late)
            assert refused.refusal is Refusal.OVERTAKEN
            assert "before a stop of this biobot" in refused.reason
        assert {frame.message.action.name for frame in site.air.frames} == {"STOP"}

    async def wait(site: Site) -> None:
        for late in (older[1], older[3]):
            assert (await _told_of(site, late)).refusal is Refusal.OVERTAKEN
        assert site.air.frames == []
        assert (await site.stages(5, _START, pulse=_NO_TRAIN))[-1].stage is Stage.BIOBOT_CONFIRMED, "what is issued now moves"

    _run(tmp_path / "j", 5, 6, story=stop)
    _run(tmp_path / "j", 5, 6, story=wait)


def test_what_came_in_before_a_stop_moves_nobody_after_it_whatever_its_clock_says(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        came_ns = time.monotonic_ns()
        await site.stages(5, _STOP, pulse=_NO_TRAIN)
        heard: list[CommandStage] = []
        await site.gate.handle(a_command(5, _START), heard.append, came_ns=came_ns)
        assert heard[-1].refusal is Refusal.OVERTAKEN
        ahead = replace(a_command(6, _STOP), issued_wall_ns=Nanoseconds(time.time_ns() + 3_600 * 10**9))
        await site.gate.handle(replace(ahead, pulse=_NO_TRAIN), heard.append)
        assert _told(await site.stages(6, _START))[-1] is Stage.BIOBOT_CONFIRMED, "a stop of a clock that is ahead is of now"

    _run(tmp_path / "j", 5, 6, story=story)


def test_a_stop_that_is_given_anew_under_its_id_stops_whoever_was_moved_since(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        for _ in range(2):
            assert _told(await site.stages(5, _STOP, command_id="panic", pulse=_NO_TRAIN))[-1] is Stage.BIOBOT_CONFIRMED
        assert len(site.air.frames) == 1, "nobody was moved since: it is answered"
        await site.stages(5, _START)
        again = a_command(5, _STOP, command_id="panic", pulse=_NO_TRAIN)
        assert (await _told_of(site, again)).stage is Stage.BIOBOT_CONFIRMED
        assert [frame.message.action.name for frame in site.air.frames] == ["STOP", "START", "STOP"]

    _run(tmp_path / "j", story=story)


def test_whom_nobody_looks_after_any_more_is_not_moved_by_what_waited_for_the_disk(tmp_path: Path) -> None:
    async def story() -> None:
        there = {"anna"}
        async with a_site(tmp_path / "j", 5, 6, is_commander_there=there.__contains__) as site:
            waiting = asyncio.ensure_future(site.stages(5, _START, commander="anna", hold_ms=1_000))
            await asyncio.sleep(0)
            there.clear()
            assert (await waiting)[-1].refusal is Refusal.NO_COMMANDER
            waiting = asyncio.ensure_future(site.stages(6, _START))
            await asyncio.sleep(0)
            site.gate.begin_stopping()
            assert (await waiting)[-1].refusal is Refusal.STOPPING
            assert site.air.frames == []

    asyncio.run(story())


def test_a_stop_ends_with_an_answer_that_is_not_on_disk_and_a_start_does_not(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        running = {action: asyncio.ensure_future(site.stages(node, action)) for node, action in ((5, _STOP), (6, _START))}
        await until(lambda: len({frame.node for frame in site.air.frames}) == 2, what="both are sent")
        for node in (5, 6):
            reply = StimulateReply(
                command=site.air.sent_to(node)[0].command, result=StimulationResult.DONE, executed_ms=Milliseconds(1), mode=WireMode.S
            )
            site.gate.on_answer(NodeId(node), reply)
        assert _told(await running[_STOP])[-1] is Stage.BIOBOT_CONFIRMED
        assert not running[_START].done()
        site.air.reply(6, site.air.sent_to(6)[0])
        assert _told(await running[_START])[-1] is Stage.BIOBOT_CONFIRMED

    _run(tmp_path / "j", 5, 6, story=story)


def test_a_stop_once_more_that_newer_stops_replace_is_under_way_no_more(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        site.air.answers = lambda _node, _n: False
        site.air.fate = Fate.UNKNOWN
        moving = asyncio.ensure_future(site.stages(5, _START, pulse=_NO_TRAIN))
        await until(lambda: bool(site.air.frames), what="it is on its way")
        stops = [asyncio.ensure_future(site.stages(5, _STOP, pulse=_NO_TRAIN))]
        await until(lambda: any(".again-" in one.key for one in site.gate._book.running()), what="it can come no more")
        stops += [asyncio.ensure_future(site.stages(5, _STOP, pulse=_NO_TRAIN)) for _ in range(12)]
        await asyncio.gather(moving, *stops)
        await until(lambda: not site.gate._book.running(), what="nothing is under way")

    _run(tmp_path / "j", story=story, config=StimulationTable(stop_retry_s=0.1, stop_attempts=3, reply_timeout_s=0.2, flight_s=0.1))


async def _told_of(site: Site, request: StimulationRequest) -> CommandStage:
    heard: list[CommandStage] = []
    await site.gate.handle(request, heard.append)
    return heard[-1]


def test_whether_a_biobot_obeys_is_seen_by_the_mode_that_it_reports(tmp_path: Path) -> None:
    async def story() -> None:
        now_ns = time.monotonic_ns()
        ahead_ns = [0]
        async with a_site(tmp_path / "j", 5, now_ns=lambda: now_ns + ahead_ns[0]) as site:
            for after_s, mode, answerable, obeyed in ((1, Mode.S, 1, 1), (0.1, Mode.CRW, 1, 1), (1, Mode.CRW, 2, 1), (60, Mode.S, 2, 1)):
                await site.stages(5, _STOP)
                ahead_ns[0] += int(after_s * 1e9)
                site.gate.on_mode(NodeId(5), mode)
                account = site.gate.account_of(NodeId(5))
                assert account is not None
                assert (account.n_answerable, account.n_obeyed) == (answerable, obeyed)

    asyncio.run(story())


def test_a_start_that_a_stop_or_its_hold_cut_short_was_not_disobeyed(tmp_path: Path) -> None:
    async def story() -> None:
        now_ns = time.monotonic_ns()
        ahead_ns = [0]
        async with a_site(tmp_path / "j", 5, now_ns=lambda: now_ns + ahead_ns[0]) as site:
            for hold_ms, stop, after_s, answerable in ((0, StimulationAction.STOP_ALL, 1, 0), (2_000, None, 2.1, 0), (2_000, None, 1, 1)):
                ahead_ns[0] += 60 * 10**9
                assert _told(await site.stages(5, _START, hold_ms=hold_ms))[-1] is Stage.BIOBOT_CONFIRMED
                ahead_ns[0] += int(after_s * 1e9)
                if stop is not None:
                    await site.stages(EVERYBODY, stop)
                site.gate.on_mode(NodeId(5), Mode.S)
                account = site.gate.account_of(NodeId(5))
                assert account is not None
                assert (account.n_answerable, account.n_obeyed) == (answerable, 0)

    asyncio.run(story())


def test_accounts_are_the_same_after_a_restart(tmp_path: Path) -> None:
    kept = []

    async def live(site: Site) -> None:
        site.air.answers = lambda node, _n: node == 5
        await asyncio.gather(site.stages(5, _START), site.stages(6, _START), site.stages(7, _STOP), site.stages(7, _LEFT))
        await site.stages(5, _START)
        kept.extend(site.gate.accounts())

    async def look(site: Site) -> None:
        again = site.gate.accounts()
        assert [account.node for account in again] == [account.node for account in kept] == [5, 6, 7]
        for before, after in zip(kept, again, strict=True):
            for name in ("n_trains", "on_ms", "n_commands", "n_confirmed", "n_unknown", "n_refused", "last_train_wall_ns"):
                assert getattr(after, name) == getattr(before, name), name
            assert abs(after.habituation - before.habituation) < 0.01

    _run(tmp_path / "j", 5, 6, 7, story=live, config=QUICK)
    _run(tmp_path / "j", 5, 6, 7, story=look, config=QUICK)


def test_a_stop_on_a_full_disk_is_sent_at_once_and_on_record_when_there_is_room(tmp_path: Path) -> None:
    async def story(site: Site) -> None:
        connection = site.journal._file._connection
        (n_pages,) = connection.execute("PRAGMA page_count").fetchone()
        connection.execute(f"PRAGMA max_page_count = {n_pages}")
        site.journal.append(JournalWrite(node=(NodeId(9), bytes(1 << 20))))
        await until(lambda: site.journal.fault is not None, what="the disk is full")
        assert _told(await site.stages(5, _STOP, command_id="stop"))[-1] is Stage.BIOBOT_CONFIRMED
        assert _told(await site.stages(5, _STOP))[-1] is Stage.BIOBOT_CONFIRMED
        assert [message.duration_ms for message in site.air.sent_to(5)] == [500, 0], "one train that is not on disk, no more"
        assert (await site.stages(6, _START))[-1].refusal is Refusal.JOURNAL
        connection.execute("PRAGMA max_page_count = 1000000")
        await until(lambda: site.journal.fault is None, what="there is room")

    _run(tmp_path / "j", 5, 6, story=story)
    with sqlite3.connect(tmp_path / "j") as database:
        stages = [stage for (stage,) in database.execute("SELECT stage FROM audit WHERE command_id = 'stop' ORDER BY id")]
    database.close()
    assert stages == ["accepted", "radio_confirmed", "biobot_confirmed"]
