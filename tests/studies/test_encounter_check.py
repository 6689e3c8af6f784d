"""Laws of the check against brute force: it agrees with the engine, and would tell if it did not."""

import numpy as np
import pytest

from studies.encounter_check import MOTIONS, Told, check, compare
from studies.hard_arenas import FIVE


def told(*spans: tuple[int, float, float]) -> Told:
    pair, begin, end = (np.array(column) for column in zip(*spans, strict=True))
    return Told(pair=pair, t_start_s=begin, t_end_s=end)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", FIVE)
def test_the_engine_agrees_with_stepping(name: str, motion: str) -> None:
    verdict = check(FIVE[name](), MOTIONS[motion], insects=16, time_s=6.0, seed=3)
    assert verdict.agrees, verdict.line()
    assert verdict.encounters > 5


def test_a_pair_seen_by_one_side_only_is_told() -> None:
    exact, stepped = told((1, 1.0002, 2.0002), (2, 5.0, 6.0)), told((1, 1.0005, 1.9995), (3, 5.0005, 5.9995))
    verdict = compare(exact, stepped)
    assert (verdict.missed, verdict.extra) == (1, 1)
    assert not verdict.agrees


def test_a_beginning_that_is_late_is_told() -> None:
    verdict = compare(told((1, 1.0, 2.0)), told((1, 1.0105, 1.9995)))
    assert verdict.largest_s == pytest.approx(0.0105)
    assert not verdict.agrees


def test_what_lies_between_two_steps_counts_for_nothing() -> None:
    """Steps are at 0.0005, 0.0015, ...: the first span holds none of them, and none lies in the gap between the others."""
    verdict = compare(told((1, 0.9998, 1.0002), (2, 1.0, 1.4996), (2, 1.4999, 2.0)), told((2, 1.0005, 1.9995)))
    assert verdict.agrees
    assert (verdict.encounters, verdict.between_steps) == (3, 1)
