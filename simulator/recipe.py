"""From the parameters of motion to those of the engine: units, defaults and what is switched off."""

import math
from dataclasses import replace

from simulator.config import Ranges
from simulator.engine.binding import EngineConfig
from simulator.motion import MotionParameters, WallLaw

_LAWS = (WallLaw.UNIFORM, WallLaw.COSINE, WallLaw.MIRROR, WallLaw.FOLLOW)


# Of those who follow walls by command alone: the larvae of [Jea03], as in the preset jeanson-larva.
_EXIT_HAZARD_PER_S = 0.12
_DEPARTURE_LOG_SD = math.log(2.14)


def motion_under_command(motion: MotionParameters) -> MotionParameters:
    """Complete the motion of insects that may be told to follow walls; without such a command nothing of it comes to bear.

    What is not given of walls is [Jea03]'s, but for stops: insects stop at walls as in the open.
    """
    if motion.wall_law is WallLaw.FOLLOW:
        return motion
    return replace(
        motion,
        exit_hazard=motion.exit_hazard or _EXIT_HAZARD_PER_S,
        departure_log_sd=motion.departure_log_sd or _DEPARTURE_LOG_SD,
        wall_stop_hazard=motion.wall_stop_hazard or motion.stop_hazard,
    )


def engine_config(motion: MotionParameters, ranges: Ranges, *, seed: int, period: float) -> EngineConfig:
    """Write the parameters down as the engine wants them; ``period`` is the side of a torus [length], or 0."""
    return EngineConfig(
        seed=seed,
        speed=motion.speed,
        wall_speed=motion.speed if motion.wall_speed is None else motion.wall_speed,
        leg_scale=motion.shortest_leg,
        levy_exponent=motion.levy_exponent or 0.0,
        longest_leg=motion.cut_off,
        persistence=motion.persistence,
        detection=ranges.detection,
        contact=motion.contact_radius,
        stop_open=motion.stop_hazard,
        stop_wall=motion.wall_stop_hazard,
        rest_short=motion.short_rest_s,
        rest_long=motion.long_rest_s,
        share_long=motion.long_rest_share,
        social_stop=motion.company_stop_gain,
        social_rest=motion.company_rest_gain,
        exit_wall=motion.exit_hazard,
        departure_median=math.radians(motion.departure_median_deg),
        departure_log_sd=motion.departure_log_sd,
        mishap=motion.mishap_hazard,
        mishap_rest=motion.mishap_rest_s,
        rescue=motion.rescue_probability,
        death=motion.death_hazard,
        period=period,
        wall_law=_LAWS.index(motion.wall_law),
        contact_turns=int(motion.contact_turns),
    )
