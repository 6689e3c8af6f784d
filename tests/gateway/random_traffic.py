"""Uplink messages of a small swarm, drawn from a seed: of every kind that makes records, in and out of order, over several lives."""

import random
from collections.abc import Iterator
from dataclasses import dataclass

from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import (
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    Hello,
    Status,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import NS_PER_MS, NS_PER_S, RSSI_UNKNOWN, BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from gateway.radio import RadioMessage

BEGUN_NS = 10**6 * NS_PER_S
N_NODES = 6


@dataclass(slots=True, kw_only=True)
class _Backpack:
    node: int
    boot: int
    booted_ns: int
    sequence: int = 0


def random_messages(seed: int, *, n: int, has_beacons: bool) -> Iterator[RadioMessage]:
    """Yield messages, some of them twice or late, from two radios; with beacons, the backpacks send one a second."""
    draw = random.Random(seed)
    backpacks = {node: _Backpack(node=node, boot=1, booted_ns=BEGUN_NS - 60 * NS_PER_S) for node in range(1, N_NODES + 1)}
    now_ns, held = BEGUN_NS, []
    for number in range(n):
        now_ns += draw.randrange(1, 400) * NS_PER_MS
        backpack = backpacks[1 + number % N_NODES if number < N_NODES else draw.randrange(1, N_NODES + 1)]
        if draw.random() < 0.003:
            backpack.boot, backpack.booted_ns, backpack.sequence = backpack.boot + 1, now_ns - 2 * NS_PER_S, 0
        sent_ms = (now_ns - backpack.booted_ns) // NS_PER_MS
        header = UplinkHeader(
            node=NodeId(backpack.node), boot=BootId(backpack.boot), sequence=backpack.sequence % 65536, sent_ms=Milliseconds(sent_ms)
        )
        backpack.sequence += 1
        message = RadioMessage(
            radio=f"radio{backpack.node % 2}",
            source=ShortAddress(0x1000 + backpack.node),
            rssi_dbm=RssiDbm(-draw.randrange(30, 90)),
            lqi=draw.randrange(256),
            payload=encode_uplink(
                header, _message(draw, backpack.node, sent_ms=sent_ms, is_first=backpack.sequence == 1, beacons=has_beacons)
            ),
            received_ns=now_ns + draw.randrange(1, 30) * NS_PER_MS,
        )
        if draw.random() < 0.08:
            held.append(message)
            continue
        yield message
        if draw.random() < 0.1:
            yield message
        if held and draw.random() < 0.2:
            yield held.pop(draw.randrange(len(held)))
    yield from held


def _message(draw: random.Random, node: int, *, sent_ms: int, is_first: bool, beacons: bool) -> Uplink:
    if is_first or draw.random() < 0.03:
        return Hello(eui64=node, firmware=1, beacon_period_ms=draw.choice((500, 1000)) if beacons else 0, capabilities=1)
    if draw.random() < 0.06:
        return Status(
            mode=draw.choice(tuple(WireMode)), cause=draw.choice(tuple(WireCause)), mode_since_ms=Milliseconds(max(0, sent_ms - 300)),
            battery_mv=3000, buffered=0, dropped=0,
        )  # fmt: skip
    has_paths = draw.random() < 0.3
    entries = tuple(_entry(draw, sent_ms=sent_ms, has_paths=has_paths) for _ in range(draw.randrange(1, 4 if has_paths else 5)))
    return EncounterBatchWithPaths(entries=entries) if has_paths else EncounterBatch(entries=entries)


def _entry(draw: random.Random, *, sent_ms: int, has_paths: bool) -> EncounterEntry:
    """An encounter with anybody, now and then with oneself, begun up to 20 s ago, rarely in the future."""
    start_ms = max(0, sent_ms - draw.randrange(-50, 20_000))
    return EncounterEntry(
        peer=NodeId(draw.randrange(1, N_NODES + 3)),
        start_ms=Milliseconds(start_ms),
        duration_ms=Milliseconds(draw.choice((0, draw.randrange(400), draw.randrange(6_000)))),
        rssi_dbm=RSSI_UNKNOWN if draw.random() < 0.1 else RssiDbm(-draw.randrange(30, 90)),
        is_ongoing=draw.random() < 0.2,
        path_mm=draw.randrange(60_000) if has_paths and draw.random() < 0.7 else None,
    )
