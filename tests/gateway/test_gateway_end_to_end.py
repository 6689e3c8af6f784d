"""The whole gateway between a fake dongle and a real Zenoh peer."""

import asyncio
import sqlite3
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import Cause, EncounterRecord, HistoryRequest, MissionPhase, MissionRecord, Mode, ModeRecord
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.landmarks import choose_landmarks
from firmware_protocol.messages import Action
from firmware_protocol.units import NodeId
from gateway.config import MissionTable, StimulationTable
from gateway.errors import BusError, JournalUnfitError, TransportSpecError
from gateway.journal_file import verify_audit_of
from gateway.service import Service
from tests.gateway.fake_radio import FakeDongle, a_dongle, on_pty, on_tcp, until
from tests.gateway.harness import a_config, a_request, command, history, listening, running


def _say_all(dongle: FakeDongle, n_encounters: int) -> None:
    """Each backpack says who it is, what it does, and ``n_encounters`` meetings with the next one, 2 s long and 1 s apart."""
    nodes = list(dongle.backpacks)
    for index, node in enumerate(nodes):
        backpack = dongle.backpacks[node]
        backpack.say_hello()
        backpack.say_status()
        for at in range(n_encounters):
            backpack.say_encounter(nodes[(index + 1) % len(nodes)], ago_ms=990_000 - 3_000 * at, duration_ms=2000)


def _is_level(dongle: FakeDongle) -> bool:
    return all(backpack.is_level for backpack in dongle.backpacks.values())


def _offsets(records: list[int]) -> bool:
    return sorted(records) == list(range(1, len(records) + 1))


def test_every_report_on_a_pty_arrives_once_and_is_acknowledged(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2, 3, 4, 5)
        config = a_config(tmp_path, f"serial:{tmp_path / 'dongle'}")
        with listening(config) as peer:
            async with on_pty(dongle, tmp_path / "dongle"), running(config):
                await peer.hear()
                _say_all(dongle, 20)
                await until(lambda: _is_level(dongle), what="all is acknowledged")
                await until(lambda: len(peer.of(EncounterRecord)) >= 100, what="all encounters published")
                dongle.backpacks[NodeId(1)].say_neighbours([NodeId(node) for node in range(2, 25)])
                await until(lambda: bool(peer.neighbours), what="the neighbour report")
            records = peer.of(EncounterRecord)
            assert Counter(record.identity for record in records).most_common(1)[0][1] == 1
            assert len({(record.node_a, record.node_b, record.t_start_ns // 10**9) for record in records}) == 100
            assert {record.t_end_ns - record.t_start_ns for record in records} == {2_000_000_000}
            assert _offsets([record.offset for record in peer.records])
            assert {status.node: status.mode for status in peer.node_statuses} == dict.fromkeys(range(1, 6), Mode.CRW)
            assert [entry.node for entry in peer.neighbours[-1].neighbours] == list(range(2, 25))
            assert {status.eui64 - 0xE000 for status in peer.node_statuses} == {1, 2, 3, 4, 5}

    asyncio.run(story())


def test_the_second_sides_report_is_a_revision_of_the_first(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2)
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            with listening(config) as peer:
                async with running(config):
                    one, two = dongle.backpacks.values()
                    one.say_hello()
                    two.say_hello()
                    await peer.hear()
                    one.say_encounter(NodeId(2), ago_ms=5000, duration_ms=3000)
                    said_ms = two.now_ms
                    await until(lambda: len(peer.of(EncounterRecord)) == 1, what="the first side")
                # Between the two sides' reports the gateway restarts: still one encounter, not two.
                async with running(config):
                    await peer.hear()
                    two.say_encounter(NodeId(1), ago_ms=5500 + two.now_ms - said_ms, duration_ms=3400)
                    await until(lambda: len(peer.of(EncounterRecord)) == 2, what="the other side")
        first, second = peer.of(EncounterRecord)
        assert first.identity == second.identity
        assert (first.revision, second.revision) == (0, 1)
        assert (first.is_reciprocal, second.is_reciprocal) == (False, True)
        assert second.t_start_ns <= first.t_start_ns, "the machine did not boot in between: one monotonic clock"
        assert [side.node for side in second.sides] == [1, 2]

    asyncio.run(story())


def test_nothing_is_lost_or_doubled_when_the_cable_is_pulled_again_and_again(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2, 3)
        port = tmp_path / "dongle"
        config = a_config(tmp_path, f"serial:{port}")
        with listening(config) as peer:
            async with running(config):
                await peer.hear()
                _say_all(dongle, 300)
                for share in (0.1, 0.3, 0.5, 0.7):
                    async with on_pty(dongle, port):
                        wanted = share * 900
                        await until(lambda wanted=wanted: len(peer.records) >= wanted, what="a part of the transfer")  # type: ignore[misc]  # mypy sees no type in a lambda's default
                async with on_pty(dongle, port):
                    await until(lambda: _is_level(dongle), what="all is acknowledged")
                    await until(lambda: len(peer.of(EncounterRecord)) >= 900, what="all is published")
        records = peer.of(EncounterRecord)
        assert len({record.identity for record in records if not record.is_void}) == 900
        assert _offsets([record.offset for record in peer.records])

    asyncio.run(story())


def test_stop_and_start_go_to_the_biobot_and_back(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7)
        backpack = dongle.backpacks[NodeId(7)]
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    backpack.say_hello()
                    backpack.say_status(since_ms=1)
                    await until(lambda: bool(peer.of(ModeRecord)), what="the biobot is known")
                    stages = await command(peer, a_request(7, StimulationAction.STOP))
                    assert [stage.stage for stage in stages] == [Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED]
                    assert stages[-1].mode is Mode.S
                    await asyncio.sleep(2.6)  # a stop counts as a train of 0.5 s, and 2 s lie between two trains
                    start = a_request(7, StimulationAction.START, command_id="start-1")
                    stages = await command(peer, start)
                    assert [stage.stage for stage in stages][-1] is Stage.BIOBOT_CONFIRMED
                    await until(lambda: len(peer.of(ModeRecord)) >= 5, what="the modes")
                    assert [stimulus.action for stimulus in backpack.obeyed] == [Action.STOP, Action.START]
                    assert backpack.obeyed[1].frequency_hz == 50
                    assert backpack.obeyed[1].amplitude_mv == 2000
                    again = await command(peer, start)
                    assert again == stages, "a repeated id is answered, not obeyed"
                async with running(config):
                    await peer.hear()
                    assert await command(peer, start) == stages, "also after a restart"
                    reused = await command(peer, a_request(7, StimulationAction.TURN_LEFT, command_id="start-1"))
                    assert reused[-1].stage is Stage.REFUSED
        assert len(backpack.obeyed) == 2
        newest = {record.identity: record for record in peer.of(ModeRecord)}
        spells = sorted(newest.values(), key=lambda record: record.t_start_ns)
        assert [(spell.mode, spell.cause) for spell in spells] == [
            (Mode.CRW, Cause.NATURAL),
            (Mode.S, Cause.COMMAND),
            (Mode.CRW, Cause.NATURAL),
        ]
        assert [spell.t_end_ns for spell in spells] == [spells[1].t_start_ns, spells[2].t_start_ns, None]

    asyncio.run(story())


def test_stale_future_unknown_and_too_frequent_commands_are_refused_and_audited(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7)
        backpack = dongle.backpacks[NodeId(7)]
        async with on_tcp(dongle) as port:
            seldom = StimulationTable(reply_timeout_s=20.0, min_gap_s=600.0)
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=seldom)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    backpack.say_hello()
                    backpack.say_status()
                    await until(lambda: bool(peer.of(ModeRecord)), what="the biobot is known")
                    for request, word in (
                        (a_request(7, StimulationAction.START, age_s=60), "stale"),
                        (a_request(7, StimulationAction.START, age_s=-60), "future"),
                        (a_request(99, StimulationAction.START), "not known"),
                        (a_request(99, StimulationAction.STOP), "not known"),
                    ):
                        (stage,) = await command(peer, request)
                        assert stage.stage is Stage.REFUSED
                        assert word in stage.reason
                    stages = await command(peer, a_request(7, StimulationAction.START))
                    assert stages[-1].stage is Stage.BIOBOT_CONFIRMED
                    (stage,) = await command(peer, a_request(7, StimulationAction.START))
                    assert stage.stage is Stage.REFUSED
                    assert "must be 600 s at least" in stage.reason
                    stages = await command(peer, a_request(7, StimulationAction.STOP, age_s=60))
                    assert stages[-1].stage is Stage.BIOBOT_CONFIRMED, "a stop is never too old, nor too soon"
        with sqlite3.connect(config.journal) as journal:
            audited = Counter(stage for (stage,) in journal.execute("SELECT stage FROM audit WHERE kind = 'stage'"))
            kinds = [kind for (kind,) in journal.execute("SELECT kind FROM audit WHERE kind IN ('gateway', 'limits') ORDER BY id")]
        journal.close()
        assert audited == {"refused": 5, "accepted": 2, "radio_confirmed": 2, "biobot_confirmed": 2}
        assert kinds == ["gateway", "limits", "gateway"]
        assert verify_audit_of(Path(config.journal), tell=lambda _: None).fault is None

    asyncio.run(story())


def test_a_silent_biobot_is_started_once_and_stopped_until_it_answers(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7, 8)
        backpack = dongle.backpacks[NodeId(7)]
        async with on_tcp(dongle) as port:
            impatient = StimulationTable(reply_timeout_s=1.0, stop_retry_s=0.3)
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=impatient)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    for one in dongle.backpacks.values():
                        one.say_hello()
                        one.say_status()
                    await until(lambda: len(peer.of(ModeRecord)) == 2, what="the biobots are known")
                    backpack.answers = False
                    stages = await command(peer, a_request(7, StimulationAction.START))
                    assert stages[-1].stage is Stage.UNKNOWN
                    assert len(backpack.heard) == 1
                    stopping = asyncio.ensure_future(command(peer, a_request(7, StimulationAction.STOP)))
                    await until(lambda: len(backpack.heard) >= 3, what="the stop is repeated")
                    backpack.answers = True
                    assert (await stopping)[-1].stage is Stage.BIOBOT_CONFIRMED
                    assert [stimulus.action for stimulus in backpack.obeyed] == [Action.STOP]
                    dongle.radio_status = RadioStatus.UNKNOWN_ADDRESS
                    stages = await command(peer, a_request(8, StimulationAction.START))
                    assert stages[-1].stage is Stage.FAILED
                    assert "unknown_address" in stages[-1].reason

    asyncio.run(story())


def test_history_gives_every_record_after_a_restart_and_pages_end(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2, 3)
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    _say_all(dongle, 30)
                    await until(lambda: len(peer.records) >= 93, what="all is published")
                    heard = sorted(peer.records, key=lambda record: record.offset)
                async with running(config):
                    await peer.hear()
                    assert peer.gateway_statuses[-1].head_offset == 93
                    batches = await history(peer, HistoryRequest())
                    assert [record for batch in batches for record in batch.records] == heard
                    (page,) = await history(peer, HistoryRequest(from_offset=50, limit=10))
                    assert [record.offset for record in page.records] == list(range(50, 60))
                    assert page.head_offset == 93
                    (beyond,) = await history(peer, HistoryRequest(from_offset=94))
                    assert beyond.records == ()
                    assert beyond.head_offset == 93

    asyncio.run(story())


def test_a_full_disk_stalls_and_loses_nothing(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2, 3)
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            with listening(config) as peer:
                async with running(config) as service:
                    await peer.hear()
                    dongle.backpacks[NodeId(1)].say_hello()
                    await until(lambda: _is_level(dongle), what="the first hello is on disk")
                    connection = service._journal._file._connection
                    (n_pages,) = connection.execute("PRAGMA page_count").fetchone()
                    connection.execute(f"PRAGMA max_page_count = {n_pages + 1}")
                    _say_all(dongle, 40)
                    await until(lambda: service._journal.fault is not None, what="the disk is full")
                    n_published = service._journal.head_offset
                    await until(lambda: len(peer.records) >= n_published, what="what had come onto the disk is published")
                    (stage,) = await command(peer, a_request(1, StimulationAction.START))
                    assert stage.stage is Stage.REFUSED
                    assert "journal" in stage.reason
                    stages = await command(peer, a_request(1, StimulationAction.STOP))
                    assert dongle.backpacks[NodeId(1)].obeyed
                    assert stages[-1].stage is Stage.BIOBOT_CONFIRMED, "the answer stands behind no report that cannot be written"
                    assert len(peer.records) == n_published
                    assert not _is_level(dongle)
                    connection.execute("PRAGMA max_page_count = 1000000")
                    await until(lambda: _is_level(dongle), what="all is acknowledged")
                    await until(lambda: len(peer.of(EncounterRecord)) >= 120, what="all is published")
        assert len({record.identity for record in peer.of(EncounterRecord)}) == 120

    asyncio.run(story())


def test_the_mission_disperses_selects_landmarks_and_explores(tmp_path: Path) -> None:
    """And whoever was chosen and does not answer is replaced; the choice is on record before anybody is asked."""
    row = {node: frozenset({node - 1, node + 1} & set(range(1, 11))) for node in range(1, 11)}
    (chosen,) = choose_landmarks(row, count=3, eligible=row)
    silent = chosen.picks[1]

    async def story() -> None:
        dongle = a_dongle(*range(1, 11))
        mission = MissionTable(is_enabled=True, dispersion_s=0.5, n_landmarks=3, exploration_s=0.5)
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", mission=mission)
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    dongle.backpacks[NodeId(silent)].answers = False
                    for node, backpack in dongle.backpacks.items():
                        backpack.say_hello()
                        backpack.say_status()
                        backpack.say_neighbours([NodeId(other) for other in sorted(row[node])])
                    await until(lambda: any(one.phase is MissionPhase.DONE for one in peer.of(MissionRecord)), what="the mission is done")
        records = peer.of(MissionRecord)
        phases = {record.identity: record for record in records}
        assert [record.phase for record in phases.values()] == [
            MissionPhase.DISPERSION,
            MissionPhase.LANDMARK_SELECTION,
            MissionPhase.EXPLORATION,
            MissionPhase.DONE,
        ]
        (choice,) = [record.choice for record in records if record.phase is MissionPhase.LANDMARK_SELECTION and record.revision == 1]
        assert choice is not None
        assert choice.awaited == chosen.picks
        landmarks = next(record.landmarks for record in records if record.phase is MissionPhase.EXPLORATION)
        failed = {node for record in records if record.choice is not None for node in record.choice.failed}
        assert silent in failed
        assert len(landmarks) == 3
        assert set(landmarks) >= set(chosen.picks) - failed, "a busy machine may make others answer late"
        assert "not reached: " in next(record.reason for record in records if record.phase is MissionPhase.EXPLORATION)
        standing = {record.node for record in peer.of(ModeRecord) if record.mode is Mode.S and record.cause is Cause.COMMAND}
        assert set(landmarks) <= standing <= set(landmarks) | failed

    asyncio.run(story())


def test_what_cannot_be_opened_is_told_in_one_line(tmp_path: Path) -> None:
    async def attempt(make: Callable[[], Awaitable[None]]) -> str:
        try:
            await make()
        except (BusError, JournalUnfitError, TransportSpecError) as error:
            return str(error)
        pytest.fail("it was opened")

    async def story() -> None:
        config = a_config(tmp_path, "tcp:127.0.0.1:1")
        async with running(config):
            again = a_config(tmp_path, "tcp:127.0.0.1:1")
            assert "another gateway has it open" in await attempt(Service(again).run)
            elsewhere = tmp_path / "elsewhere"
            elsewhere.mkdir()
            taken = a_config(elsewhere, "tcp:127.0.0.1:1")
            taken = type(taken)(**{name: getattr(taken, name) for name in taken.__struct_fields__} | {"listen": config.listen})
            assert "another program has that port" in await attempt(Service(taken).run)

    asyncio.run(story())
