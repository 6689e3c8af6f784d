"""Where insects are between walls: the stationary density under each law of re-emission, beside theory, in a disc.

Insects that fly straight from wall to wall come off it at an angle a to its normal, drawn from a density f(a) whatever went before.
A chord at that angle is 2 R cos a long, comes as near to the middle as p = R |sin a|, and its time at radii r to r + dr is
2 r dr / sqrt(r^2 - p^2) over the speed. The mean over f, over the mean chord and 2 pi r dr, is the density:

- f = cos(a) / 2 (``cosine``): the integral of cos a / sqrt(r^2 - R^2 sin^2 a) is pi / (2 R) for every r: an even density.
- f = 1 / pi (``uniform``): with sin a = (r / R) sin b it is K(r / R), the complete elliptic integral of the first kind, and the density
  is K(r / R) / 2 of the mean one: pi / 4 in the middle, without bound at the wall, but like a logarithm.
- ``mirror`` keeps the measure of places and headings, so what was even stays even. In a disc an insect keeps its angle for ever: only
  many insects together are spread evenly, however long one is watched.

Legs that end between the walls mix the headings and leave an even density even; under the uniform law they flatten it away from the wall.
"""

import math
from pathlib import Path

import numpy as np
from scipy.special import ellipe, ellipk
from shapely.geometry import Polygon

from simulator.arenas.arena import Arena, build_arena
from simulator.config import Ranges
from simulator.legs import Floats, Legs
from simulator.motion import MotionParameters, WallLaw
from simulator.world import World
from studies.agreement import Agreement

_SIDES = 360
_RINGS = np.array([0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0])
_BALLISTIC = 1e6
# Ten times across: by then nobody is where it was put down.
_SETTLING_S = 20.0
_LAWS = (WallLaw.UNIFORM, WallLaw.COSINE, WallLaw.MIRROR)


def make_disc(*, radius: float = 1.0, sides: int = _SIDES) -> Arena:
    """Make a regular polygon about the origin that is as good as a disc; ``radius`` is that of its corners [length]."""
    turn = 2.0 * math.pi * np.arange(sides) / sides
    return build_arena(Polygon(np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])), source="disc")


def time_within(legs: Legs, *, radius: float) -> Floats:
    """Return how long each leg is nearer than a radius [length] to the origin [s], exactly: shape (k,)."""
    lasts = legs.t_end_s - legs.t_start_s
    square = legs.vx**2 + legs.vy**2
    inward = legs.x * legs.vx + legs.y * legs.vy
    beyond = legs.x**2 + legs.y**2 - radius**2
    moving = square > 0.0
    safe = np.where(moving, square, 1.0)
    root = np.sqrt(np.maximum(inward**2 - square * beyond, 0.0))
    enters = np.clip((-inward - root) / safe, 0.0, lasts)
    leaves = np.clip((-inward + root) / safe, 0.0, lasts)
    within: Floats = np.where(moving, leaves - enters, np.where(beyond < 0.0, lasts, 0.0))
    return within


def uniform_law_density(inner: Floats, outer: Floats) -> Floats:
    """Return the mean density in rings of a unit disc over the mean of all, for straight flight under the uniform law.

    Notes
    -----
    The integral of k K(k) is G(k) = E(k) - (1 - k^2) K(k), from 0 at 0 to 1 at 1.
    """

    def integral(k: Floats) -> Floats:
        inside = np.minimum(k, 1.0 - 1e-15) ** 2
        result: Floats = ellipe(inside) - (1.0 - inside) * ellipk(inside)
        return result

    mean: Floats = (integral(outer) - integral(inner)) / (outer**2 - inner**2)
    return mean


def measure_density(law: WallLaw, *, mean_leg: float, insects: int, time_s: float, seed: int, rings: Floats = _RINGS) -> Floats:
    """Let insects of speed 1 walk in a unit disc; return the density in each ring over the mean of all, shape (k - 1,) for k radii."""
    arena = make_disc()
    motion = MotionParameters(speed=1.0, mean_leg=mean_leg, wall_law=law)
    world = World(arena, motion=motion, ranges=Ranges(detection=1e-6, communication=1e-6), ids=range(1, insects + 1), seed=seed)
    world.run(_SETTLING_S + time_s)
    legs = world.legs()
    legs = legs.take(np.flatnonzero(legs.t_start_s > _SETTLING_S))
    whole_s = float((legs.t_end_s - legs.t_start_s).sum())
    inside_s = np.array([time_within(legs, radius=radius).sum() for radius in rings[:-1].tolist()] + [whole_s])
    area = np.append(np.pi * rings[:-1] ** 2, arena.area)
    density: Floats = np.diff(inside_s) / whole_s / (np.diff(area) / arena.area)
    return density


def compare(*, is_quick: bool, seed: int) -> list[Agreement]:
    """Compare densities in rings for straight flight, and tell those of legs as long as the radius."""
    insects, time_s = (200, 60.0) if is_quick else (2000, 300.0)
    within = 0.15 if is_quick else 0.02
    found = []
    for mean_leg in (_BALLISTIC, 1.0):
        for law in _LAWS:
            # Reflected insects never mix: ten times as many, for a tenth of the time.
            more = 10 if law is WallLaw.MIRROR and mean_leg == _BALLISTIC else 1
            measured = measure_density(law, mean_leg=mean_leg, insects=more * insects, time_s=time_s / more, seed=seed)
            is_even = law is not WallLaw.UNIFORM
            theory = np.ones(measured.size) if is_even else uniform_law_density(_RINGS[:-1], _RINGS[1:])
            flight = "straight flight" if mean_leg == _BALLISTIC else f"l* = {mean_leg:g} R"
            binds = is_even or mean_leg == _BALLISTIC
            for k, density in enumerate(measured.tolist()):
                name = f"density, {law}, {flight}, r/R {_RINGS[k]:g} to {_RINGS[k + 1]:g}"
                found.append(Agreement(name=name, measured=density, theory=float(theory[k]), within=within if binds else None))
    return found


def draw(path: Path, *, seed: int, is_quick: bool) -> None:
    """Draw densities over the radius as a PNG: measured for every law, and the theory of straight flight."""
    from matplotlib.figure import Figure  # noqa: PLC0415  # half a second that other commands need not wait

    rings = np.linspace(0.0, 1.0, 26)
    middle = 0.5 * (rings[:-1] + rings[1:])
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    insects, time_s = (200, 60.0) if is_quick else (1000, 300.0)
    for law, marker in zip(_LAWS, "os^", strict=True):
        more = 10 if law is WallLaw.MIRROR else 1
        density = measure_density(law, mean_leg=_BALLISTIC, insects=more * insects, time_s=time_s / more, seed=seed, rings=rings)
        axes.plot(middle, density, marker, markersize=4, label=f"{law}, straight flight")
    density = measure_density(WallLaw.UNIFORM, mean_leg=1.0, insects=insects, time_s=time_s, seed=seed, rings=rings)
    axes.plot(middle, density, "x", markersize=5, label="uniform, mean leg = radius")
    fine = np.linspace(0.0, 0.999, 400)
    axes.plot(fine, ellipk(fine**2) / 2.0, "k-", linewidth=1, label="K(r/R) / 2")
    axes.axhline(1.0, color="k", linewidth=0.5)
    axes.set(xlabel="distance from the middle over the radius", ylabel="density over its mean", ylim=(0.6, 2.2))
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=80, metadata={"Software": None})
