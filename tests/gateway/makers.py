"""Small makers of values for the gateway's tests."""

from firmware_protocol.contract.records import Cause, EncounterRecord, EncounterSide, Mode, ModeRecord
from firmware_protocol.units import NS_PER_S, BootId, Nanoseconds, NodeId, RssiDbm
from gateway.issuer import RecordIssuer


def an_issuer(*, boot: int = 1, anchor_ns: int = 0) -> RecordIssuer:
    return RecordIssuer(gateway="base1", journal="feed", boot=BootId(boot), wall_anchor_ns=Nanoseconds(anchor_ns))


def newest_encounters(records: list[EncounterRecord]) -> list[EncounterRecord]:
    """The last revision of each record that is not void, by time."""
    newest = {record.identity: record for record in records}
    return sorted(
        (record for record in newest.values() if not record.is_void), key=lambda record: (record.node_a, record.node_b, record.t_start_ns)
    )


def newest_modes(records: list[ModeRecord]) -> list[tuple[Mode, int, int | None]]:
    newest = {record.identity: record for record in records}
    spells = sorted(newest.values(), key=lambda record: record.t_start_ns)
    return [(spell.mode, spell.t_start_ns, spell.t_end_ns) for spell in spells]


def an_encounter_record(*, sequence: int, node_a: int, node_b: int, t_start_s: int, t_end_s: int, revision: int = 0) -> EncounterRecord:
    """An encounter whose wall clock is its monotonic one."""
    return EncounterRecord(
        gateway="base1",
        journal="feed",
        offset=1,
        boot=BootId(1),
        sequence=sequence,
        revision=revision,
        wall_anchor_ns=Nanoseconds(0),
        node_a=NodeId(node_a),
        node_b=NodeId(node_b),
        t_start_ns=Nanoseconds(t_start_s * NS_PER_S),
        t_end_ns=Nanoseconds(t_end_s * NS_PER_S),
        error_ns=Nanoseconds(0),
        is_reciprocal=False,
        sides=(
            EncounterSide(
                node=NodeId(node_a),
                t_start_ns=Nanoseconds(t_start_s * NS_PER_S),
                t_end_ns=Nanoseconds(t_end_s * NS_PER_S),
                rssi_dbm=RssiDbm(-60),
            ),
        ),
    )


def a_mode_record(*, sequence: int, node: int, mode: Mode) -> ModeRecord:
    return ModeRecord(
        gateway="base1",
        journal="feed",
        offset=1,
        boot=BootId(1),
        sequence=sequence,
        revision=0,
        wall_anchor_ns=Nanoseconds(0),
        node=NodeId(node),
        mode=mode,
        cause=Cause.NATURAL,
        t_start_ns=Nanoseconds(sequence),
        t_end_ns=None,
        error_ns=Nanoseconds(0),
    )
