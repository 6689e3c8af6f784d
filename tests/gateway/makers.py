"""Small makers of values for the gateway's tests."""

from firmware_protocol.contract.records import EncounterRecord, Mode, ModeRecord
from firmware_protocol.units import BootId, Nanoseconds
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
