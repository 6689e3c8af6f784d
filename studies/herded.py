"""An exploration of a place larger than the swarm: a beacon leads it, landmarks are set around the beacon and withdrawn behind it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.landmarks import next_landmark
from firmware_protocol.units import NS_PER_S, NodeId
from mapper.types import EncounterTable, FloatArray, ModeSpell
from mapper.window import make_encounter_table
from simulator.events import EncounterEnded, Event
from simulator.herding import BeaconPath, distances_from, tend
from simulator.world import World

_STEP_S = 1.0
# The swarm is together when all but this share are within the radius.
_STRAGGLERS = 0.03
_MOST_GATHERING_S = 3_000.0
# A landmark is withdrawn when the beacon is this many radii away: others have been set around it by then.
_WITHDRAWN_AT = 1.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HerdedExploration:
    """What a base station would know, and where it was.

    ``positions``, shape (n, 2) [length], is where each encounter of ``table`` was; ``begin_s`` when the beacon set out. ``n_stands`` counts
    how often somebody was made a landmark.
    """

    table: EncounterTable
    spells: tuple[ModeSpell, ...]
    positions: FloatArray
    begin_s: float
    end_s: float
    n_stands: int


def explore_herded(
    world: World,
    path: BeaconPath,
    *,
    radius: float,
    landmarks: int,
    stays: Callable[[tuple[float, float]], bool] = lambda _place: False,
) -> HerdedExploration:
    """Gather the swarm at the path's beginning, lead it along, and return what was met from then on.

    Parameters
    ----------
    world
        At its beginning; it must keep its legs.
    radius
        The beacon's range [length].
    landmarks
        How many are kept standing within the range.
    stays
        Of a place: whether a landmark there is left standing to the end although the beacon has gone on, for the swarm to find again.

    Notes
    -----
    Who is made a landmark is chosen as for one that is lost (``next_landmark``), among those within the beacon's range. Withdrawing needs
    to know no more than that a landmark is out of range; ``stays`` needs whoever carries the beacon to know roughly where it passed.
    """
    gathered_s = _gather(world, path, radius=radius)
    standing: dict[int, float] = {}
    spells: list[ModeSpell] = []
    events: list[Event] = []
    end_s = gathered_s + path.duration_s
    row = {one: index for index, one in enumerate(world.ids)}
    while world.now_s < end_s:
        place = path.at(world.now_s - gathered_s)
        tend(world, place, radius=radius)
        distance = distances_from(world, place)
        for one, since_s in list(standing.items()):
            if distance[row[one]] > _WITHDRAWN_AT * radius and not stays(world.position(one)):
                world.start(one)
                spells.append(_stand(one, since_s, world.now_s))
                del standing[one]
        _set_landmarks(world, standing, near={one for one in world.ids if distance[row[one]] <= radius}, wanted=landmarks)
        events += world.advance(min(end_s, world.now_s + _STEP_S))
    spells += [_stand(one, since_s, None) for one, since_s in standing.items()]
    return _collect(world, events, tuple(spells), begin_s=gathered_s)


def _gather(world: World, path: BeaconPath, *, radius: float) -> float:
    place = path.at(0.0)
    while (distances_from(world, place) > radius).mean() > _STRAGGLERS and world.now_s < _MOST_GATHERING_S:
        # Drawn in a little further, they are not about to leave at once.
        tend(world, place, radius=0.9 * radius)
        world.advance(world.now_s + _STEP_S)
    return world.now_s


def _set_landmarks(world: World, standing: dict[int, float], *, near: set[int], wanted: int) -> None:
    lacking = wanted - len(near & standing.keys())
    if lacking <= 0:
        return
    adjacency = world.adjacency()
    heard = {one: adjacency[one] & near for one in sorted(near)}
    for _ in range(lacking):
        chosen = next_landmark(heard, standing=near & standing.keys(), eligible=near - standing.keys())
        if chosen is None:
            return
        world.stop(chosen)
        standing[chosen] = world.now_s


def _stand(node: int, begin_s: float, end_s: float | None) -> ModeSpell:
    end_ns = None if end_s is None else round(end_s * NS_PER_S)
    return ModeSpell(node=NodeId(node), t_start_ns=round(begin_s * NS_PER_S), t_end_ns=end_ns, mode=Mode.S, cause=Cause.COMMAND)


def _collect(world: World, events: list[Event], spells: tuple[ModeSpell, ...], *, begin_s: float) -> HerdedExploration:
    spans = [(event.t_start_s, event.t_end_s, event.id1, event.id2) for event in events if isinstance(event, EncounterEnded)]
    spans += [(began.t_s, world.now_s, began.id1, began.id2) for began in world.open_encounters()]
    rows = np.array([(max(begin, begin_s), end, one, other) for begin, end, one, other in spans if end > begin_s])
    t_start_ns, t_end_ns = (np.rint(column * NS_PER_S).astype(np.int64) for column in rows.T[:2])
    table = make_encounter_table(t_start_ns=t_start_ns, t_end_ns=t_end_ns, id1=rows[:, 2].astype(np.int64), id2=rows[:, 3].astype(np.int64))
    return HerdedExploration(
        table=table,
        spells=spells,
        positions=positions_of_encounters(world, table),
        begin_s=begin_s,
        end_s=world.now_s,
        n_stands=len(spells),
    )


def positions_of_encounters(world: World, table: EncounterTable) -> FloatArray:
    """Tell where encounters were: the middle between their biobots at their centre times, shape (n, 2) [length]."""
    centre_s = np.minimum((table.t_start_ns + table.t_end_ns) / (2.0 * NS_PER_S), world.now_s)
    return np.asarray((world.positions_of(table.id1, centre_s) + world.positions_of(table.id2, centre_s)) / 2.0)
