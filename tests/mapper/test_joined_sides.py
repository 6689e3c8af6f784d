"""What two gateways say of the sides that each of them heard, joined by the mapper, is what one gateway says of both."""

from contextlib import closing

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import EncounterRecord, RecordBatch
from firmware_protocol.units import NS_PER_MS, BootId, Nanoseconds, NodeId, RssiDbm
from gateway.encounters import margin_of
from gateway.issuer import RecordIssuer
from gateway.meetings import SideReport, meeting_of
from gateway.unheard import guesses
from mapper.store import Store


@given(a_ms=st.tuples(st.integers(0, 900), st.integers(5000, 5900)), b_ms=st.tuples(st.integers(0, 900), st.integers(5000, 5900)))
def test_two_one_sided_records_of_beacons_come_out_as_one_gateways_record_of_both(a_ms: tuple[int, int], b_ms: tuple[int, int]) -> None:
    """All beacons are heard, one a second.

    First ones at 0.2 s and 0.7 s: each side alone says half a second earlier, -0.3 s and 0.2 s, give or take 0.5 s. Both together say the
    middle of -0.3 s, before which the later one would have heard a beacon, and 0.2 s: -0.05 s. Beacons that come early or late blur that.
    """
    pair = (NodeId(1), NodeId(2))
    reports = [
        SideReport(
            node=pair[side],
            peer=pair[1 - side],
            t_start_ns=Nanoseconds(10**9 + times[0] * NS_PER_MS),
            t_end_ns=Nanoseconds(10**9 + times[1] * NS_PER_MS),
            error_ns=Nanoseconds(0),
            rssi_dbm=RssiDbm(-60),
            is_ongoing=False,
            margin_ns=margin_of(beacon_period_ms=1000, error_ns=0),
            period_ns=10**9,
        )
        for side, times in enumerate((a_ms, b_ms))
    ]

    def record(gateway: str, *told: SideReport) -> EncounterRecord:
        meeting = meeting_of(told[0], boot=BootId(1), sequence=0)
        for one in told[1:]:
            meeting.take(one)
        issuer = RecordIssuer(gateway=gateway, journal=gateway, boot=BootId(1), wall_anchor_ns=Nanoseconds(0))
        return meeting.record(pair, issuer=issuer, guesses=guesses(0.0))

    with closing(Store(None)) as store:
        apart = [record(name, report) for name, report in zip(("north", "south"), reports, strict=True)]
        store.apply([RecordBatch(gateway=one.gateway, journal=one.journal, head_offset=1, records=(one,)) for one in apart])
        rows = store.delta(after=0).encounters
        ((begin, end),) = zip(rows.t_start_ns[rows.counts].tolist(), rows.t_end_ns[rows.counts].tolist(), strict=True)
    both = record("one", *reports)
    assert abs(begin - both.t_start_ns) <= 80 * NS_PER_MS
    assert abs(end - both.t_end_ns) <= 80 * NS_PER_MS
