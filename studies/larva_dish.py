"""Larvae of the preset ``jeanson-larva``, each by itself in a dish of 11 cm: what of [Jea03] comes in, and what comes out.

Hazards, bouts at the wall, lengths of rests and angles of departure are put in, and must come out again from the recorded paths. The
shares of moving and of stopping time at the wall are not put in: they follow from how long an excursion into the open lasts.

[Jea03] counts what is in a zone along the wall whose width was not at hand (about 5 mm from memory); in the model the
wall is a line, so both countings are told: on the wall, and within 5 mm of it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from shapely.geometry import Point

from simulator.config import Ranges
from simulator.legs import Floats, Indices, Legs
from simulator.motion import MotionParameters
from simulator.presets import find_preset
from simulator.world import World
from studies.agreement import Agreement
from studies.wall_density import make_disc, time_within

_SIDES = 96
_ZONE_M = 0.005
# Rests that begin within this time before the end are left out, so that long ones are not cut short: exp(-12000 / 700) is nothing.
_LONGEST_REST_S = 12_000.0
_FITTING_ROUNDS = 300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diary:
    """The legs of all larvae and what each is: arrays of shape (k,).

    Parameters
    ----------
    lasts_s
        How long each leg lasts [s].
    is_rest, is_at_wall
        What it is; a rest is at the wall where the leg before it was.
    follows
        Whether the leg before is of the same larva.
    """

    legs: Legs
    lasts_s: Floats
    is_rest: NDArray[np.bool_]
    is_at_wall: NDArray[np.bool_]
    follows: NDArray[np.bool_]


def larva_motion() -> MotionParameters:
    """Return the preset's motion without what larvae do to each other."""
    motion = find_preset("jeanson-larva").motion
    return replace(motion, contact_radius=0.0, contact_turns=False, company_stop_gain=0.0, company_rest_gain=0.0)


def keep_diary(*, larvae: int, time_s: float, seed: int) -> Diary:
    """Let larvae walk in a dish, and tell legs along the wall from others by their speed."""
    motion = larva_motion()
    ranges = Ranges(detection=1e-6, communication=1e-6)
    arena = make_disc(radius=find_preset("jeanson-larva").side / 2.0, sides=_SIDES)
    world = World(arena, motion=motion, ranges=ranges, ids=range(1, larvae + 1), seed=seed)
    world.run(time_s)
    legs = world.legs()
    speed = np.hypot(legs.vx, legs.vy)
    is_rest = speed == 0.0
    between = 0.5 * (motion.speed + (motion.wall_speed or motion.speed))
    walks_at_wall = ~is_rest & (speed < between)
    # A rest is where the last leg was that was none.
    last_moving = np.maximum.accumulate(np.where(is_rest, 0, np.arange(len(legs))))
    follows = np.append(False, legs.biobot[1:] == legs.biobot[:-1])
    return Diary(
        legs=legs,
        lasts_s=legs.t_end_s - legs.t_start_s,
        is_rest=is_rest,
        is_at_wall=np.where(is_rest, walks_at_wall[last_moving], walks_at_wall),
        follows=follows,
    )


def compare(*, is_quick: bool, seed: int) -> list[Agreement]:
    """Compare what comes out with what went in, and with the published shares."""
    larvae, time_s = (60, 14_000.0) if is_quick else (200, 40_000.0)
    diary = keep_diary(larvae=larvae, time_s=time_s, seed=seed)
    loose = 3.0 if is_quick else 1.0
    return [
        *_compare_hazards(diary, loose=loose),
        *_compare_rests(diary, until_s=time_s - _LONGEST_REST_S, loose=loose),
        *_compare_departures(diary, loose=loose),
        *_tell_shares(diary),
    ]


def _compare_hazards(diary: Diary, *, loose: float) -> list[Agreement]:
    motion = larva_motion()
    begins_rest = np.flatnonzero(diary.is_rest & diary.follows)
    found = []
    for is_at_wall, place, hazard in ((False, "in the open", motion.stop_hazard), (True, "at the wall", motion.wall_stop_hazard)):
        walked_s = diary.lasts_s[~diary.is_rest & (diary.is_at_wall == is_at_wall)].sum()
        stops = int((diary.is_at_wall[begins_rest] == is_at_wall).sum())
        found.append(Agreement(name=f"stops per second walked {place}", measured=stops / walked_s, theory=hazard, within=0.02 * loose))
    walked_s = float(diary.lasts_s[~diary.is_rest & diary.is_at_wall].sum())
    n_bouts = _departures(diary).size
    found.append(
        Agreement(
            name="time walked at the wall in a bout [s]", measured=walked_s / n_bouts, theory=1 / motion.exit_hazard, within=0.02 * loose
        )
    )
    return found


def _compare_rests(diary: Diary, *, until_s: float, loose: float) -> list[Agreement]:
    motion = larva_motion()
    rests = diary.lasts_s[diary.is_rest & (diary.legs.t_start_s < until_s)]
    share, short_s, long_s = fit_two_exponentials(rests)
    theory = (motion.long_rest_share, motion.short_rest_s, motion.long_rest_s)
    names = ("share of long rests", "mean short rest [s]", "mean long rest [s]")
    limits = (0.06, 0.02, 0.06)
    return [
        Agreement(name=f"{name}, fitted to {rests.size} rests", measured=measured, theory=wanted, within=limit * loose)
        for name, measured, wanted, limit in zip(names, (share, short_s, long_s), theory, limits, strict=True)
    ]


def fit_two_exponentials(times: Floats) -> tuple[float, float, float]:
    """Fit a mixture of two exponential distributions by expectation and maximisation.

    Parameters
    ----------
    times
        Shape (k,), positive [s].

    Returns
    -------
    tuple of float
        Share of the long ones, mean of the short ones, mean of the long ones.
    """
    share, short, long = 0.1, float(np.median(times)), float(times.max()) / 5.0
    for _ in range(_FITTING_ROUNDS):
        of_long = share / long * np.exp(-times / long)
        of_short = (1.0 - share) / short * np.exp(-times / short)
        weight = of_long / (of_long + of_short)
        share = float(weight.mean())
        long = float((weight * times).sum() / weight.sum())
        short = float(((1.0 - weight) * times).sum() / (1.0 - weight).sum())
    return share, short, long


def _departures(diary: Diary) -> Indices:
    """Find the legs that lead off the wall: in the open, right after one along it."""
    off = ~diary.is_rest & ~diary.is_at_wall & diary.follows
    before = np.roll(~diary.is_rest & diary.is_at_wall, 1)
    return np.flatnonzero(off & before)


def _compare_departures(diary: Diary, *, loose: float) -> list[Agreement]:
    """Geometric mean and deviation of the angles, beside those of the log-normal distribution cut off at 180 degrees."""
    motion, legs = larva_motion(), diary.legs
    off = _departures(diary)
    dot = legs.vx[off - 1] * legs.vx[off] + legs.vy[off - 1] * legs.vy[off]
    cross = legs.vx[off - 1] * legs.vy[off] - legs.vy[off - 1] * legs.vx[off]
    log_angle = np.log(np.degrees(np.abs(np.arctan2(cross, dot))))
    centre, width = math.log(motion.departure_median_deg), motion.departure_log_sd
    cut = (math.log(180.0) - centre) / width
    tail = math.exp(-0.5 * cut**2) / math.sqrt(2 * math.pi) / float(ndtr(cut))
    mean, deviation = centre - width * tail, width * math.sqrt(1.0 - cut * tail - tail**2)
    return [
        Agreement(name="departures: geometric mean [deg]", measured=math.exp(log_angle.mean()), theory=math.exp(mean), within=0.02 * loose),
        Agreement(
            name="departures: geometric deviation", measured=math.exp(log_angle.std()), theory=math.exp(deviation), within=0.02 * loose
        ),
    ]


def _tell_shares(diary: Diary) -> list[Agreement]:
    """Shares of moving and of stopping time at the wall, beside the published ones, and what of them follows from what."""
    motion = larva_motion()
    inner = make_disc(radius=find_preset("jeanson-larva").side / 2.0, sides=_SIDES).polygon.boundary.distance(Point(0.0, 0.0)) - _ZONE_M
    in_zone_s = diary.lasts_s - time_within(diary.legs, radius=inner)
    moving, resting = ~diary.is_rest, diary.is_rest

    def share(amount_s: Floats, of: NDArray[np.bool_]) -> float:
        return float(amount_s[of].sum() / diary.lasts_s[of].sum())

    on_wall_s = diary.lasts_s * diary.is_at_wall
    moving_share = share(on_wall_s, moving)
    # Stops strike at each place in proportion to the time walked there, and last as long anywhere.
    followed = motion.wall_stop_hazard * moving_share
    expected = followed / (followed + motion.stop_hazard * (1.0 - moving_share))
    return [
        Agreement(
            name="share of stopping time on the wall, from that of moving time",
            measured=share(on_wall_s, resting),
            theory=expected,
            within=0.1,
        ),
        Agreement(name="share of moving time on the wall, beside 'about half'", measured=moving_share, theory=0.5, within=None),
        Agreement(name="share of moving time within 5 mm, beside 'about half'", measured=share(in_zone_s, moving), theory=0.5, within=None),
        Agreement(
            name="share of stopping time on the wall, beside 'about 80 %'", measured=share(on_wall_s, resting), theory=0.8, within=None
        ),
        Agreement(
            name="share of stopping time within 5 mm, beside 'about 80 %'", measured=share(in_zone_s, resting), theory=0.8, within=None
        ),
    ]
