"""What gateways announce beside states, unjournaled: whom a biobot hears, and what an operator may want to know (CONTRACT.md §4)."""

from firmware_protocol.contract.records import AnyNode, Struct
from firmware_protocol.first_use import prepare
from firmware_protocol.units import Nanoseconds, RssiDbm


class NeighbourEntry(Struct, frozen=True, kw_only=True):
    """A biobot within communication range."""

    node: AnyNode
    rssi_dbm: RssiDbm


class NeighbourReport(Struct, frozen=True, kw_only=True):
    """All that a biobot had within communication range in its last report."""

    gateway: str
    node: AnyNode
    wall_ns: Nanoseconds
    neighbours: tuple[NeighbourEntry, ...]


class GatewayEvent(Struct, frozen=True, kw_only=True):
    """Something an operator may want to know; ``kind`` is dotted, as in ``radio.down``."""

    gateway: str
    wall_ns: Nanoseconds
    level: str
    kind: str
    facts: dict[str, str]


prepare(NeighbourReport, GatewayEvent)
