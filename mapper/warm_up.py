"""``biobot-mapper warm-up``: make a map of a ring that is known, so that everything a map needs is there, compiled and cached.

Python compiles what is imported, matplotlib lists the fonts, and a library that lacks or does not work shows here, not in a mission.
"""

import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from mapper.errors import EngineMissingError, SelfTestError

_N_LANDMARKS: Final = 12
_N_WALKERS: Final = 5
_N_ROUNDS: Final = 4
_NS_PER_S: Final = 1_000_000_000
_BETTI_NUMBERS: Final = (1, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Warmth:
    """What was found: which kernels and which library compute maps, and how long the steps took [s].

    ``shortfall`` says why the kernels are the slow ones, None where they are not.
    """

    kernels: str
    shortfall: str | None
    persistence: str
    n_encounters: int
    importing_s: float
    map_s: float
    picture_s: float
    serving_s: float

    def lines(self) -> list[str]:
        """Say it to a person."""
        return [
            f"kernels      {self.kernels}" if self.shortfall is None else f"kernels      {self.shortfall}",
            f"persistence  {self.persistence}",
            f"start-up     {self.importing_s:.2f} s to import, {self.map_s:.2f} s for the first map, of {self.n_encounters} encounters",
            f"picture      {self.picture_s:.2f} s",
            f"serve        {self.serving_s:.2f} s to import what it needs besides",
        ]


def warm_up() -> Warmth:
    """Import all the mapper needs, and make a small map and its pictures in memory.

    Raises
    ------
    EngineMissingError
        A library is not installed.
    ConfigurationError, KernelsError
        The kernels that the environment asks for are not there.
    SelfTestError
        The map is wrong.
    """
    try:
        return _warm_up()
    except ImportError as error:
        raise EngineMissingError(
            library=(error.name or str(error)).partition(".")[0], needed_for="the mapper", next_step="pip install 'biobot-gateway[mapper]'"
        ) from error


def _warm_up() -> Warmth:
    moments = [time.perf_counter()]
    from mapper.config import RecipeConfig, make_recipe  # noqa: PLC0415  # what is imported here is timed
    from mapper.kernels import choose_kernels  # noqa: PLC0415  # same
    from mapper.pipeline import compute_map  # noqa: PLC0415  # same
    from mapper.report import to_json_object  # noqa: PLC0415  # same
    from mapper.rips_engines import name_engine  # noqa: PLC0415  # same
    from mapper.window import make_encounter_table, stationary_spells  # noqa: PLC0415  # same

    kernels, persistence = choose_kernels(), name_engine()
    moments.append(time.perf_counter())
    begins, walkers, landmarks = _walk_the_ring()
    ends = [begin + _NS_PER_S // 100 for begin in begins]
    table = make_encounter_table(t_start_ns=begins, t_end_ns=ends, id1=walkers, id2=landmarks)
    spells = stationary_spells(table, sorted(set(landmarks)))
    # How sure a map is is not for rings so regular: it is computed only so that all of it is there.
    compute_map(table, spells, make_recipe(RecipeConfig()), kernels=kernels)
    result = compute_map(table, spells, make_recipe(RecipeConfig(replicates=0)), kernels=kernels)
    to_json_object(result)
    moments.append(time.perf_counter())
    if result.betti_numbers != _BETTI_NUMBERS:
        raise SelfTestError(found=result.betti_numbers, wanted=_BETTI_NUMBERS, parts=f"{kernels.name} kernels and {persistence}")
    from mapper.render import render_map  # noqa: PLC0415  # same

    for image_format in ("svg", "png"):
        render_map(result, image_format=image_format)
    moments.append(time.perf_counter())
    import mapper.service  # noqa: F401, PLC0415  # same

    moments.append(time.perf_counter())
    importing_s, map_s, picture_s, serving_s = (after - before for before, after in pairwise(moments))
    return Warmth(
        kernels=kernels.name,
        shortfall=kernels.shortfall,
        persistence=persistence,
        n_encounters=len(table),
        importing_s=importing_s,
        map_s=map_s,
        picture_s=picture_s,
        serving_s=serving_s,
    )


def _walk_the_ring() -> tuple[list[int], list[int], list[int]]:
    """Let biobots go round a ring with a landmark at every second of it: begins of encounters [ns], who walks, and who stands."""
    begins, walkers, landmarks = [], [], []
    for walker in range(1, _N_WALKERS + 1):
        for step in range(_N_ROUNDS * _N_LANDMARKS):
            begins.append(step * _NS_PER_S + walker * _NS_PER_S // (_N_WALKERS + 1))
            walkers.append(walker)
            landmarks.append(100 + (walker * 5 + step) % _N_LANDMARKS)
    return begins, walkers, landmarks
