"""From the parameters of motion to those of the engine: units, defaults and what is switched off."""

import math

from simulator.config import Ranges
from simulator.engine.binding import EngineConfig
from simulator.motion import MotionParameters, WallLaw

_LAWS = (WallLaw.UNIFORM, WallLaw.COSINE, WallLaw.MIRROR, WallLaw.FOLLOW)


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
