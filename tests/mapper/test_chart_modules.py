"""The pure modules of the page's charts, in the browser that runs them, against slow definitions and their own inverses."""

import functools
import http.server
import threading
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mapper
from mapper.config import RecipeConfig, make_recipe
from mapper.length_shares import WHOLE, encode_lengths
from mapper.polygons import contains
from mapper.types import ComponentMap, MapResult, Points
from studies.chromium import CHROMIUM, launched

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH; apt-get install chromium"),
    pytest.mark.xdist_group("mapper page"),
]

RECIPE = make_recipe(RecipeConfig())
Call = Callable[..., Any]
few = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
numbers = st.floats(-1e6, 1e6)
places = st.tuples(numbers, numbers)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def call() -> Iterator[Call]:
    """Run the body of a function of the page: ``m`` is a module of it, ``given`` the arguments."""
    directory = Path(mapper.__file__).parent / "web"
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(directory)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        with launched() as browser:
            page = browser.new_page()
            page.goto(f"http://127.0.0.1:{server.server_port}/format.js")

            def run(module: str, body: str, *arguments: object) -> Any:
                return page.evaluate(f"async (given) => {{ const m = await import('/{module}'); {body} }}", list(arguments))

            yield run
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@given(
    place=places,
    moves=st.lists(st.tuples(st.floats(0.2, 5), places), max_size=6),
    size=st.tuples(st.integers(50, 3000), st.integers(50, 3000)),
)
@few
def test_a_place_on_the_screen_is_the_same_place_on_the_map(
    call: Call, place: tuple[float, float], moves: list[Any], size: tuple[int, int]
) -> None:
    body = """
      const [place, moves, [width, height]] = given;
      const port = new m.Viewport();
      port.setStage(width, height, { left: -1e6, right: 1e6, low: -2e6, high: 1e6 }, { left: 20, right: 20, top: 20, bottom: 20 });
      for (const [factor, [x, y]] of moves) { port.zoom(factor, [x, y]); port.move(y, x); }
      return [port.toMap(port.toScreen(place)), port.fitScale / port.scale];
    """
    back, _ = call("viewport.js", body, place, moves, size)
    assert back == pytest.approx(place, rel=1e-6, abs=1.0)


@given(bounds=st.tuples(places, places), size=st.tuples(st.integers(80, 3000), st.integers(80, 3000)))
@few
def test_what_is_fitted_is_in_sight_and_touches_an_edge(call: Call, bounds: tuple[Any, Any], size: tuple[int, int]) -> None:
    (x0, y0), (x1, y1) = bounds
    box = {"left": min(x0, x1), "right": max(x0, x1), "low": min(y0, y1), "high": max(y0, y1)}
    if max(box["right"] - box["left"], box["high"] - box["low"]) < 1e-3:
        return
    body = """
      const [box, [width, height]] = given;
      const port = new m.Viewport();
      port.setStage(width, height, box, { left: 20, right: 20, top: 20, bottom: 20 });
      return [port.toScreen([box.left, box.high]), port.toScreen([box.right, box.low])];
    """
    (left, top), (right, bottom) = call("viewport.js", body, box, size)
    rooms = [left - 20, size[0] - 20 - right, top - 20, size[1] - 20 - bottom]
    assert min(rooms) == pytest.approx(0, abs=0.01 * max(size))
    assert left >= 19 - 0.01 * max(size)


@given(turn=st.floats(0, 6.28), scale=st.floats(1e-3, 1e3), is_mirrored=st.booleans(), shift=places, place=places)
@few
def test_a_move_of_the_plane_can_be_undone(
    call: Call, turn: float, scale: float, is_mirrored: bool, shift: tuple[float, float], place: tuple[float, float]
) -> None:
    cos, sin = scale * float(np.cos(turn)), scale * float(np.sin(turn))
    move = {"a": cos, "b": sin if is_mirrored else -sin, "c": sin, "d": -cos if is_mirrored else cos, "e": shift[0], "f": shift[1]}
    back, stretched = call(
        "affine.js", "const [move, place] = given; return [m.apply(m.invert(move), m.apply(move, place)), m.stretch(move)];", move, place
    )
    assert back == pytest.approx(place, rel=1e-6, abs=1e-6 * (1 + 1e6 / scale))
    assert stretched == pytest.approx(scale)


ring = st.lists(st.tuples(st.integers(-20, 20), st.integers(-20, 20)), min_size=3, max_size=9)


@given(ring=ring, place=st.tuples(st.integers(-21, 21), st.integers(-21, 21)))
@few
def test_the_page_and_the_mapper_agree_on_what_is_inside(call: Call, ring: list[tuple[int, int]], place: tuple[int, int]) -> None:
    """Half a step off the corners' lattice, nothing is on an edge of slope 0 or 1; the even-odd rule is one for all else."""
    at = (place[0] + 0.3711, place[1] + 0.4177)
    polygon = np.array(ring, dtype=np.float64)
    expected = bool(contains(polygon, np.array([at]))[0])
    assert call("map_scene.js", "return m.isInside(given[0], given[1]);", at, ring) is expected


def result_of(matrices: list[np.ndarray[Any, Any]]) -> MapResult:
    """Make a map that has nothing but lengths."""
    n = sum(len(matrix) for matrix in matrices)
    component = np.repeat(np.arange(len(matrices)), [len(matrix) for matrix in matrices])
    none = np.zeros((0, 2))
    parts = tuple(
        ComponentMap(
            n_encounters=len(matrix),
            n_used=len(matrix),
            n_points=len(matrix),
            n_landmarks=0,
            diameter=float(matrix.max()),
            cover_radius=0.0,
            epsilon=0.0,
            lost_spectrum=0.0,
            distances=matrix,
            intervals=(none, none),
            betti_numbers=(1, 0),
        )
        for matrix in matrices
    )
    ids = np.zeros(n, dtype=np.int64)
    return MapResult(
        betti_numbers=(len(parts), 0),
        points=Points(x=np.zeros(n), y=np.zeros(n), t_ns=ids, id1=ids, id2=ids, component=component, encounter=ids),
        components=parts,
        holes=(),
        edges=np.zeros((0, 2), dtype=np.int64),
        triangles=np.zeros((0, 3), dtype=np.int64),
        diameter=max(part.diameter for part in parts),
        lost_spectrum=0.0,
        n_encounters=n,
        n_used=n,
        n_components=len(parts),
        length_unit="s",
        recipe=RECIPE,
        warnings=(),
    )


@given(sizes=st.lists(st.integers(1, 14), min_size=1, max_size=3), seed=st.integers(0, 10**6), share=st.floats(0.0, 1.0))
@few
def test_the_complex_at_any_scale_is_the_rips_complex(call: Call, sizes: list[int], seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    spots = [rng.uniform(0, 10, (size, 2)) for size in sizes]
    matrices = [np.sqrt(((one[:, None] - one[None]) ** 2).sum(-1)) for one in spots]
    result = result_of(matrices)
    limit = share * result.diameter
    body = """
      const [bytes, components, share] = given;
      const lengths = m.readLengths(new Uint8Array(bytes).buffer, components);
      const { edges, triangles } = m.complexAt(lengths, share, { most: 1e6 });
      return [edges, triangles];
    """
    edges, flat = call("simplices.js", body, list(encode_lengths(result)), result.points.component.tolist(), share)
    offsets = np.cumsum([0, *sizes])
    slack = result.diameter / WHOLE
    for sign, includes in ((-1, set.issuperset), (1, set.issubset)):
        joined = {
            (int(begin) + i, int(begin) + j)
            for begin, matrix in zip(offsets, matrices, strict=False)
            for i, j in combinations(range(len(matrix)), 2)
            if matrix[i, j] <= limit + sign * slack
        }
        corners = {(a, b, c) for a, b in joined for c in range(b + 1, int(offsets[-1])) if {(a, c), (b, c)} <= joined}
        assert includes({tuple(edge) for edge in edges}, joined)
        assert includes({tuple(flat[i : i + 3]) for i in range(0, len(flat), 3)}, corners)


@given(n=st.integers(3, 32), seed=st.integers(0, 10**6), reach=st.floats(0.1, 0.9))
@settings(few, max_examples=12)
def test_few_triangles_cover_what_all_cover(call: Call, n: int, seed: int, reach: float) -> None:
    """But for slivers: of random places in all triangles, no more than 1 in 50 is left bare."""
    rng = np.random.default_rng(seed)
    spots = rng.uniform(0, 1, (n, 2))
    near = np.sqrt(((spots[:, None] - spots[None]) ** 2).sum(-1)) <= reach
    flat = [corner for a, b, c in combinations(range(n), 3) if near[a, b] and near[a, c] and near[b, c] for corner in (a, b, c)]
    kept = call("simplices.js", "return m.cover(given[0], given[1]);", flat, spots.tolist())
    assert {tuple(kept[i : i + 3]) for i in range(0, len(kept), 3)} <= {tuple(flat[i : i + 3]) for i in range(0, len(flat), 3)}
    probes = rng.uniform(0, 1, (300, 2))
    in_all, in_kept = (covered(probes, spots, np.array(some, dtype=np.int64).reshape(-1, 3)) for some in (flat, kept))
    assert not (in_kept & ~in_all).any()
    assert (in_all & ~in_kept).sum() <= max(2, in_all.sum() / 50)
    assert len(kept) // 3 <= 2 * int(np.triu(near, 1).sum())


def covered(probes: np.ndarray[Any, Any], spots: np.ndarray[Any, Any], triangles: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Say which places lie in a triangle."""
    inside = np.zeros(len(probes), dtype=bool)
    for a, b, c in spots[triangles]:
        sides = [(q[0] - p[0]) * (probes[:, 1] - p[1]) - (q[1] - p[1]) * (probes[:, 0] - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside |= np.all([side >= 0 for side in sides], axis=0) | np.all([side <= 0 for side in sides], axis=0)
    return inside


def test_lengths_of_another_map_are_noticed(call: Call) -> None:
    body = "try { m.readLengths(new Uint8Array(given[0]).buffer, given[1]); return null; } catch (error) { return error.message; }"
    bytes_ = list(encode_lengths(result_of([np.array([[0.0, 1.0], [1.0, 0.0]])])))
    assert call("simplices.js", body, bytes_, [0, 0]) is None
    assert "lengths for a map" in call("simplices.js", body, bytes_, [0, 0, 0])


holes = st.lists(
    st.builds(
        lambda x, y, r: {"centre": [10.0 * x, 10.0 * y], "area": 3.14159 * r * r},
        st.integers(-9, 9), st.integers(-9, 9), st.floats(0.1, 4.9),
    ),
    max_size=6, unique_by=lambda hole: tuple(hole["centre"]),
)  # fmt: skip


@given(before=holes, possible=holes, moved=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), data=st.data())
@few
def test_a_hole_is_found_again_however_holes_are_numbered(
    call: Call, before: list[Any], possible: list[Any], moved: tuple[float, float], data: st.DataObject
) -> None:
    """Holes stand apart by more than their radii, and move by less than the smallest of them."""
    order = data.draw(st.permutations(range(len(before))))
    after = [{**before[k], "centre": [before[k]["centre"][0] + moved[0], before[k]["centre"][1] + moved[1]]} for k in order]
    body = """
      const [before, after, possible] = given;
      const again = (chosen, one, other) => m.findAgain(chosen, one, other);
      const now = { holes: after, possible_holes: possible };
      return [
        before.map((_, index) => again({ hole: index }, { holes: before }, now)),
        before.map((_, index) => again({ hole: index }, { holes: before }, { holes: [] })),
        again(null, { holes: before }, now),
      ];
    """
    found, of_none, nothing = call("hole_match.js", body, before, after, possible)
    assert [one["hole"] for one in found] == [order.index(k) for k in range(len(before))]
    assert of_none == [None] * len(before)
    assert nothing is None


def test_a_time_to_wait_is_told_as_people_do(call: Call) -> None:
    told = call("verdict.js", "return given[0].map(m.waitText);", [20, 312, 7200, 400_000])
    assert told == ["about a minute", "about 5 minutes", "about 2 hours", "about 5 days"]
