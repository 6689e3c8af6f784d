"""A beacon that keeps a swarm together and leads it."""

import pytest
import shapely

from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.errors import ParameterError
from simulator.herding import BeaconPath, distances_from, tend
from simulator.motion import MotionParameters
from simulator.world import World


def _world(n: int = 40) -> World:
    return World(
        build_arena(shapely.box(0, 0, 60, 20)),
        motion=MotionParameters(speed=1.0, mean_leg=10.0),
        ranges=Ranges(detection=1.0, communication=8.0),
        ids=range(1, n + 1),
        seed=3,
    )


def test_a_beacon_goes_its_way_at_its_speed_and_stays_at_the_end() -> None:
    path = BeaconPath([(0, 0), (3, 4), (3, 10)], speed=2.0)
    assert path.duration_s == 5.5
    assert [path.at(t_s) for t_s in (-1, 0, 1.25, 2.5, 4, 99)] == [(0, 0), (0, 0), (1.5, 2), (3, 4), (3, 7), (3, 10)]


@pytest.mark.parametrize(
    ("corners", "speed"), [([(0, 0)], 1.0), ([(0, 0), (0, 0)], 1.0), ([(0, 0), (float("nan"), 1)], 1.0), ([(0, 0), (1, 0)], 0.0)]
)
def test_a_way_that_leads_nowhere_is_refused(corners: list[tuple[float, float]], speed: float) -> None:
    with pytest.raises(ParameterError):
        BeaconPath(corners, speed=speed)


def test_a_swarm_gathers_and_follows_and_who_stands_stays() -> None:
    """Radius 8, a beacon at a quarter of the insects' speed: nobody who walks is left further behind than a few seconds' walk."""
    world = _world()
    path = BeaconPath([(8, 10), (52, 10)], speed=0.25)
    for second in range(1, 121):
        tend(world, path.at(0), radius=8.0)
        world.advance(float(second))
    assert (distances_from(world, path.at(0)) < 10.0).all()
    world.stop(7)
    stood_at = world.position(7)
    for second in range(121, 297):
        tend(world, path.at(world.now_s - 120), radius=8.0)
        world.advance(float(second))
    far = distances_from(world, path.at(999)) > 11.0
    assert [one for one, is_far in zip(world.ids, far.tolist(), strict=True) if is_far] == [7]
    assert world.position(7) == stood_at


def test_nobody_within_the_radius_is_touched() -> None:
    world, other = _world(), _world()
    assert tend(world, (30.0, 10.0), radius=99.0) == 0
    assert (world.velocities() == other.velocities()).all()
    assert [str(event) for event in world.advance(20.0)] == [str(event) for event in other.advance(20.0)]
