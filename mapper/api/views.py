"""From the mapper's values to the JSON objects that ``schemas`` describes."""

import time
from collections import defaultdict
from collections.abc import Iterable

import msgspec
from fastapi import Response
from msgspec import UnsetType

from firmware_protocol.contract.records import EncounterRecord, GatewayStatus
from mapper.current_map import MapStatus
from mapper.encounter_pages import JointEncounter
from mapper.fleet import BiobotView, GatewayView
from mapper.gateway_clocks import SourceClock
from mapper.presence import Presence

JSON_TYPE = "application/json"

_encoder = msgspec.json.Encoder()


def json_response(value: object, *, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    """Encode a value that is fresh with every request."""
    return Response(
        _encoder.encode(value), status_code=status, media_type=JSON_TYPE, headers={"Cache-Control": "no-store", **(headers or {})}
    )


def view_gateway(view: GatewayView) -> dict[str, object]:
    """Describe a gateway."""
    status: GatewayStatus | None = view.status
    return {
        "name": view.name,
        "is_alive": view.is_alive,
        "radios": status.radios if status else {},
        "radios_up": list(view.radios_up),
        "counters": status.counters if status else {},
    }


def view_biobot(view: BiobotView, presence: Presence) -> dict[str, object]:
    """Describe a biobot."""
    return {
        "id": view.node,
        "key": str(view.node),
        "gateway": view.gateway,
        "is_reachable": view.is_reachable,
        "state": presence,
        "mode": view.mode,
        "cause": view.cause,
        "is_landmark": view.is_landmark,
        "is_halted": view.is_halted,
        "radio": view.radio,
        "battery_mv": view.battery_mv,
        "rssi_dbm": view.rssi_dbm,
        "lqi": view.lqi,
        "last_heard_wall_ns": view.last_heard_wall_ns,
        "silence_s": None if view.silence_s is None else round(view.silence_s, 3),
        "buffered": view.buffered,
        "dropped": view.dropped,
        "firmware": view.firmware,
        "n_neighbours": view.n_neighbours,
        "n_encounters": view.n_encounters,
    }


def view_map_status(status: MapStatus) -> dict[str, object]:
    """Describe how the newest finished map stands to the records; all of the map is null before the first."""
    document: dict[str, object] = {
        "now_wall_ns": time.time_ns(),
        "n_known": status.n_known,
        "n_waiting": status.n_waiting,
        "behind_s": status.behind_s,
        "is_computing": status.is_computing,
        "waiting": status.waiting,
    }
    finished = status.snapshot.finished if status.snapshot else None
    of = finished.documents if finished else None
    return document | {
        "version": finished and finished.version,
        "begun_wall_ns": finished and finished.begun_wall_ns,
        "computed_wall_ns": finished and finished.computed_wall_ns,
        "computing_s": finished and finished.computing_s,
        "n_encounters": of and of.n_encounters,
        "n_before": of and of.n_before,
        "since_wall_ns": of and of.since_ns,
        "n_ahead": of and of.n_ahead,
        "last_encounter_wall_ns": of and of.last_encounter_ns,
    }


def view_encounter(record: EncounterRecord, *, shift_ns: int, bound_ns: int, joint: JointEncounter | None) -> dict[str, object]:
    """Describe an encounter, its instants on the site's wall clock: that of its gateway and ``shift_ns``, wrong by up to ``bound_ns``."""
    return {
        "gateway": record.gateway,
        "journal": record.journal,
        "boot": record.boot,
        "sequence": record.sequence,
        "revision": record.revision,
        "node_a": record.node_a,
        "node_b": record.node_b,
        "t_start_wall_ns": record.t_start_ns + record.wall_anchor_ns + shift_ns,
        "t_end_wall_ns": record.t_end_ns + record.wall_anchor_ns + shift_ns,
        "clock_shift_ns": shift_ns,
        "error_ns": record.error_ns + bound_ns,
        "is_reciprocal": record.is_reciprocal,
        "is_ongoing": record.is_ongoing,
        "is_void": record.is_void,
        "own_clocks": [
            {"node": side.node, "boot": own.boot, "start_ms": own.start_ms, "end_ms": own.end_ms}
            for side in record.sides
            if not isinstance(own := side.own_clock, UnsetType)
        ],
        "joint": None if joint is None else _view_joint(joint, record),
    }


def _view_joint(joint: JointEncounter, record: EncounterRecord) -> dict[str, object]:
    return {
        "is_counted": joint.identities[0] == record.identity,
        "t_start_wall_ns": joint.t_start_ns,
        "t_end_wall_ns": joint.t_end_ns,
        "is_reciprocal": joint.is_reciprocal,
        "records": [
            {"gateway": gateway, "journal": journal, "boot": boot, "sequence": sequence}
            for gateway, journal, boot, sequence in joint.identities
        ],
    }


def view_gateways(views: Iterable[GatewayView], clocks: Iterable[SourceClock]) -> list[dict[str, object]]:
    """Describe gateways by name, and the clocks of all their starts, the newest first; one that is known by its records alone too."""
    starts: defaultdict[str, list[SourceClock]] = defaultdict(list)
    for clock in sorted(clocks, key=lambda clock: -clock.last_row):
        starts[clock.source.gateway].append(clock)
    described = {view.name: view_gateway(view) for view in views}
    absent = {"is_alive": False, "radios": {}, "counters": {}}
    return [
        {**(described.get(name) or {"name": name, **absent}), "clocks": [_view_clock(clock) for clock in starts[name]]}
        for name in sorted(described.keys() | starts.keys())
    ]


def _view_clock(clock: SourceClock) -> dict[str, object]:
    is_known = clock.offset_ns is not None
    return {
        "wall_anchor_ns": clock.source.anchor_ns,
        "reference": clock.reference.gateway if is_known else None,
        "ahead_ns": None if clock.offset_ns is None else -clock.offset_ns,
        "bound_ns": clock.bound_ns if is_known else None,
        "n_shared": clock.n_votes,
        "since_wall_ns": clock.since_ns,
        "is_corrected": clock.is_corrected,
    }
