"""An exploration without files: biobots walk, landmarks are set, and what the mapper wants is returned."""

from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import select_landmarks
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.types import EncounterTable, ModeSpell
from mapper.window import make_encounter_table
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
    before = world.run(_DISPERSION_S).ended
    chosen = select_landmarks(world.adjacency(), count=landmarks)
    for landmark in chosen:
        world.stop(landmark)
    end_s = _DISPERSION_S + duration_s
    after = world.run(end_s).ended
    still = world.open_encounters()
    begin_s = np.concatenate([before.t_start_s, after.t_start_s, np.array([one.t_s for one in still], dtype=np.float64)])
    last_s = np.concatenate([before.t_end_s, after.t_end_s, np.full(len(still), end_s)])
    id1 = np.concatenate([before.id1, after.id1, np.array([one.id1 for one in still], dtype=np.int64)])
    id2 = np.concatenate([before.id2, after.id2, np.array([one.id2 for one in still], dtype=np.int64)])
    counts = last_s > _DISPERSION_S
    begin_s = np.maximum(begin_s[counts], _DISPERSION_S)
    begin, end = (np.rint(times * NS_PER_S).astype(np.int64) for times in (begin_s, last_s[counts]))
    table = make_encounter_table(t_start_ns=begin, t_end_ns=end, id1=id1[counts], id2=id2[counts])
    zero_ns = round(_DISPERSION_S * NS_PER_S)
    spells = tuple(ModeSpell(node=NodeId(one), t_start_ns=zero_ns, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for one in chosen)
    return Exploration(table=table, spells=spells, n_together=int((begin_s == _DISPERSION_S).sum()))
