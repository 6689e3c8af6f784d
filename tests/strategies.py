"""Hypothesis strategies for what travels: frames, messages, envelopes, records."""

from hypothesis import strategies as st

from firmware_protocol.contract.records import (
    Cause,
    EncounterRecord,
    EncounterSide,
    JournalRecord,
    MissionPhase,
    MissionRecord,
    Mode,
    ModeRecord,
)
from firmware_protocol.envelope import (
    ConfigureCoordinator,
    CoordinatorConfigured,
    CoordinatorHello,
    CoordinatorLog,
    Envelope,
    IdentifyRequest,
    NodeJoined,
    RadioConfirm,
    RadioReceived,
    RadioSend,
)
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    MAX_PATH_MM,
    Acknowledge,
    Action,
    ConfigurationReport,
    ConfigurationRequest,
    ConfigurationResult,
    Configure,
    Diagnostic,
    Downlink,
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    Hello,
    HelloRequest,
    Level,
    Limits,
    Neighbour,
    Neighbours,
    Status,
    Stimulate,
    StimulateReply,
    StimulationResult,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    Waveform,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, Milliseconds, Nanoseconds, NodeId, RssiDbm, ShortAddress

u8 = st.integers(0, 0xFF)
u16 = st.integers(0, 0xFFFF)
u32 = st.integers(0, 0xFFFF_FFFF)
u64 = st.integers(0, 0xFFFF_FFFF_FFFF_FFFF)
nodes = st.integers(0, 0xFFFE).map(NodeId)
boots = u16.map(BootId)
ticks = u32.map(Milliseconds)
rssi = st.integers(-128, 127).map(RssiDbm)
instants = st.integers(-(2**62), 2**62).map(Nanoseconds)

frame_bodies = st.binary(min_size=1, max_size=250)

uplink_headers = st.builds(UplinkHeader, node=nodes, boot=boots, sequence=u16, sent_ms=ticks)

_entry = {
    "peer": nodes,
    "start_ms": ticks,
    "duration_ms": st.integers(0, MAX_ENCOUNTER_MS).map(Milliseconds),
    "rssi_dbm": rssi,
    "is_ongoing": st.booleans(),
}
encounter_entries = st.builds(EncounterEntry, **_entry)
encounter_entries_with_paths = st.builds(EncounterEntry, **_entry, path_mm=st.none() | st.integers(0, MAX_PATH_MM))
configurations = {
    "token": u16,
    "beacon_period_ms": u16,
    "rssi_enter_dbm": rssi,
    "rssi_exit_dbm": rssi,
    "gap_tolerance_ms": u16,
    "report_period_ms": u16,
}
versions = st.integers(1, 255)


def short_texts(limit: int) -> st.SearchStrategy[str]:
    """Return texts of at most ``limit`` octets of UTF-8."""
    return st.text(max_size=limit).filter(lambda text: len(text.encode(errors="replace")) <= limit)


@st.composite
def neighbour_parts(draw: st.DrawFn) -> Neighbours:
    n_parts = draw(st.integers(1, 255))
    part = draw(st.integers(0, n_parts - 1))
    some = draw(st.lists(st.builds(Neighbour, node=nodes, rssi_dbm=rssi), max_size=10))
    return Neighbours(part=part, n_parts=n_parts, neighbours=tuple(some))


uplinks: st.SearchStrategy[Uplink] = st.one_of(
    st.builds(Hello, eui64=u64, firmware=u16, beacon_period_ms=u16, capabilities=u16, newest_version=versions),
    st.builds(EncounterBatch, entries=st.lists(encounter_entries, min_size=1, max_size=4).map(tuple)),
    st.builds(
        Status,
        mode=st.sampled_from(WireMode),
        cause=st.sampled_from(WireCause),
        mode_since_ms=ticks,
        battery_mv=u16,
        buffered=u16,
        dropped=u16,
    ),
    neighbour_parts(),
    st.builds(TimeSyncReply, token=u16, received_ms=ticks),
    st.builds(StimulateReply, command=u32, result=st.sampled_from(StimulationResult), executed_ms=ticks, mode=st.sampled_from(WireMode)),
    st.builds(
        Limits,
        channels=u8,
        waveforms=u8,
        max_frequency_hz=u8,
        max_pulse_width_us=u16,
        max_amplitude_mv=u16,
        max_duration_ms=u16,
        min_gap_ms=u16,
        max_on_ms_per_minute=u16,
        battery_mv=u16,
        battery_empty_mv=u16,
        encounter_capacity=u16,
    ),
    st.builds(EncounterBatchWithPaths, entries=st.lists(encounter_entries_with_paths, min_size=1, max_size=3).map(tuple)),
    st.builds(Diagnostic, level=st.sampled_from(Level), code=u16, argument=u32, at_ms=ticks, text=short_texts(32)),
    st.builds(ConfigurationReport, **configurations, result=st.sampled_from(ConfigurationResult)),
)

downlinks: st.SearchStrategy[Downlink] = st.one_of(
    st.builds(HelloRequest, newest_version=versions),
    st.builds(Acknowledge, boot=boots, next_sequence=u16, bitmap=u32),
    st.builds(TimeSyncRequest, token=u16),
    st.builds(
        Stimulate,
        command=u32,
        action=st.sampled_from(Action),
        ttl_ms=u16,
        hold_ms=u32,
        frequency_hz=u8,
        pulse_width_us=u16,
        amplitude_mv=u16,
        duration_ms=u16,
        channel=u8,
        waveform=st.sampled_from(Waveform),
    ),
    st.builds(Configure, **configurations),
    st.builds(ConfigurationRequest, token=u16),
)

radio_payloads = st.binary(max_size=57)
envelopes: st.SearchStrategy[Envelope] = st.one_of(
    st.just(IdentifyRequest()),
    st.builds(CoordinatorHello, firmware=u16, eui64=u64, pan_id=u16, channel=u8, max_radio_payload=u8),
    st.builds(RadioSend, handle=u16, destination=u16.map(ShortAddress), payload=radio_payloads),
    st.builds(RadioConfirm, handle=u16, status=u8),
    st.builds(RadioReceived, source=u16.map(ShortAddress), rssi_dbm=rssi, lqi=u8, payload=radio_payloads),
    st.builds(CoordinatorLog, level=st.integers(0, 3), code=u16, text=short_texts(58)),
    st.builds(ConfigureCoordinator, token=u16, pan_id=u16, channel=u8, permit_join_s=u8),
    st.builds(CoordinatorConfigured, token=u16, result=st.integers(0, 2), pan_id=u16, channel=u8, permit_join_s=u8),
    st.builds(NodeJoined, address=u16.map(ShortAddress), eui64=u64),
)

_heads = {
    "gateway": st.sampled_from(["base1", "base2"]),
    "journal": st.just("5f0c9a31"),
    "offset": st.integers(1, 2**40),
    "boot": st.integers(0, 2**40).map(BootId),
    "sequence": st.integers(0, 2**40),
    "revision": st.integers(0, 100),
    "wall_anchor_ns": instants,
}
sides = st.builds(
    EncounterSide, node=nodes, t_start_ns=instants, t_end_ns=instants, rssi_dbm=rssi, path_mm=st.none() | st.integers(0, MAX_PATH_MM)
)
journal_records: st.SearchStrategy[JournalRecord] = st.one_of(
    st.builds(
        EncounterRecord,
        **_heads,
        node_a=nodes,
        node_b=nodes,
        t_start_ns=instants,
        t_end_ns=instants,
        error_ns=instants,
        is_reciprocal=st.booleans(),
        is_ongoing=st.booleans(),
        is_void=st.booleans(),
        sides=st.lists(sides, max_size=3).map(tuple),
    ),
    st.builds(
        ModeRecord,
        **_heads,
        node=nodes,
        mode=st.sampled_from(Mode),
        cause=st.sampled_from(Cause),
        t_start_ns=instants,
        t_end_ns=st.none() | instants,
        error_ns=instants,
    ),
    st.builds(
        MissionRecord,
        **_heads,
        phase=st.sampled_from(MissionPhase),
        t_start_ns=instants,
        landmarks=st.lists(nodes, max_size=5).map(tuple),
        reason=st.text(max_size=20),
    ),
)
