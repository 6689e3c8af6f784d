"""An exploration without files: biobots walk, landmarks are set, and what the mapper wants is returned."""

from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.types import EncounterTable, ModeSpell
from mapper.window import make_encounter_table
from simulator.events import EncounterEnded
from simulator.world import World

_DISPERSION_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exploration:
    """What a base station would know. ``n_together``: encounters already under way when the landmarks were set; they start then."""

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    n_together: int


def explore(world: World, *, landmarks: int, duration_s: float) -> Exploration:
    """Let biobots disperse for ten seconds, then explore around their landmarks; what is going on at the end ends then.

    Parameters
    ----------
    world
        At its beginning.
    landmarks
        How many.
    duration_s
        Time from when they are set [s].
    """
    events = world.advance(_DISPERSION_S)
    chosen = select_landmarks(world.adjacency(), count=landmarks)
    for landmark in chosen:
        world.stop(landmark)
    end_s = _DISPERSION_S + duration_s
    events += world.advance(end_s)
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, end_s, began.id1, began.id2) for began in world.open_encounters()]
    rows = [(max(begin, _DISPERSION_S), end, first, second) for begin, end, first, second in spans if end > _DISPERSION_S]
    begin, end = (np.rint(np.array([row[k] for row in rows]) * NS_PER_S).astype(np.int64) for k in (0, 1))
    table = make_encounter_table(t_start_ns=begin, t_end_ns=end, id1=[row[2] for row in rows], id2=[row[3] for row in rows])
    zero_ns = round(_DISPERSION_S * NS_PER_S)
    spells = tuple(ModeSpell(node=NodeId(one), t_start_ns=zero_ns, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for one in chosen)
    return Exploration(table=table, spells=spells, n_together=sum(row[0] == _DISPERSION_S for row in rows))
