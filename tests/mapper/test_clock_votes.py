"""What two clocks are apart by the encounters that both tell of."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapper.clock_samples import MAX_SAMPLE, SampledRows, SourceSample, make_sample, number_pairs
from mapper.clock_votes import FLOOR_NS, ClockDifference, ClockSample, compare_clocks
from mapper.types import IntArray

S = 1_000_000_000
ORIGIN_NS = 1_700_000_000 * S


def sample(middle_s: list[float], length_s: list[float], *, pair: int = 7) -> ClockSample:
    middle, length = (np.rint(np.array(values) * S).astype(np.int64) for values in (middle_s, length_s))
    return ClockSample(pair=np.full(len(middle), pair, dtype=np.int64), middle_ns=ORIGIN_NS + middle, length_ns=length)


@given(
    offset_ms=st.integers(-10_000_000, 10_000_000),
    seed=st.integers(0, 1000),
    n=st.integers(8, 60),
    ppm=st.integers(-40, 40),
)
def test_an_offset_and_a_drift_are_found_within_the_bound(offset_ms: int, seed: int, n: int, ppm: int) -> None:
    rng = np.random.default_rng(seed)
    middle, length = np.sort(rng.uniform(0, 5000, n)), rng.uniform(0.5, 30, n)
    one = sample(middle.tolist(), length.tolist())
    other = sample((middle * (1 + ppm * 1e-6) + offset_ms / 1000).tolist(), length.tolist())
    found = compare_clocks(one, other)
    if found is None:
        # Nothing is said where a shift by one meeting fits nearly as well; with meetings at random that is rare, and few they must be.
        assert n < 20
        return
    wrong_ns = np.abs(found.at(one.middle_ns) - (other.middle_ns - one.middle_ns))
    assert wrong_ns.max() <= found.bound_ns + 2 * abs(ppm) * 1e-6 * 5000 * S
    assert found.bound_ns >= FLOOR_NS


def test_too_few_votes_say_nothing() -> None:
    middle, length = [10.0, 70.0, 300.0, 1000.0], [1.0, 9.0, 3.0, 5.0]
    assert compare_clocks(sample(middle, length), sample(middle, length)) is None
    assert compare_clocks(sample(middle, length), sample(middle, length, pair=8)) is None


def test_meetings_at_even_intervals_fit_at_every_interval_so_nothing_is_said() -> None:
    middle = [60.0 * n for n in range(40)]
    assert compare_clocks(sample(middle, [2.0] * 40), sample(middle, [2.0] * 40)) is None


knots = st.lists(st.tuples(st.integers(1, 3600), st.integers(-100_000, 100_000)), min_size=1, max_size=5)


@given(steps=knots, start_ns=st.integers(-(10**15), 10**15), at_s=st.integers(-3600, 20_000))
def test_there_and_back_is_nowhere(steps: list[tuple[int, int]], start_ns: int, at_s: int) -> None:
    t_ns = ORIGIN_NS + np.cumsum([step * S for step, _ in steps])
    offset_ns = start_ns + np.cumsum([drift for _, drift in steps])
    way = ClockDifference(t_ns=t_ns, offset_ns=offset_ns, bound_ns=5, n_votes=9)
    back = way.then(way.reversed())
    assert np.abs(back.offset_ns).max() <= 1
    assert (back.bound_ns, back.n_votes) == (10, 9)
    at = np.array([ORIGIN_NS + at_s * S])
    there = way.at(at)
    assert abs(int(way.reversed().at(at + there)[0] + there[0])) <= 1_000


def facts(rows: IntArray, *, n_pairs: int) -> SampledRows:
    low, high = rows % n_pairs, rows % n_pairs + 1000
    ones = np.ones(len(rows), dtype=np.int64)
    return SampledRows(source=0 * ones, pair=number_pairs(low, high), middle_ns=rows * S, length_ns=S * ones, is_usable=ones == 1)


def test_two_gateways_draw_the_same_pairs_and_never_too_many() -> None:
    drawn: list[set[int]] = []
    for n, n_pairs in ((60_000, 900), (20_000, 900)):
        rows = np.arange(n)
        one = SourceSample()
        one.add(rows, facts(rows, n_pairs=n_pairs).pair)
        left, told = one.thin(one.rows, facts(one.rows, n_pairs=n_pairs), source=0)
        assert len(left) == len(one) <= MAX_SAMPLE
        drawn.append(set(make_sample(told, level=4).pair.tolist()))
    assert drawn[0] == drawn[1]
    assert 20 <= len(drawn[0]) <= 120


def test_of_few_pairs_the_newest_encounters_are_drawn() -> None:
    rows = np.arange(20_000)
    one = SourceSample()
    one.add(rows, facts(rows, n_pairs=3).pair)
    left, _ = one.thin(one.rows, facts(one.rows, n_pairs=3), source=0)
    assert left.tolist() == rows[-MAX_SAMPLE // 2 :].tolist()


def test_what_has_gone_over_to_another_start_of_its_gateway_is_drawn_no_more() -> None:
    rows = np.arange(10)
    one = SourceSample()
    one.add(rows, facts(rows, n_pairs=3).pair)
    told = facts(rows, n_pairs=3)
    told.source[4:] = 1
    left, _ = one.thin(rows, told, source=0)
    assert left.tolist() == [0, 1, 2, 3]
