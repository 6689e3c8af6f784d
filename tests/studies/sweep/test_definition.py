"""A sweep is every combination of its grid with each of its cases and each of its seeds; what makes no run is told before any is made."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import studies
from firmware_protocol.errors import ConfigurationError
from mapper.types import Method, MetricKind
from studies.cases.study import digest
from studies.sweep.case import part, recipe_config, run_config
from studies.sweep.definition import Sweep, expand, load_sweep

KEYS = st.text("abc.", min_size=1, max_size=4)
GRIDS = st.dictionaries(KEYS, st.lists(st.integers(0, 9), min_size=1, max_size=3, unique=True), max_size=4)


@given(GRIDS)
def test_every_combination_comes_once(grid: Mapping[str, list[int]]) -> None:
    cells = list(expand(grid))
    size = 1
    for values in grid.values():
        size *= len(values)
    assert len({digest(cell) for cell in cells}) == len(cells) == size
    for key, values in grid.items():
        assert {cell[key] for cell in cells} == set(values)


@given(GRIDS)
def test_the_order_of_a_grid_changes_no_case(grid: Mapping[str, list[int]]) -> None:
    turned = {key: grid[key][::-1] for key in reversed(list(grid))}
    assert {digest(cell) for cell in expand(turned)} == {digest(cell) for cell in expand(grid)}


def load(folder: Path, text: str, **flags: object) -> Sweep:
    path = folder / "sweep.toml"
    path.write_text(text)
    return load_sweep(path, flags=flags)


def test_cases_grid_and_seeds_are_multiplied(tmp_path: Path) -> None:
    sweep = load(
        tmp_path,
        """
        name = "made"
        repeats = 3
        first_seed = 5
        [grid.run]
        preset = ["paper-units", "hisser-field"]
        scenario = ["one-obstacle"]
        motion.persistence = [0, 0.5]
        [[cases]]
        recipe.method = "paper"
        recipe.outlier_q = 1
        [[cases]]
        run.biobots = 30
        """,
    )
    assert len(sweep.cells) == 8
    assert sweep.seeds == range(5, 8)
    cases = sweep.cases()
    assert len({digest(case) for case in cases}) == len(cases) == 24
    first = sweep.cells[0]
    # A whole number where a float is wanted is that float: written either way, it is one case.
    assert first["run.motion.persistence"] == 0.0
    assert isinstance(first["run.motion.persistence"], float)
    assert isinstance(first["recipe.outlier_q"], float)
    assert part(first, "run") == {"preset": "paper-units", "scenario": "one-obstacle", "motion": {"persistence": 0.0}}
    assert recipe_config(first).method is Method.PAPER
    assert recipe_config(sweep.cells[-1]).method is Method.DEFAULT
    config = run_config(sweep.cells[-1], seed=7)
    assert (config.preset, config.biobots, config.motion.persistence, config.seed) == ("hisser-field", 30, 0.5, 7)


def test_repeats_can_be_given_on_the_command_line(tmp_path: Path) -> None:
    text = 'name = "made"\nrepeats = 3\ngrid.run.scenario = ["maze"]\n'
    assert len(load(tmp_path, text, repeats=9).cases()) == 9
    with pytest.raises(ConfigurationError, match="--repeats: repeats is 0"):
        load(tmp_path, text, repeats=0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", r"sweep\.toml: missing key 'name'"),
        (
            'name = "made"\ngrid.run.scenario = ["office", "maze", "office"]',
            r"sweep\.toml: run\.scenario in grid holds 'office' 2 times; give",
        ),
        ('name = "made"\n[[cases]]\n[[cases]]\nrun.scenario = "maze"\n[[cases]]\n', r"sweep\.toml: cases\[2\] says the same as cases\[0\]"),
        ('name = "made"\ngrid.recipe.method = ["magic"]', r"grid\.recipe\.method is \['magic'\]: .*; wanted default or paper"),
        ('name = "made"\ngrid.run.sensing = ["foo"]', r"grid\.run\.sensing is \['foo'\]: .*; wanted ideal or "),
        ('name = "made"\nrepeat = 3', r"sweep\.toml: unknown key 'repeat'; known here: cases, first_seed, grid, name, repeats"),
        ('name = "no good"', r"sweep\.toml: name is 'no good'"),
        ('name = "made"\nrepeats = 0', r"sweep\.toml: repeats is 0"),
        ('name = "made"\ngrid.run.sceanrio = ["maze"]', r"sweep\.toml: unknown key 'grid\.run\.sceanrio'"),
        ('name = "made"\ngrid.run.seed = [1]', r"unknown key 'grid\.run\.seed'"),
        ('name = "made"\ngrid.run.scenario = "maze"', r"sweep\.toml: grid\.run\.scenario is 'maze': Expected `array`"),
        ('name = "made"\ngrid.run.scenario = []', r"grid\.run\.scenario is \[\]"),
        (
            'name = "made"\ngrid.recipe.outlier_q = [0.9, 2]',
            r"sweep\.toml: grid\.recipe\.outlier_q is \[0\.9, 2\]: Expected `float` <= 1\.0",
        ),
        ('name = "made"\ngrid.run.motion.persistence = [3]', r"grid\.run\.motion\.persistence is \[3\]"),
        ('name = "made"\n[[cases]]\nrecipe.metrik = "x"', r"sweep\.toml: cases is .* unknown field `metrik`.*\[0\]\.recipe"),
        (
            'name = "made"\n[[cases]]\nrun.scenario = "maze"\n[grid.run]\nscenario = ["maze"]',
            r"run\.scenario stands in cases\[0\] and in grid",
        ),
        ('name = "made"\nrepeats = 600000\ngrid.recipe.outlier_k = [1, 2]', "make 1200000 cases; wanted at most 1000000"),
        ('name = "made"\ngrid.run.scenario = ["maze", "amaze"]', r"sweep\.toml: run\.scenario = 'amaze': .*amaze"),
        ('name = "made"', r"run \(nothing given\): give --scenario NAME"),
        ('name = "made"\ngrid.run.setting = ["squares"]', "no setting is called 'squares'; known: squares/paper-units"),
        ('name = "made"\ngrid.run.setting = ["shapes/long"]\ngrid.run.biobots = [3]', r"leave out run\.biobots"),
        ('name = "made"\ngrid.run.scenario = ["maze"]\ngrid.run.landmarks = [500]', "at most the number of biobots, 150"),
        ('name = "made"\ngrid.run.arena = ["nowhere.geojson"]', "nowhere.geojson: cannot be read"),
        ('name = "made"\ngrid.run.scenario = ["maze"]\ngrid.run.csma = [true]', "csma: of no use where sensing is ideal"),
        ("name = ", "not valid TOML"),
    ],
)
def test_a_bad_definition_is_refused_with_file_and_key(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        load(tmp_path, text)


def test_all_faults_of_cells_are_told_together(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as told:
        load(tmp_path, 'name = "made"\ngrid.run.scenario = ["one", "two"]\ngrid.recipe.outlier_q = [0.8, 0.9]\n')
    assert len(told.value.problems) == 2


@pytest.mark.parametrize(("content", "problem"), [(None, "cannot be read"), (b"\xff", "not UTF-8"), (b"#" * 2**21, "larger than")])
def test_a_file_that_is_no_definition_is_told(content: bytes | None, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=problem):
        load_sweep(path, flags={})


def test_another_content_of_an_arena_file_is_another_case(tmp_path: Path) -> None:
    arena = tmp_path / "room.geojson"
    text = f'name = "made"\nrepeats = 1\ngrid.run.arena = ["{arena}"]\n'
    names = set()
    for side in (40, 50):
        arena.write_text(f'{{"type":"Polygon","coordinates":[[[0,0],[{side},0],[{side},{side}],[0,{side}],[0,0]]]}}')
        (case,) = load(tmp_path, text).cases()
        names.add(digest(case))
    assert len(names) == 2


EXAMPLES = sorted((Path(studies.__file__).parent / "data").glob("*.toml"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_the_examples_are_sweeps(path: Path) -> None:
    sweep = load_sweep(path, flags={})
    assert sweep.name.replace("-", "_") == path.stem
    assert all(recipe_config(cell).metric in {None, *MetricKind} for cell in sweep.cells)
    assert all(one != other for one, other in pairwise(sweep.cells))
