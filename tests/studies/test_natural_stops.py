"""Natural stops, from the simulated insect's backpack to the gateway's records: each spell once, with its cause, at its time."""

from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode, ModeRecord
from firmware_protocol.message_codec import decode_uplink
from firmware_protocol.messages import Status, UplinkHeader, WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, BootId, Nanoseconds, NodeId
from gateway.issuer import RecordIssuer
from gateway.modes import ModeReport, ModeTracker
from gateway.nodes import cause_of, mode_of
from simulator.backpacks.backpack import Backpack, Transmission
from simulator.backpacks.backpack_config import BackpackConfig


def _statuses(stops_ms: list[int]) -> list[tuple[UplinkHeader, Status]]:
    """Have an insect stop and walk on at these instants, and return what its backpack says of its mode."""
    backpack = Backpack(
        node=NodeId(1), boot=BootId(1), eui64=1, seed=1, config=BackpackConfig(), now_ms=0, sense_neighbours=lambda: ()
    )  # fmt: skip
    said: list[tuple[UplinkHeader, Status]] = []
    mode = WireMode.S
    for at_ms in [*stops_ms, stops_ms[-1] + 100]:
        for effect in backpack.poll(now_ms=at_ms):
            if isinstance(effect, Transmission) and isinstance(effect.message, Status):
                decoded = decode_uplink(effect.payload)
                assert isinstance(decoded, tuple)
                header, message = decoded
                assert isinstance(message, Status)
                said.append((header, message))
        if at_ms in stops_ms:
            backpack.change_mode(mode, WireCause.NATURAL, at_ms=at_ms)
            mode = WireMode.CRW if mode is WireMode.S else WireMode.S
    return said


@settings(max_examples=40)
@given(gaps_ms=st.lists(st.integers(1_100, 20_000), min_size=1, max_size=8), data=st.data())
def test_natural_stops_become_spells_at_their_times_in_whatever_order_they_are_heard(gaps_ms: list[int], data: st.DataObject) -> None:
    stops_ms = [sum(gaps_ms[: number + 1]) for number in range(len(gaps_ms))]
    tracker = ModeTracker(
        issuer=RecordIssuer(gateway="g", journal="j", boot=BootId(1), wall_anchor_ns=Nanoseconds(0)),
    )
    newest: dict[tuple[int, int], ModeRecord] = {}
    for _, status in data.draw(st.permutations(_statuses(stops_ms))):
        report = ModeReport(
            node=NodeId(1), boot=BootId(1), since_ms=status.mode_since_ms,
            t_start_ns=Nanoseconds(status.mode_since_ms * NS_PER_MS), error_ns=Nanoseconds(0),
            mode=mode_of(status.mode), cause=cause_of(status.cause), is_from_reply=False,
        )  # fmt: skip
        newest |= {(record.boot, record.sequence): record for record in tracker.observe(report)}
    spells = sorted(newest.values(), key=lambda record: record.t_start_ns)
    told = {(record.t_start_ns // NS_PER_MS, record.mode) for record in spells}
    modes = [Mode.S if number % 2 == 0 else Mode.CRW for number in range(len(stops_ms))]
    assert set(zip(stops_ms, modes, strict=True)) <= told
    assert {record.cause for record in spells} == {Cause.NATURAL}
    ends = [record.t_end_ns for record in spells]
    assert ends == [*(record.t_start_ns for record in spells[1:]), None], "one ends where the next begins"
