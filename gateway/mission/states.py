"""The mission's state as journal records, and back."""

import msgspec

from firmware_protocol.contract.records import MissionPhase, MissionRecord, WallPhase
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.issuer import RecordIssuer
from gateway.mission.steps import MissionState


def record_phase(state: MissionState, *, issuer: RecordIssuer, now_ns: int) -> MissionRecord:
    """Return the record of a phase that begins now [monotonic]; the journal gives its offset."""
    return MissionRecord(
        gateway=issuer.gateway,
        journal=issuer.journal,
        offset=1,
        boot=issuer.boot,
        sequence=issuer.take_sequence(),
        revision=0,
        wall_anchor_ns=issuer.wall_anchor_ns,
        phase=state.phase,
        t_start_ns=Nanoseconds(now_ns),
        operator=state.operator,
        order_id=state.order_id,
        reason=state.reason,
        round=state.round,
        is_continued=state.is_continued,
        interrupted=state.interrupted,
        ran_ns=state.began_ns,
        spent_ns=state.spent_ns,
        explored_ns=state.explored_ns,
        landmarks=tuple(sorted(state.landmarks)),
        releasing={int(node): decided_ns for node, decided_ns in state.releasing.items()},
        choice=state.choice,
        changes=state.changes,
        walls=_walls_of(state),
    )


def revise_phase(record: MissionRecord, state: MissionState) -> MissionRecord:
    """Return the next revision of a phase's record: the same phase, as it stands now."""
    return msgspec.structs.replace(
        record,
        revision=record.revision + 1,
        landmarks=tuple(sorted(state.landmarks)),
        releasing={int(node): decided_ns for node, decided_ns in state.releasing.items()},
        choice=state.choice,
        changes=state.changes,
        reason=state.reason,
        walls=_walls_of(state),
    )


def restore_state(record: MissionRecord, *, issuer: RecordIssuer, now_ns: int, now_ran_ns: int) -> MissionState:
    """Return the state that a record tells of.

    Parameters
    ----------
    now_ns, now_ran_ns
        Now on the monotonic clock, and how long gateways have run on the journal: a record of an older gateway does not say how long they
        had when it began, and its phase is taken to have run since.
    """
    began_ns = record.ran_ns
    if began_ns is None:
        since_ns = issuer.to_own_monotonic_ns(record.t_start_ns, anchor_ns=record.wall_anchor_ns)
        began_ns = now_ran_ns - max(0, now_ns - since_ns)
    interrupted = record.interrupted
    walls = WallPhase(number=0) if record.walls is msgspec.UNSET else record.walls
    if record.phase is MissionPhase.PAUSED and interrupted is None:
        interrupted = MissionPhase.IDLE  # no gateway writes that
    return MissionState(
        phase=record.phase,
        began_ns=began_ns,
        spent_ns=record.spent_ns,
        explored_ns=record.explored_ns,
        round=record.round,
        landmarks=frozenset(record.landmarks),
        releasing={NodeId(node): decided_ns for node, decided_ns in record.releasing.items()},
        choice=record.choice,
        changes=record.changes,
        wall_phase=walls.number,
        following={NodeId(node): decided_ns for node, decided_ns in walls.following.items()},
        interrupted=interrupted,
        is_continued=record.is_continued,
        reason=record.reason,
        operator=record.operator,
        order_id=record.order_id,
    )


def _walls_of(state: MissionState) -> WallPhase | msgspec.UnsetType:
    if not state.wall_phase and not state.following:
        return msgspec.UNSET
    return WallPhase(number=state.wall_phase, following={int(node): decided_ns for node, decided_ns in state.following.items()})
