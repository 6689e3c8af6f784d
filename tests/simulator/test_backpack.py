"""Laws of the backpack: what its buffer held arrives once, commands are obeyed once."""

import itertools
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from firmware_protocol.message_codec import decode_uplink, encode_downlink
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    Acknowledge,
    Action,
    Capability,
    ConfigurationReport,
    ConfigurationRequest,
    ConfigurationResult,
    Configure,
    Diagnostic,
    Downlink,
    EncounterBatch,
    EncounterBatchWithPaths,
    Hello,
    HelloRequest,
    Limits,
    MessageFault,
    Neighbour,
    Neighbours,
    Status,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    Waveform,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, NodeId, RssiDbm
from simulator.backpacks.backpack import Backpack, BeaconsChanged, Effect, Transmission
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.backpacks.outbox import Outbox, OutboxConfig
from simulator.backpacks.stimulator import Actuation
from simulator.errors import ParameterError
from simulator.radios.proximity import ProximityConfig
from tests.simulator.base_station import Ledger, a_command

NODE, BOOT = NodeId(7), BootId(3)


def a_backpack(*, node: int = NODE, now_ms: int = 0, neighbours: int = 0, **changes: int) -> Backpack:
    around = [Neighbour(node=NodeId(100 + one), rssi_dbm=RssiDbm(-50)) for one in range(neighbours)]
    config = BackpackConfig(**changes)  # type: ignore[arg-type]  # every field given here is an int
    return Backpack(node=NodeId(node), boot=BOOT, eui64=0x10007, seed=1, config=config, now_ms=now_ms, sense_neighbours=lambda: around)


def said(effects: Iterable[Effect]) -> list[Uplink]:
    return [effect.message for effect in effects if isinstance(effect, Transmission)]


def actuations(effects: Iterable[Effect]) -> list[Actuation]:
    return [effect for effect in effects if isinstance(effect, Actuation)]


def hear(backpack: Backpack, message: Downlink, *, now_ms: int) -> list[Effect]:
    return backpack.receive(encode_downlink(0, message), now_ms=now_ms)


class Air:
    """Loses payloads by a pattern, and none when that is used up."""

    def __init__(self, losses: list[bool]) -> None:
        self._losses = iter(losses)

    def loses(self) -> bool:
        return next(self._losses, False)


def run_until_settled(backpack: Backpack, ledger: Ledger, air: Air, *, now_ms: int, before_ms: int | None = None) -> int:
    """Let backpack and base station talk until nothing is left to say, or until ``before_ms``; return the time then."""
    for _ in range(100_000):
        for effect in backpack.poll(now_ms=now_ms):
            if isinstance(effect, Transmission) and not air.loses():
                ledger.take(effect.sequence, effect.message)
                if not air.loses():
                    hear(backpack, ledger.acknowledge(BOOT), now_ms=now_ms)
        due_ms = backpack.next_due_ms()
        if due_ms is None or backpack.is_settled or (before_ms is not None and due_ms >= before_ms):
            return now_ms if before_ms is None else max(now_ms, before_ms)
        now_ms = max(now_ms + 1, due_ms)
    pytest.fail("the backpack never settled")


@given(
    meetings=st.lists(st.tuples(st.integers(0, 400), st.integers(0, 40_000), st.integers(1, 5)), max_size=40),
    losses=st.lists(st.booleans(), max_size=120),
    capacity=st.integers(1, 12),
)
def test_whatever_is_lost_on_the_air_the_base_station_gets_all_the_buffer_held_and_none_twice(
    meetings: list[tuple[int, int, int]], losses: list[bool], capacity: int
) -> None:
    backpack, ledger, air = a_backpack(capacity=capacity, provisional_ms=10**9), Ledger(), Air(losses)
    now_ms, kept = 0, []
    for gap_ms, duration_ms, peer in meetings:
        start_ms = now_ms + gap_ms
        now_ms = run_until_settled(backpack, ledger, air, now_ms=now_ms, before_ms=start_ms)
        backpack.begin_encounter(NodeId(peer), start_ms=start_ms, rssi_dbm=RssiDbm(-40))
        end_ms = start_ms + duration_ms
        now_ms = run_until_settled(backpack, ledger, air, now_ms=now_ms, before_ms=end_ms)
        dropped = backpack.n_dropped
        backpack.end_encounter(NodeId(peer), end_ms=end_ms, now_ms=end_ms)
        if backpack.n_dropped == dropped:
            kept.append((peer, start_ms, duration_ms))
    backpack.quieten()
    run_until_settled(backpack, ledger, air, now_ms=now_ms)
    assert [(one.peer, one.start_ms, one.duration_ms) for one in ledger.entries()] == kept
    assert backpack.n_dropped == len(meetings) - len(kept)
    assert backpack.n_buffered == 0
    assert sorted(ledger.messages) == list(range(len(ledger.messages)))


def test_a_full_buffer_loses_the_newest_encounters_and_says_how_many() -> None:
    backpack = a_backpack(capacity=3, spread_ms=0)
    for peer in range(1, 6):
        backpack.begin_encounter(NodeId(peer), start_ms=10 * peer, rssi_dbm=RssiDbm(-40))
        backpack.end_encounter(NodeId(peer), end_ms=10 * peer + 5, now_ms=10 * peer + 5)
    messages = said(backpack.poll(now_ms=2_000))
    batch = next(one for one in messages if isinstance(one, EncounterBatch))
    status = next(one for one in messages if isinstance(one, Status))
    assert [entry.peer for entry in batch.entries] == [1, 2, 3]
    assert (status.buffered, status.dropped) == (3, 2)


@given(losses=st.lists(st.just(True), max_size=12))
def test_repetitions_come_ever_later_each_with_a_fresh_time_and_the_same_content(losses: list[bool]) -> None:
    backpack = a_backpack(spread_ms=0)
    backpack.quieten()
    copies, now_ms = [], 0
    for _ in range(len(losses) + 2):
        for effect in backpack.poll(now_ms=now_ms):
            assert isinstance(effect, Transmission)
            decoded = decode_uplink(effect.payload)
            assert not isinstance(decoded, MessageFault)
            copies.append((decoded[0].sent_ms, decoded[0].sequence, decoded[1]))
            assert decoded[0].sent_ms == now_ms
        now_ms = backpack.next_due_ms() or 0
    waits = [later[0] - earlier[0] for earlier, later in itertools.pairwise(copies)]
    copies = [copy for copy in copies if copy[1] == 0]
    waits = [later[0] - earlier[0] for earlier, later in itertools.pairwise(copies)]
    assert len({(sequence, message) for _, sequence, message in copies}) == 1
    for index, wait_ms in enumerate(waits):
        nominal_ms = min(1_000 * 2**index, 30_000)
        assert 0.75 * nominal_ms - 1 <= wait_ms <= 1.25 * nominal_ms + 1


@given(next_sequence=st.integers(0, 65_535), bitmap=st.integers(0, 2**32 - 1), boot=st.sampled_from([BOOT, 0, 65_535]))
def test_an_acknowledgement_of_numbers_never_given_or_of_another_boot_changes_nothing(next_sequence: int, bitmap: int, boot: int) -> None:
    backpack = a_backpack(spread_ms=0)
    given_out = {effect.sequence for effect in backpack.poll(now_ms=0) if isinstance(effect, Transmission)}
    hear(backpack, Acknowledge(boot=BootId(boot), next_sequence=next_sequence, bitmap=bitmap), now_ms=1)
    repeated = {effect.sequence for effect in backpack.poll(now_ms=10_000) if isinstance(effect, Transmission)}
    if boot != BOOT or len(given_out) < next_sequence <= 32_768:
        assert given_out <= repeated


@given(start=st.integers(65_500, 65_535), order=st.permutations(range(60)))
def test_sequence_numbers_wrap_without_loss(start: int, order: list[int]) -> None:
    outbox = Outbox(biobot=1, seed=1, config=OutboxConfig(max_waiting=64), _next_sequence=start)
    for _ in range(60):
        assert outbox.put(HELLO)
    done: list[int] = []
    for now_ms in range(0, 200_000, 1_000):
        for copy in outbox.take_due(now_ms):
            place = (copy.sequence - start) % 65_536
            message = Acknowledge(boot=BOOT, next_sequence=(copy.sequence - 1) % 65_536, bitmap=1) if order[place] % 2 else None
            message = message or Acknowledge(boot=BOOT, next_sequence=(copy.sequence + 1) % 65_536, bitmap=0)
            done += [sequence for sequence, _ in outbox.acknowledge(message, now_ms=now_ms)]
    assert outbox.is_empty
    assert sorted((sequence - start) % 65_536 for sequence in done) == list(range(60))


HELLO = Hello(eui64=1, firmware=1, beacon_period_ms=0, capabilities=1)


def test_no_more_than_the_window_is_ever_outstanding() -> None:
    backpack = a_backpack(capacity=10_000, spread_ms=0)
    for start_ms in range(2_000):
        backpack.begin_encounter(NodeId(1), start_ms=start_ms, rssi_dbm=RssiDbm(-40))
        backpack.end_encounter(NodeId(1), end_ms=start_ms, now_ms=start_ms)
    sequences: set[int] = set()
    for now_ms in range(2_000, 60_000, 500):
        sequences |= {effect.sequence for effect in backpack.poll(now_ms=now_ms) if isinstance(effect, Transmission)}
    assert sequences == set(range(31))


def test_reports_leave_the_last_two_numbers_to_answers_and_the_very_last_to_commands() -> None:
    """Nobody acknowledges, and a stop is confirmed all the same."""
    backpack = a_backpack(capacity=10_000, spread_ms=0)
    for start_ms in range(2_000):
        backpack.begin_encounter(NodeId(1), start_ms=start_ms, rssi_dbm=RssiDbm(-40))
        backpack.end_encounter(NodeId(1), end_ms=start_ms, now_ms=start_ms)
    hear(backpack, Acknowledge(boot=BOOT, next_sequence=0, bitmap=0), now_ms=1_999)
    backpack.poll(now_ms=2_000)
    hear(backpack, ConfigurationRequest(token=5), now_ms=2_001)
    backpack.poll(now_ms=2_001)
    hear(backpack, Configure(token=6, report_period_ms=900), now_ms=2_002)  # has no number left
    hear(backpack, a_command(1, Action.STOP), now_ms=2_003)
    firsts = {one.sequence: one.message for one in backpack.poll(now_ms=2_003) if isinstance(one, Transmission) and one.is_first}
    assert {number: type(message) for number, message in firsts.items()} == {32: StimulateReply}


@given(n_asked=st.integers(1, 50))
def test_a_hello_that_is_under_way_is_sent_again_and_not_said_twice(n_asked: int) -> None:
    backpack = a_backpack(spread_ms=0)
    backpack.quieten()
    sent: dict[int, Uplink] = {}
    for now_ms in range(n_asked):
        hear(backpack, HelloRequest(), now_ms=now_ms)
        copies = [one for one in backpack.poll(now_ms=now_ms) if isinstance(one, Transmission)]
        assert {type(one.message) for one in copies} == {Hello, Limits, Diagnostic}, "what is under way is sent at once"
        sent |= {one.sequence: one.message for one in copies}
    assert sorted(sent) == [0, 1, 2]


def test_a_broadcast_hello_request_ends_waits_within_its_random_wait() -> None:
    backpack = a_backpack(spread_ms=1_000)
    backpack.quieten()
    for now_ms in range(0, 40_000, 10):
        backpack.poll(now_ms=now_ms)
    backpack.receive(encode_downlink(0, HelloRequest()), now_ms=40_000, is_broadcast=True)
    assert backpack.poll(now_ms=40_000) == []
    due_ms = backpack.next_due_ms()
    assert due_ms is not None
    assert 40_000 < due_ms <= 41_000
    assert {type(one) for one in said(backpack.poll(now_ms=due_ms))} == {Hello, Limits, Diagnostic}


@pytest.mark.parametrize(("boot", "next_sequence"), [(BOOT, 5), (BOOT + 1, 0)])
def test_an_acknowledgement_of_another_boot_or_of_numbers_never_given_is_counted(boot: int, next_sequence: int) -> None:
    backpack = a_backpack(spread_ms=10**9)
    hear(backpack, Acknowledge(boot=BootId(boot), next_sequence=next_sequence, bitmap=0), now_ms=1)
    assert backpack.n_ignored == 1


def test_hello_and_status_and_neighbours_come_at_boot_and_hello_again_when_asked() -> None:
    backpack, ledger = a_backpack(neighbours=23), Ledger()
    run_until_settled(backpack, ledger, Air([]), now_ms=0, before_ms=1_500)
    kinds = [type(message) for _, message in sorted(ledger.messages.items())]
    assert kinds == [Hello, Limits, Diagnostic, Status, Neighbours, Neighbours, Neighbours]
    parts = [message for message in ledger.messages.values() if isinstance(message, Neighbours)]
    assert [(part.part, part.n_parts, len(part.neighbours)) for part in parts] == [(0, 3, 10), (1, 3, 10), (2, 3, 3)]
    hear(backpack, HelloRequest(), now_ms=2_000)
    assert [type(message) for message in said(backpack.poll(now_ms=2_000))] == [Hello, Limits]


def test_an_encounter_that_lasts_is_reported_while_it_goes_on_and_whole_in_the_end() -> None:
    backpack, ledger = a_backpack(), Ledger()
    backpack.begin_encounter(NodeId(9), start_ms=100, rssi_dbm=RssiDbm(-40))
    now_ms = run_until_settled(backpack, ledger, Air([]), now_ms=0, before_ms=70_000)
    backpack.end_encounter(NodeId(9), end_ms=70_000, now_ms=now_ms)
    backpack.quieten()
    run_until_settled(backpack, ledger, Air([]), now_ms=now_ms)
    entries = [(entry.start_ms, entry.duration_ms, entry.is_ongoing) for entry in ledger.entries()]
    assert entries == [(100, 30_000, True), (100, 60_000, True), (100, 69_900, False)]


@given(duration_ms=st.integers(MAX_ENCOUNTER_MS - 5, 3 * MAX_ENCOUNTER_MS + 5))
def test_an_encounter_too_long_for_one_entry_comes_in_pieces_that_touch(duration_ms: int) -> None:
    backpack, ledger = a_backpack(provisional_ms=1_000_000), Ledger()
    backpack.quieten()
    backpack.begin_encounter(NodeId(9), start_ms=5, rssi_dbm=RssiDbm(-40))
    now_ms = run_until_settled(backpack, ledger, Air([]), now_ms=0, before_ms=5 + duration_ms)
    backpack.end_encounter(NodeId(9), end_ms=5 + duration_ms, now_ms=now_ms)
    run_until_settled(backpack, ledger, Air([]), now_ms=now_ms)
    final = [entry for entry in ledger.entries() if not entry.is_ongoing]
    assert final[0].start_ms == 5
    assert sum(entry.duration_ms for entry in final) == duration_ms
    assert all(one.start_ms + one.duration_ms == two.start_ms for one, two in itertools.pairwise(final))


def test_a_time_sync_request_is_answered_at_once_and_not_kept() -> None:
    backpack = a_backpack(spread_ms=60_000)
    (effect,) = hear(backpack, TimeSyncRequest(token=77), now_ms=1_234)
    assert isinstance(effect, Transmission)
    assert (effect.sequence, effect.message) == (0, TimeSyncReply(token=77, received_ms=Milliseconds(1_234)))
    assert backpack.poll(now_ms=1_300) == []


def test_a_stop_and_a_start_change_the_mode_and_both_are_told() -> None:
    backpack, ledger = a_backpack(spread_ms=0), Ledger()
    run_until_settled(backpack, ledger, Air([]), now_ms=0, before_ms=1_000)
    stop, start = a_command(1, Action.STOP), a_command(2, Action.START)
    stopped, started = hear(backpack, stop, now_ms=1_000), hear(backpack, start, now_ms=3_000)
    by_command = WireCause.COMMAND
    assert actuations(stopped) == [Actuation(mode=WireMode.S, cause=by_command, command=1, action=Action.STOP, train=stop)]
    assert actuations(started) == [Actuation(mode=WireMode.CRW, cause=by_command, command=2, action=Action.START, train=start)]
    messages = said(backpack.poll(now_ms=3_000))
    statuses = [(one.mode, one.cause, one.mode_since_ms) for one in messages if isinstance(one, Status)]
    replies = [(one.command, one.result, one.executed_ms, one.mode) for one in messages if isinstance(one, StimulateReply)]
    assert statuses == [(WireMode.S, WireCause.COMMAND, 1_000), (WireMode.CRW, WireCause.COMMAND, 3_000)]
    assert replies == [(1, StimulationResult.DONE, 1_000, WireMode.S), (2, StimulationResult.DONE, 3_000, WireMode.CRW)]


@given(repeats=st.lists(st.integers(0, 5_000), min_size=1, max_size=8), action=st.sampled_from([Action.START, Action.STOP]))
def test_a_repeated_command_is_answered_and_not_obeyed_again(repeats: list[int], action: Action) -> None:
    backpack = a_backpack()
    command = a_command(5, action)
    done = actuations(hear(backpack, command, now_ms=100))
    for now_ms in sorted(repeats):
        done += actuations(hear(backpack, command, now_ms=100 + now_ms))
    assert len(done) == 1
    replies = [one for one in said(backpack.poll(now_ms=6_000)) if isinstance(one, StimulateReply)]
    assert [one.result for one in replies] == [StimulationResult.DONE], "its answer was under way"
    answered_by = [one.sequence for one in backpack.poll(now_ms=20_000) if isinstance(one, Transmission)]
    hear(backpack, Acknowledge(boot=BOOT, next_sequence=max(answered_by) + 1, bitmap=0), now_ms=20_001)
    assert actuations(hear(backpack, command, now_ms=20_002)) == []
    replies += [one for one in said(backpack.poll(now_ms=20_002)) if isinstance(one, StimulateReply)]
    assert [one.result for one in replies] == [StimulationResult.DONE, StimulationResult.ALREADY_DONE]
    assert {one.executed_ms for one in replies} == {100}


@given(ttl_ms=st.integers(0, 1_000), train_ms=st.integers(1, 1_000))
def test_a_command_that_waits_longer_than_its_time_to_live_is_refused(ttl_ms: int, train_ms: int) -> None:
    backpack = a_backpack(spread_ms=10**9)
    backpack.quieten()
    hear(backpack, a_command(1, Action.START, duration_ms=train_ms), now_ms=0)
    hear(backpack, a_command(2, Action.START, ttl_ms=ttl_ms), now_ms=0)
    now_ms, effects = 0, backpack.poll(now_ms=0)
    while now_ms < 1_500:
        now_ms = min(backpack.next_due_ms() or 1_500, 1_500) if (backpack.next_due_ms() or 0) > now_ms else now_ms + 1
        effects += backpack.poll(now_ms=now_ms)
    results = {one.command: (one.result, one.executed_ms) for one in said(effects) if isinstance(one, StimulateReply)}
    assert results[1] == (StimulationResult.DONE, 0)
    fits = train_ms <= ttl_ms
    assert results[2] == ((StimulationResult.DONE, train_ms) if fits else (StimulationResult.EXPIRED, ttl_ms + 1))
    assert len(actuations(effects)) == (1 if fits else 0)


@given(hold_ms=st.integers(1, 100_000))
def test_a_hold_ends_by_itself_when_its_time_is_over_and_not_before(hold_ms: int) -> None:
    backpack = a_backpack()
    hear(backpack, a_command(1, Action.STOP, hold_ms=hold_ms), now_ms=500)
    assert actuations(backpack.poll(now_ms=500 + hold_ms - 1)) == []
    due_ms = backpack.next_due_ms()
    assert due_ms is not None
    assert due_ms <= 500 + hold_ms
    assert actuations(backpack.poll(now_ms=500 + hold_ms)) == [Actuation(mode=WireMode.CRW, cause=WireCause.NATURAL, command=None)]
    assert actuations(backpack.poll(now_ms=10**6)) == []
    assert (backpack.mode, backpack.cause) == (WireMode.CRW, WireCause.NATURAL)


def test_a_new_command_takes_the_place_of_the_hold_before_it() -> None:
    backpack = a_backpack()
    hear(backpack, a_command(1, Action.STOP, hold_ms=1_000), now_ms=0)
    hear(backpack, a_command(2, Action.STOP), now_ms=900)
    assert actuations(backpack.poll(now_ms=10**6)) == []
    assert backpack.mode is WireMode.S


def test_a_stop_overtakes_a_running_train_and_whatever_waits_behind_it() -> None:
    backpack = a_backpack()
    hear(backpack, a_command(1, Action.START), now_ms=0)
    assert actuations(hear(backpack, a_command(2, Action.START, ttl_ms=60_000), now_ms=10)) == []
    assert [one.mode for one in actuations(hear(backpack, a_command(3, Action.STOP), now_ms=20))] == [WireMode.S]
    later = backpack.poll(now_ms=5_000)
    assert actuations(later) == []
    results = {one.command: one.result for one in said(later) if isinstance(one, StimulateReply)}
    assert results == {1: StimulationResult.DONE, 2: StimulationResult.EXPIRED, 3: StimulationResult.DONE}


@pytest.mark.parametrize(
    "command",
    [a_command(1, Action.TURN_LEFT, duration_ms=0), a_command(1, Action.TURN_RIGHT, frequency_hz=101),
     a_command(1, Action.START, frequency_hz=101), a_command(1, Action.START, frequency_hz=0)],
)  # fmt: skip
def test_turns_without_a_train_and_pulses_that_do_not_fit_are_refused_as_bad_parameters(command: Downlink) -> None:
    backpack = a_backpack()
    assert actuations(hear(backpack, command, now_ms=0)) == []
    replies = [one for one in said(backpack.poll(now_ms=0)) if isinstance(one, StimulateReply)]
    assert [one.result for one in replies] == [StimulationResult.BAD_PARAMETER]


def test_a_train_at_the_announced_limits_is_delivered_and_one_beyond_any_of_them_is_refused() -> None:
    backpack = a_backpack(spread_ms=0)
    limits = next(one for one in said(backpack.poll(now_ms=0)) if isinstance(one, Limits))
    widest = replace(
        a_command(1, Action.START, frequency_hz=50, duration_ms=limits.max_duration_ms),
        amplitude_mv=limits.max_amplitude_mv,
        pulse_width_us=limits.max_pulse_width_us,
        channel=limits.channels.bit_length() - 1,
        waveform=Waveform.ASYMMETRIC_BIPHASIC,
    )
    assert actuations(hear(backpack, widest, now_ms=0))[0].train == widest
    beyond = (
        {"frequency_hz": limits.max_frequency_hz + 1, "pulse_width_us": 100},
        {"amplitude_mv": limits.max_amplitude_mv + 1},
        {"pulse_width_us": limits.max_pulse_width_us + 1, "frequency_hz": 40},
        {"duration_ms": limits.max_duration_ms + 1},
        {"channel": limits.channels.bit_length()},
        {"waveform": Waveform.MONOPHASIC},
    )
    for number, change in enumerate(beyond):
        command = replace(widest, command=10 + number, **change)  # type: ignore[arg-type]  # each a field of Stimulate
        assert actuations(hear(backpack, command, now_ms=5_000)) == []
    (stop,) = actuations(hear(backpack, replace(widest, command=99, action=Action.STOP, channel=7), now_ms=5_000))
    assert (stop.mode, stop.train) == (WireMode.S, None), "an unfit train does not keep a stop from stopping"
    results = {one.command: one.result for one in said(backpack.poll(now_ms=5_000)) if isinstance(one, StimulateReply)}
    assert {number: results[10 + number] for number in range(len(beyond))} == dict.fromkeys(range(6), StimulationResult.REFUSED_LIMIT)


def reports(effects: Iterable[Effect]) -> list[ConfigurationReport]:
    return [one for one in said(effects) if isinstance(one, ConfigurationReport)]


def test_a_report_period_is_applied_and_told() -> None:
    backpack = a_backpack(spread_ms=10**9)
    hear(backpack, Configure(token=5, report_period_ms=4_000), now_ms=0)
    (report,) = reports(backpack.poll(now_ms=0))
    assert (report.token, report.result, report.report_period_ms, report.beacon_period_ms) == (5, ConfigurationResult.DONE, 4_000, 0)
    backpack.begin_encounter(NodeId(9), start_ms=0, rssi_dbm=RssiDbm(-40))
    backpack.end_encounter(NodeId(9), end_ms=10, now_ms=10)
    assert not any(isinstance(one, EncounterBatch) for one in said(backpack.poll(now_ms=4_009)))
    assert any(isinstance(one, EncounterBatch) for one in said(backpack.poll(now_ms=4_010)))


@pytest.mark.parametrize("wanted", [{"beacon_period_ms": 500}, {"rssi_enter_dbm": -60}, {"rssi_exit_dbm": -60}, {"gap_tolerance_ms": 900}])
def test_what_a_backpack_without_beacons_does_not_have_is_not_supported_and_nothing_changes(wanted: dict[str, int]) -> None:
    backpack = a_backpack(spread_ms=10**9)
    hear(backpack, Configure(token=1, report_period_ms=9, **wanted), now_ms=0)  # type: ignore[arg-type]  # each a field of Configure
    (refused,) = reports(backpack.poll(now_ms=0))
    hear(backpack, ConfigurationRequest(token=2), now_ms=0)
    (told,) = reports(backpack.poll(now_ms=0))
    assert (refused.result, refused.report_period_ms) == (ConfigurationResult.NOT_SUPPORTED, 1_000)
    assert replace(told, token=1, result=ConfigurationResult.NOT_SUPPORTED) == refused


def a_backpack_with_beacons() -> Backpack:
    config = BackpackConfig(spread_ms=10**9, beacon_period_ms=1_000, proximity=ProximityConfig(enter_dbm=-50.0, exit_dbm=-60.0, gap=1_150))
    return Backpack(node=NODE, boot=BOOT, eui64=1, seed=1, config=config, now_ms=0, sense_neighbours=list)


def test_thresholds_gap_and_beacon_period_are_applied_and_a_hello_tells_the_new_period() -> None:
    backpack = a_backpack_with_beacons()
    wanted = Configure(token=1, beacon_period_ms=300, rssi_enter_dbm=RssiDbm(-70), rssi_exit_dbm=RssiDbm(-75), gap_tolerance_ms=400)
    assert hear(backpack, wanted, now_ms=0) == [BeaconsChanged(period_ms=300, exit_dbm=-75.0)]
    told = said(backpack.poll(now_ms=0))
    (report,) = [one for one in told if isinstance(one, ConfigurationReport)]
    assert (report.rssi_enter_dbm, report.rssi_exit_dbm, report.gap_tolerance_ms, report.beacon_period_ms) == (-70, -75, 400, 300)
    assert [one.beacon_period_ms for one in told if isinstance(one, Hello)] == [300]
    backpack.hear_beacon(NodeId(9), at_ms=0, rssi_dbm=-69.0, now_ms=0)
    backpack.hear_beacon(NodeId(9), at_ms=350, rssi_dbm=-74.0, now_ms=350)
    assert backpack.n_open == 1
    backpack.sense_until(751, now_ms=751)
    assert backpack.n_open == 0


@pytest.mark.parametrize("wanted", [{"rssi_exit_dbm": -49}, {"rssi_enter_dbm": -61}, {"beacon_period_ms": 99}])
def test_values_that_contradict_each_other_or_cannot_be_kept_are_bad_parameters_and_nothing_changes(wanted: dict[str, int]) -> None:
    backpack = a_backpack_with_beacons()
    hear(backpack, Configure(token=1, gap_tolerance_ms=7, **wanted), now_ms=0)  # type: ignore[arg-type]  # each a field of Configure
    (report,) = reports(backpack.poll(now_ms=0))
    assert (report.result, report.gap_tolerance_ms) == (ConfigurationResult.BAD_PARAMETER, 1_150)


def test_a_broadcast_of_a_configuration_is_answered_after_a_random_wait() -> None:
    backpack = a_backpack_with_beacons()
    backpack.receive(encode_downlink(0, Configure(token=3, report_period_ms=50)), now_ms=0, is_broadcast=True)
    assert reports(backpack.poll(now_ms=0)) == []
    assert not backpack.is_settled
    assert [one.token for one in reports(backpack.poll(now_ms=10**9))] == [3]


def test_a_backpack_with_an_imu_tells_the_path_between_encounters_in_batches_of_three() -> None:
    config = BackpackConfig(spread_ms=0)
    backpack = Backpack(
        node=NODE, boot=BOOT, eui64=1, seed=1, config=config, now_ms=0, sense_neighbours=list, read_path_mm=lambda at_ms: 40.0 * at_ms,
    )  # fmt: skip
    for index, start_ms in enumerate((10, 25, 25, 10_000)):
        backpack.begin_encounter(NodeId(20 + index), start_ms=start_ms, rssi_dbm=RssiDbm(-40))
    for index in range(4):
        backpack.end_encounter(NodeId(20 + index), end_ms=10_001, now_ms=10_001)
    told = said(backpack.poll(now_ms=20_000))
    batches = [one for one in told if isinstance(one, EncounterBatchWithPaths)]
    assert [len(batch.entries) for batch in batches] == [3, 1]
    assert [entry.path_mm for batch in batches for entry in batch.entries] == [None, 600, 0, 65_534]
    (hello,) = [one for one in told if isinstance(one, Hello)]
    assert hello.capabilities == Capability.STIMULATION | Capability.IMU | Capability.CONFIGURE


def test_walls_are_followed_only_where_the_backpack_says_that_it_can() -> None:
    """With the capability it is done like a start, with or without a train; without it, it is a bad parameter (WIRE_FORMAT.md 6.5)."""
    for can in (False, True):
        backpack = a_backpack(spread_ms=0, can_follow_walls=can)
        done = [actuations(hear(backpack, a_command(n, Action.FOLLOW_WALLS, duration_ms=ms), now_ms=n)) for n, ms in ((1, 0), (2, 300))]
        told = said(backpack.poll(now_ms=10))
        (hello,) = [one for one in told if isinstance(one, Hello)]
        assert bool(hello.capabilities & Capability.FOLLOW_WALLS) is can
        wanted = StimulationResult.DONE if can else StimulationResult.BAD_PARAMETER
        assert [one.result for one in told if isinstance(one, StimulateReply)] == [wanted, wanted]
        assert [[(one.mode, one.action, one.train is None) for one in each] for each in done] == (
            [[(WireMode.CRW, Action.FOLLOW_WALLS, True)], [(WireMode.CRW, Action.FOLLOW_WALLS, False)]] if can else [[], []]
        )


@pytest.mark.parametrize("action", [Action.TURN_LEFT, Action.TURN_RIGHT])
def test_a_turn_is_done_once_its_train_is_delivered_and_leaves_the_mode_to_the_insect(action: Action) -> None:
    backpack = a_backpack(spread_ms=10**9)
    turn = a_command(1, action)
    (actuation,) = actuations(hear(backpack, turn, now_ms=0))
    assert (actuation.mode, actuation.train) == (None, turn)
    (reply,) = [one for one in said(backpack.poll(now_ms=0)) if isinstance(one, StimulateReply)]
    assert (reply.result, reply.mode) == (StimulationResult.DONE, WireMode.CRW)
    assert (backpack.mode, backpack.cause) == (WireMode.CRW, WireCause.COMMAND)


def test_a_turn_does_not_end_the_hold_of_a_stop() -> None:
    backpack = a_backpack()
    hear(backpack, a_command(1, Action.STOP, hold_ms=5_000), now_ms=0)
    hear(backpack, a_command(2, Action.TURN_LEFT, hold_ms=1_000), now_ms=1_000)
    assert [one.mode for one in actuations(backpack.poll(now_ms=4_999))] == []
    assert [one.mode for one in actuations(backpack.poll(now_ms=5_000))] == [WireMode.CRW]


@given(action=st.sampled_from([one for one in Action if one is not Action.STOP]), hold_ms=st.integers(1, 100_000), stands=st.booleans())
def test_the_end_of_the_hold_of_a_motion_stops_the_insect_without_a_train(action: Action, hold_ms: int, stands: bool) -> None:
    """Who controlled the motion has gone: it must not go on (WIRE_FORMAT.md section 6.8). It stands until it is started."""
    backpack = a_backpack(spread_ms=10**9, can_follow_walls=True)
    backpack.quieten()
    hear(backpack, a_command(1, action, hold_ms=hold_ms), now_ms=100)
    if stands:
        backpack.change_mode(WireMode.S, WireCause.NATURAL, at_ms=100)
    assert actuations(backpack.poll(now_ms=100 + hold_ms - 1)) == []
    due_ms = backpack.next_due_ms()
    assert due_ms is not None
    assert due_ms <= 100 + hold_ms
    assert actuations(backpack.poll(now_ms=100 + hold_ms)) == [Actuation(mode=WireMode.S, cause=WireCause.COMMAND, command=None)]
    assert (backpack.mode, backpack.cause) == (WireMode.S, WireCause.COMMAND)
    (turn,) = actuations(hear(backpack, a_command(2, Action.TURN_LEFT, hold_ms=5), now_ms=100 + hold_ms))
    assert turn.mode is None, "the train that ran was cut off; and one that stands is not let go by a turn"
    assert actuations(backpack.poll(now_ms=10**6)) == []
    assert backpack.mode is WireMode.S


@given(action=st.sampled_from([Action.START, Action.TURN_LEFT]))
def test_a_start_or_turn_without_a_hold_goes_on(action: Action) -> None:
    backpack = a_backpack()
    hear(backpack, a_command(1, Action.START, hold_ms=1_000), now_ms=0)
    hear(backpack, a_command(2, action), now_ms=900)
    assert [one.mode for one in actuations(backpack.poll(now_ms=10**6))] == []


def test_a_stop_by_broadcast_is_obeyed_at_once_and_answered_after_a_random_wait_of_up_to_a_second() -> None:
    stop, answered_ms = a_command(9, Action.STOP), list[int]()
    for node in range(1, 31):
        backpack = a_backpack(node=node)
        backpack.quieten()
        backpack.poll(now_ms=2_000)
        (actuation,) = actuations(backpack.receive(encode_downlink(1, stop), now_ms=3_000, is_broadcast=True))
        assert (actuation.mode, actuation.train) == (WireMode.S, stop)
        assert actuations(backpack.receive(encode_downlink(2, stop), now_ms=3_000, is_broadcast=True)) == []
        now_ms, replies = 3_000, list[Uplink]()
        while not replies:
            now_ms = max(now_ms, backpack.next_due_ms() or 0)
            replies = [one for one in said(backpack.poll(now_ms=now_ms)) if isinstance(one, StimulateReply)]
        assert [(one.result, one.executed_ms) for one in replies if isinstance(one, StimulateReply)] == [(StimulationResult.DONE, 3_000)]
        answered_ms.append(now_ms - 3_000)
    assert all(0 <= wait_ms <= 1_000 for wait_ms in answered_ms)
    assert len(set(answered_ms)) > 20, "they do not all speak at once"


@given(again_ms=st.integers(0, 3_000))
def test_a_stop_that_came_by_broadcast_is_answered_at_once_when_asked_alone_and_gives_no_second_train(again_ms: int) -> None:
    backpack, stop = a_backpack(), a_command(9, Action.STOP)
    backpack.poll(now_ms=2_000)
    assert len(actuations(backpack.receive(encode_downlink(1, stop), now_ms=3_000, is_broadcast=True))) == 1
    backpack.poll(now_ms=3_000 + again_ms)
    assert actuations(hear(backpack, stop, now_ms=3_000 + again_ms)) == []
    replies = [one for one in said(backpack.poll(now_ms=3_000 + again_ms)) if isinstance(one, StimulateReply)]
    assert [(one.command, one.result, one.executed_ms) for one in replies] == [(9, StimulationResult.DONE, 3_000)]


@given(action=st.sampled_from([Action.START, Action.TURN_LEFT, Action.TURN_RIGHT]))
def test_any_other_action_that_comes_by_broadcast_is_neither_obeyed_nor_answered(action: Action) -> None:
    backpack = a_backpack()
    backpack.poll(now_ms=2_000)
    command = a_command(9, action)
    assert backpack.receive(encode_downlink(1, command), now_ms=3_000, is_broadcast=True) == []
    assert backpack.n_ignored == 1
    assert not [one for one in said(backpack.poll(now_ms=10_000)) if isinstance(one, StimulateReply)]
    assert len(actuations(hear(backpack, command, now_ms=10_000))) == 1, "its number was not used up"


def test_where_the_insect_does_not_obey_commands_are_answered_and_the_mode_stays() -> None:
    backpack = Backpack(
        node=NODE, boot=BOOT, eui64=1, seed=1, config=BackpackConfig(insect_obeys=False), now_ms=0, sense_neighbours=list,
    )  # fmt: skip
    hear(backpack, a_command(1, Action.STOP), now_ms=0)
    (reply,) = [one for one in said(backpack.poll(now_ms=0)) if isinstance(one, StimulateReply)]
    assert (reply.result, reply.mode, backpack.mode) == (StimulationResult.DONE, WireMode.CRW, WireMode.CRW)


@pytest.mark.parametrize(
    ("life_ms", "age_ms", "battery_mv"), [(10_000, 5_000, 2_500), (10_000, 20_000, 2_000), (7_200_000, 3_600_000, 2_500)]
)
def test_the_voltage_falls_evenly_over_the_batterys_life(life_ms: int, age_ms: int, battery_mv: int) -> None:
    backpack = a_backpack(battery_life_ms=life_ms, spread_ms=0)
    backpack.quieten()
    backpack.change_mode(WireMode.S, WireCause.NATURAL, at_ms=age_ms)
    (status,) = [one for one in said(backpack.poll(now_ms=age_ms)) if isinstance(one, Status)]
    assert status.battery_mv == battery_mv


def test_a_backpack_that_joins_again_says_hello_and_repeats_soon() -> None:
    backpack, ledger = a_backpack(spread_ms=0), Ledger()
    run_until_settled(backpack, ledger, Air([]), now_ms=0, before_ms=1_000)
    backpack.begin_encounter(NodeId(9), start_ms=1_000, rssi_dbm=RssiDbm(-40))
    backpack.end_encounter(NodeId(9), end_ms=1_500, now_ms=1_500)
    for now_ms in range(1_500, 120_000, 100):
        backpack.poll(now_ms=now_ms)  # nobody hears
    backpack.rejoin(now_ms=120_000)
    messages = [one for now_ms in range(120_000, 121_500, 100) for one in said(backpack.poll(now_ms=now_ms))]
    assert any(isinstance(one, Hello) for one in messages)
    assert any(isinstance(one, EncounterBatch) for one in messages)


def test_a_stop_is_obeyed_whatever_its_pulses() -> None:
    backpack = a_backpack()
    assert len(actuations(hear(backpack, a_command(1, Action.STOP, frequency_hz=255, duration_ms=65_535), now_ms=0))) == 1
    assert len(actuations(hear(backpack, a_command(2, Action.START), now_ms=1))) == 1  # no train of 65 s was begun


@given(payload=st.binary(max_size=80))
def test_no_payload_from_the_air_raises(payload: bytes) -> None:
    backpack = a_backpack()
    backpack.receive(payload, now_ms=0)
    backpack.poll(now_ms=0)


@given(commands=st.lists(st.tuples(st.integers(1, 60), st.sampled_from(list(Action)), st.integers(0, 300)), max_size=80))
def test_no_command_is_ever_executed_twice_while_it_is_remembered(commands: list[tuple[int, Action, int]]) -> None:
    backpack, now_ms, effects, seen = a_backpack(), 0, [], []
    for number, action, gap_ms in commands:
        now_ms += gap_ms
        effects += hear(backpack, a_command(number, action), now_ms=now_ms) + backpack.poll(now_ms=now_ms)
        seen.append(number)
    done = [one.command for one in actuations(effects)]
    for executed in set(done):
        assert executed is not None
        distinct_since = len(set(seen[seen.index(executed) :]))
        assert done.count(executed) == 1 or distinct_since > 32


def test_a_node_number_that_does_not_fit_the_wire_is_refused() -> None:
    with pytest.raises(ParameterError, match="65534"):
        Backpack(
            node=NodeId(65_535), boot=BOOT, eui64=1, seed=1, config=BackpackConfig(), now_ms=0, sense_neighbours=list,
        )  # fmt: skip
