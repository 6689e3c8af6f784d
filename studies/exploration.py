"""An exploration without files: biobots walk, landmarks are set, and what the mapper wants is returned."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.types import EncounterTable, ModeSpell
from mapper.window import make_encounter_table
from simulator.events import Cause as SimulatedCause
from simulator.events import EncounterEnded, Event, ModeChanged
from simulator.events import Mode as SimulatedMode
from simulator.world import World

DISPERSION_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exploration:
    """What a base station would know. ``n_together``: encounters already under way when the landmarks were set; they start then."""

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    n_together: int


def explore(world: World, *, landmarks: int, duration_s: float, dispersion_s: float = DISPERSION_S, n_silenced: int = 0) -> Exploration:
    """Let biobots disperse, then explore around their landmarks; what is going on at the end ends then.

    Parameters
    ----------
    world
        At its beginning.
    landmarks
        How many.
    duration_s
        Time from when they are set [s].
    dispersion_s
        Time before [s].
    n_silenced
        How many landmarks' backpacks are off from the middle of that time on; nobody at the base station knows.
    """
    events = world.advance(dispersion_s)
    chosen = select_landmarks(world.adjacency(), count=landmarks)
    for landmark in chosen:
        world.stop(landmark)
    end_s = dispersion_s + duration_s
    if n_silenced:
        events += world.advance(dispersion_s + duration_s / 2)
        for landmark in chosen[:n_silenced]:
            world.silence(landmark)
    events += world.advance(end_s)
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, end_s, began.id1, began.id2) for began in world.open_encounters()]
    zero_ns = round(dispersion_s * NS_PER_S)
    commanded = tuple(ModeSpell(node=NodeId(one), t_start_ns=zero_ns, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for one in chosen)
    n_together = sum(begin <= dispersion_s < end for begin, end, _, _ in spans)
    return Exploration(table=tabulate(spans, from_s=dispersion_s), spells=commanded + _natural_stops(events), n_together=n_together)


def tabulate(spans: Sequence[tuple[float, float, int, int]], *, from_s: float) -> EncounterTable:
    """Make the table of encounters ``(start_s, end_s, id1, id2)`` that end after an instant; those under way then start then."""
    rows = [(max(begin, from_s), end, first, second) for begin, end, first, second in spans if end > from_s]
    begin, end = (np.rint(np.array([row[k] for row in rows]) * NS_PER_S).astype(np.int64) for k in (0, 1))
    return make_encounter_table(t_start_ns=begin, t_end_ns=end, id1=[row[2] for row in rows], id2=[row[3] for row in rows])


def _natural_stops(events: Sequence[Event]) -> tuple[ModeSpell, ...]:
    """Make a spell of every time that an insect stood still by itself."""
    since: dict[int, float] = {}
    spells = []
    for event in events:
        if not isinstance(event, ModeChanged):
            continue
        begin = since.pop(event.id, None)
        if begin is not None:
            spells.append(_stop(event.id, begin, event.t_s))
        if event.mode is SimulatedMode.S and event.cause is SimulatedCause.NATURAL:
            since[event.id] = event.t_s
    return (*spells, *(_stop(one, begin, None) for one, begin in since.items()))


def _stop(one: int, begin_s: float, end_s: float | None) -> ModeSpell:
    end_ns = None if end_s is None else round(end_s * NS_PER_S)
    return ModeSpell(node=NodeId(one), t_start_ns=round(begin_s * NS_PER_S), t_end_ns=end_ns, mode=Mode.S, cause=Cause.NATURAL)
