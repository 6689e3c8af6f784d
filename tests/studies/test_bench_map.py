"""Laws of the benchmark of maps: it runs, the plain ways give the same results, and what it tells follows from what it measured."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mapper.pipeline import compute_map
from mapper.types import KernelsKind
from studies.bench_map import main
from studies.cut import Cut, load_cut, store_cut
from studies.errors import CutFileError
from studies.long_run import cut_run
from studies.map_measures import Bench, Comparison, MapTiming, affordable_repeats, exponents, find_differences, fit_exponent, judge
from studies.map_timing import CASES
from studies.plain_paths import PlainSample, sample_by_all_pairs, sample_by_dijkstra

pytestmark = pytest.mark.xdist_group("bench map")
"""What they share is made once, by one worker."""

_N = 2000


@pytest.fixture(scope="module")
def cuts(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    return cut_run([500, _N], seed=3, directory=tmp_path_factory.mktemp("cuts"), tell=lambda _: None)


@pytest.mark.campaign
def test_a_run_tells_every_case_and_ratio_and_that_results_are_equal(
    cuts: dict[int, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    status = main(["--sizes", str(_N), "--repeats", "1", "--seed", "3", "--cache", str(cuts[_N].parent), "--json", str(figures)])
    told = capsys.readouterr()
    assert status == 0, told.err
    assert all(f"| {case} | compiled | 2,000 |" in told.out for case in CASES)
    assert told.out.count("| equal |") == 4
    bench = msgspec.json.decode(figures.read_bytes(), type=Bench)
    assert [(one.case, one.kernels) for one in bench.maps] == [
        *((case, KernelsKind.COMPILED) for case in CASES),
        ("paper", KernelsKind.PLAIN),
        ("default", KernelsKind.PLAIN),
    ]
    assert all(sum(one.stages_s.values()) == pytest.approx(one.total_s) for one in bench.maps)
    assert {one.way for one in bench.peers} == {"dijkstra", "all-pairs"}
    assert min([one.peak_bytes for one in bench.maps] + [one.peak_bytes for one in bench.peers]) > 10e6


@pytest.mark.parametrize(
    ("case", "plain"),
    [
        ("paper", lambda cut: sample_by_all_pairs(cut, n_points=150, k=10, q=0.9)),
        ("paper, all kept", lambda cut: sample_by_dijkstra(cut, n_points=150)),
    ],
)
@pytest.mark.parametrize("n", [500, _N])
def test_the_plain_ways_pick_the_mapper_s_points_at_its_distances(
    cuts: dict[int, Path], case: str, plain: Callable[[Cut], PlainSample], n: int
) -> None:
    cut = load_cut(cuts[n])
    ours, theirs = compute_map(cut.table, cut.spells, CASES[case]), plain(cut)
    np.testing.assert_array_equal(ours.points.encounter, theirs.encounter)
    np.testing.assert_array_equal(ours.components[0].distances, theirs.distances)


def test_a_failing_process_is_told_and_is_no_crash(cuts: dict[int, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / cuts[_N].name).write_text("no table")
    assert main(["--sizes", str(_N), "--seed", "3", "--cache", str(tmp_path)]) == 1
    assert "remove the file, and it is made anew" in capsys.readouterr().err


def test_fewer_points_are_the_first_of_more(cuts: dict[int, Path]) -> None:
    cut = load_cut(cuts[500])
    few, many = (sample_by_dijkstra(cut, n_points=n) for n in (4, 30))
    np.testing.assert_array_equal(few.encounter, many.encounter[:4])
    np.testing.assert_array_equal(few.distances, many.distances[:4, :4])


def test_a_smaller_table_holds_what_had_ended_by_then(cuts: dict[int, Path]) -> None:
    small, large = (load_cut(cuts[n]).table for n in (500, _N))
    ends = np.sort(large.t_end_ns)
    np.testing.assert_array_equal(np.sort(small.t_end_ns), ends[:500])
    assert np.all(np.diff(small.t_start_ns) >= 0)


def test_tables_are_made_once(cuts: dict[int, Path]) -> None:
    told: list[str] = []
    assert cut_run([500, _N], seed=3, directory=cuts[_N].parent, tell=told.append) == cuts
    assert told == []


def test_a_table_comes_back_from_its_file_with_its_landmarks(cuts: dict[int, Path], tmp_path: Path) -> None:
    cut = load_cut(cuts[500])
    assert len(cut.landmarks) == 20
    store_cut(cut.first(100), tmp_path / "some.npz")
    again = load_cut(tmp_path / "some.npz")
    np.testing.assert_array_equal(again.table.id2, cut.table.id2[:100])
    assert again.spells == cut.spells


def test_a_file_that_is_no_table_is_named(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    path.write_text("no archive")
    with pytest.raises(CutFileError, match=r"other\.npz.*remove the file"):
        load_cut(path)


@pytest.mark.parametrize(("text", "complaint"), [("10", "at least 2,000"), ("2000.5", "whole numbers"), ("many", "numbers of encounters")])
def test_unfit_sizes_are_refused_with_the_limit(text: str, complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--sizes", text])
    assert complaint in capsys.readouterr().err


def test_another_point_or_distance_is_a_difference() -> None:
    ours = {"encounter": np.array([3, 1, 2]), "distances": np.array([[0.0, 4.0, 2.0], [4.0, 0.0, 3.0], [2.0, 3.0, 0.0]])}
    assert find_differences(ours, {"encounter": ours["encounter"][:2], "distances": ours["distances"][:2, :2] * (1 + 1e-12)}) == ()
    assert find_differences(ours, {"encounter": np.array([3, 1, 9])}) == ("encounter: 1 of 3 values",)
    assert find_differences(ours, {**ours, "distances": ours["distances"] * (1 + 1e-6)}) == ("distances: 6 of 9 values",)
    assert find_differences(ours, {"encounter": np.arange(5)}) == ("3 points, not 5",)


def test_the_exponent_is_that_of_the_power_law() -> None:
    sizes = [10_000, 100_000, 1_000_000]
    assert fit_exponent(sizes, [3e-7 * size**1.2 for size in sizes]) == pytest.approx(1.2)


_MAP = MapTiming(
    case="paper",
    kernels=KernelsKind.COMPILED,
    encounters=100_000,
    repeats=1,
    total_s=0.1,
    core_s=0.11,
    stages_s={"metric": 0.03, "outliers": 0.05, "subsample": 0.02},
    distances_s=0.05,
    distances_core_s=0.04,
    peak_bytes=10**8,
    points=150,
)
_BENCH = Bench(
    machine={},
    seed=1,
    load=(0.0, 0.0),
    start_s=(3.0, 1.0, 1.5),
    start_core_s=(0.9, 0.8, 0.7),
    start_encounters=10_000,
    maps=(
        replace(_MAP, encounters=10_000, total_s=0.01, core_s=0.01),
        _MAP,
        replace(_MAP, encounters=1_000_000, total_s=2.5, core_s=2.5),
        replace(_MAP, kernels=KernelsKind.PLAIN, total_s=9.0),
    ),
    peers=(),
    comparisons=(
        Comparison(
            name="peer",
            encounters=100_000,
            ours_s=0.05,
            theirs_s=4.0,
            ours_core_s=0.04,
            theirs_core_s=1.6,
            note="",
            differences=(),
            target=50.0,
        ),
    ),
    left_out=(),
)


def test_verdicts_follow_from_the_figures() -> None:
    """0.01 s of 0.03 s; 0.1 s of 0.2 s; 2.5 s of 2 s; 0.1 GB of 1.5 GB; 1.6 / 0.04 = 40 of 50; median 1.5 s of 2 s; the slope."""
    assert [(one.got, one.is_met, one.is_ratio) for one in judge(_BENCH)] == [
        ("0.01 s", True, False),
        ("0.1 s", True, False),
        ("2.5 s", False, False),
        ("0.10 GB", True, False),
        ("40 x", False, True),
        ("1.50 s", True, False),
        ("1.20", False, False),
    ]


@pytest.mark.parametrize(("patience_s", "repeats"), [(0.3, 0), (0.4, 1), (1.1, 2), (100.0, 5), (float("inf"), 5)])
def test_maps_are_made_while_patience_lasts(patience_s: float, repeats: int) -> None:
    """0.1 s at 100,000 encounters may be 0.4 s at 200,000."""
    assert affordable_repeats(_MAP, 200_000, wanted=5, patience_s=patience_s) == repeats


def test_only_compiled_maps_count_for_the_exponent() -> None:
    """log(2.5 / 0.01) / log(100) for the map, log(100 * 6 / 4) / log(100) for N log N."""
    assert exponents(_BENCH)["paper"] == pytest.approx((np.log10(250.0) / 2.0, np.log10(150.0) / 2.0))


def test_figures_survive_their_file() -> None:
    assert msgspec.json.decode(msgspec.json.encode(_BENCH), type=Bench) == _BENCH
    assert json.loads(msgspec.json.encode(_BENCH))["maps"][3]["kernels"] == "plain"
