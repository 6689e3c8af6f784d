"""How often insects meet, beside the kinetic theory of gases: on a torus, with landmarks, and between walls."""

import math
from dataclasses import dataclass

from shapely.geometry import box

from simulator.arenas.arena import build_arena
from simulator.config import Ranges
from simulator.motion import MotionParameters, WallLaw
from simulator.world import World
from studies.agreement import Agreement


@dataclass(frozen=True, slots=True, kw_only=True)
class Gas:
    """Insects of speed 1 in a square of side 1.

    Parameters
    ----------
    radius
        Detection radius over the side.
    mean_leg
        Over the side.
    """

    radius: float
    walkers: int
    landmarks: int = 0
    mean_leg: float = 0.2
    law: WallLaw | None = None  # None: a torus


def torus_rate(gas: Gas) -> float:
    """Return the expected encounters begun per second, of walkers with each other and with landmarks, where there are no walls.

    Notes
    -----
    Headings are independent and isotropic, so two walkers have the mean relative speed 4 v / pi, a walker and a landmark v. A disc of
    radius r sweeps 2 r times that speed. With N (N - 1) / 2 pairs of walkers that is 4 v r N (N - 1) / (pi A); with landmarks,
    2 v r N_l N_m / A.
    """
    among = 4.0 * gas.radius * gas.walkers * (gas.walkers - 1) / math.pi
    return among + 2.0 * gas.radius * gas.landmarks * gas.walkers


def wall_factor(radius: float) -> float:
    """Return what walls leave of the rate in a square of side 1 in which insects are spread evenly.

    Notes
    -----
    Two places at a distance r in direction a lie both inside with the probability (1 - r |cos a|) (1 - r |sin a|); its mean over a is
    1 - 4 r / pi + r^2 / pi: 2.5 % less for r = 1/50, 12.4 % less for 1/10.
    """
    return 1.0 - 4.0 * radius / math.pi + radius**2 / math.pi


def measure_rate(gas: Gas, *, encounters: int, seed: int) -> float:
    """Let insects walk until about so many encounters are expected, and return how many begin per second."""
    world = World(
        build_arena(box(0.0, 0.0, 1.0, 1.0)),
        motion=MotionParameters(speed=1.0, mean_leg=gas.mean_leg, wall_law=gas.law or WallLaw.COSINE),
        ranges=Ranges(detection=gas.radius, communication=1.0),
        ids=range(1, gas.walkers + gas.landmarks + 1),
        seed=seed,
        torus=gas.law is None,
        keeps_legs=False,
    )
    for landmark in world.ids[: gas.landmarks]:
        world.stop(landmark)
    # From when on: a stationary spread of places takes some mean legs to come about where the walls' law makes it uneven.
    begin_s = 20.0 if gas.law is WallLaw.UNIFORM else 0.0
    end_s = begin_s + encounters / torus_rate(gas)
    world.run(begin_s)
    starts = world.run(end_s).ended.t_start_s
    begun = int((starts > begin_s).sum()) + sum(one.t_s > begin_s for one in world.open_encounters())
    return begun / (end_s - begin_s)


_TORUS = (
    Gas(radius=1 / 50, walkers=150),
    Gas(radius=1 / 50, walkers=1000),
    Gas(radius=1 / 50, walkers=130, landmarks=20),
    Gas(radius=1 / 50, walkers=150, mean_leg=5.0),
    Gas(radius=1 / 10, walkers=20),
    Gas(radius=1 / 10, walkers=10, landmarks=30),
    Gas(radius=1 / 200, walkers=2000),
)
_BOXES = tuple(
    Gas(radius=radius, walkers=walkers, law=law)
    for radius, walkers in ((1 / 50, 150), (1 / 10, 20))
    for law in (WallLaw.COSINE, WallLaw.MIRROR)
)
_UNEVEN = tuple(Gas(radius=radius, walkers=walkers, law=WallLaw.UNIFORM) for radius, walkers in ((1 / 50, 150), (1 / 10, 20)))


def compare(*, is_quick: bool, seed: int) -> list[Agreement]:
    """Compare rates on tori and in boxes."""
    encounters = 8_000 if is_quick else 200_000
    within = 0.06 if is_quick else 0.03
    tori = _TORUS[::2] if is_quick else _TORUS
    found = [_compare(gas, torus_rate(gas), within=within, encounters=encounters, seed=seed, place="torus") for gas in tori]
    for gas in _BOXES + _UNEVEN:
        theory = torus_rate(gas) * wall_factor(gas.radius)
        # Under the uniform law insects pile up at walls, where more of their discs is cut off: no theory here, told and not judged.
        allowed = None if gas.law is WallLaw.UNIFORM else within
        found.append(_compare(gas, theory, within=allowed, encounters=encounters, seed=seed, place=f"box, {gas.law}"))
    return found


def _compare(gas: Gas, theory: float, *, within: float | None, encounters: int, seed: int, place: str) -> Agreement:
    measured = measure_rate(gas, encounters=encounters, seed=seed)
    swarm = f"{gas.walkers} walkers" + (f", {gas.landmarks} landmarks" if gas.landmarks else "")
    name = f"starts/s, {place}, r_d/L = 1/{1 / gas.radius:g}, {swarm}, l*/L = {gas.mean_leg:g}"
    return Agreement(name=name, measured=measured, theory=theory, within=within)
