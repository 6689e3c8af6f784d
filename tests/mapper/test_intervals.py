"""Bars and what separates them: the lists say what the map says, the rule's line is where the rule judges, pictures show both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper.betti import find_threshold, judge_intervals
from mapper.interval_lists import describe_barcode, describe_diagram, list_bars, list_lines, sort_bars
from mapper.interval_pictures import render_barcode, render_diagram
from mapper.map_codec import decode_map
from mapper.types import BettiRule, BettiRuleKind
from tests.mapper.ring import ring_map

scales = st.just(0.0) | st.floats(1e-3, 10)
diagrams = st.lists(st.tuples(scales, scales).map(sorted), min_size=1, max_size=12).map(lambda rows: np.array(rows, dtype=np.float64))
rules = st.builds(
    BettiRule,
    kind=st.sampled_from(BettiRuleKind),
    q=st.floats(0, 1),
    delta=st.floats(0, 0.2),
    tau=st.floats(0.5, 4),
    power=st.sampled_from([0.0, 0.3]),
)


@given(intervals=diagrams, rule=rules, n=st.integers(1, 30_000))
def test_the_line_of_the_rule_is_where_the_rule_judges(intervals: np.ndarray, rule: BettiRule, n: int) -> None:
    real = judge_intervals(intervals, rule, diameter=10.0, n_encounters=n)
    line = find_threshold(intervals, rule, diameter=10.0, n_encounters=n)
    births, deaths = intervals.T
    length = (deaths - births) / 10.0
    ratio = np.divide(deaths, births, out=np.zeros(len(births)), where=births > 0)
    assert real.tolist() == ((length > line.length_share) & (ratio > line.ratio) & (length > 0)).tolist()


def test_bars_name_their_holes_and_come_in_order() -> None:
    result = decode_map(ring_map())
    loops = sort_bars(list_bars(result, 1))
    assert len(loops) == sum(len(part.intervals[1]) for part in result.components)
    assert [bar.is_real for bar in loops] == sorted((bar.is_real for bar in loops), reverse=True)
    for bar in loops:
        if bar.hole is not None:
            hole = result.holes[bar.hole - 1]
            assert (bar.birth, bar.death, bar.probability) == (hole.birth, hole.death, hole.probability)
    assert sum(bar.is_real for bar in loops) == result.betti_numbers[1]
    parts = list_bars(result, 0)
    assert sum(bar.is_real for bar in parts) == result.betti_numbers[0]
    diagram, barcode = describe_diagram(result), describe_barcode(result)
    assert diagram["thresholds"] == barcode["thresholds"]
    (line,) = (line for line in list_lines(result) if line.dimension == 1)
    assert line.probability is not None
    assert line.sure_length == 2 * (result.components[0].stability_band or 0)


@pytest.mark.parametrize("image_format", ["svg", "png"])
def test_pictures_of_equal_maps_are_equal_and_say_what_counts(image_format: str) -> None:
    result = decode_map(ring_map())
    for draw in (render_diagram, render_barcode):
        picture = draw(result, image_format=image_format)  # type: ignore[arg-type]  # one of the two
        if image_format == "svg":
            assert picture == draw(decode_map(ring_map()), image_format="svg")
            text = picture.decode()
            assert "b1 = 1" in text
            assert f"1: {result.holes[0].probability:.0%}" in text
        else:
            assert picture.startswith(b"\x89PNG")
