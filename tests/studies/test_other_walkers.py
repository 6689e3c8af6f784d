"""Nodes that do not walk at random: what gives them away, and how little a map says of them then."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mapper.__main__ import main
from mapper.confidence.assess import LEAST_PROBABILITY, MOST_OF_OTHERS
from mapper.config import RecipeConfig, make_recipe
from mapper.contact_statistics import measure_walkers, walks_at_random
from mapper.pipeline import compute_map
from studies.exploration import Exploration
from studies.other_walkers import OUTINGS, WALKERS, Outing, compute_outcome, tell, walk
from studies.trials import SETTINGS, simulate

_NS = 1e9
_FOLLOWERS = "paper-units, along walls for 20 s"
_SEED = 400_001


def _write(run: Exploration, directory: Path) -> tuple[Path, Path]:
    table = run.table
    rows = zip((table.t_start_ns / _NS).tolist(), (table.t_end_ns / _NS).tolist(), table.id1.tolist(), table.id2.tolist(), strict=True)
    encounters, modes = directory / "encounters.csv", directory / "modes.csv"
    encounters.write_text(
        "t_start_s,t_end_s,id1,id2\n" + "".join(f"{begin:.9f},{end:.9f},{one},{other}\n" for begin, end, one, other in rows)
    )
    end_s = float(table.t_end_ns.max()) / _NS
    spells = "".join(f"{spell.t_start_ns / _NS:.9f},{end_s:.9f},{spell.node},S,command\n" for spell in run.spells)
    modes.write_text("t_start_s,t_end_s,id,mode,cause\n" + spells)
    return encounters, modes


@pytest.mark.parametrize("name", ["squares/paper-units", "squares/few", "big-square/hisser-stops", "squares/short"])
def test_nothing_speaks_against_those_that_walk_at_random(name: str) -> None:
    for seed in range(300, 303):
        table, spells, _ = simulate(SETTINGS[name], seed)
        assert walks_at_random(measure_walkers(table, spells))


@pytest.mark.parametrize("walkers", list(WALKERS)[:3])
def test_those_that_follow_walls_give_themselves_away_by_how_long_they_meet(walkers: str) -> None:
    run, _, _ = walk(walkers, _SEED)
    measured = measure_walkers(run.table, run.spells)
    assert not walks_at_random(measured)
    assert walks_at_random(replace(measured, unevenness=1.0, at_once=0.5, alike_lengths=0.0))


def test_those_that_hear_each_other_from_far_are_no_gathering() -> None:
    run, _, _ = walk("hisser-field as it is", _SEED)
    measured = measure_walkers(run.table, run.spells)
    assert measured.at_once > 1.5
    assert walks_at_random(measured)
    assert not walks_at_random(replace(measured, at_once=2.0 * measured.at_once))
    assert not walks_at_random(replace(measured, unevenness=6.5))


@pytest.mark.campaign
def test_of_those_that_follow_walls_no_hole_is_claimed_and_nothing_contradicts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The models alone call holes of these runs sure that are not there."""
    run, _, _ = walk(_FOLLOWERS, _SEED)
    outcome = compute_outcome(Outing(walkers=_FOLLOWERS, seed=_SEED, recipe=make_recipe(RecipeConfig())))
    assert [is_there for chance, is_there in zip(outcome.chances, outcome.is_there, strict=True) if chance >= 0.9].count(False) >= 1
    encounters, modes = _write(run, tmp_path)
    pictures = [tmp_path / f"map.{form}" for form in ("svg", "geojson", "json")]
    given = ["run", str(encounters), "--modes", str(modes), "--speed-mps", "1", "--svg", str(pictures[0]), "--geojson", str(pictures[1])]
    assert main([*given, "--json", str(pictures[2])]) == 0
    told = json.loads(pictures[2].read_text())
    assert told["holes"] == []
    assert told["betti_numbers"] == [1, 0]
    assert told["hole_count"]["is_known"] is False
    assert told["hole_count"]["probability"] < 0.5
    assert told["possible_holes"]
    assert all(LEAST_PROBABILITY <= hole["probability"] <= MOST_OF_OTHERS for hole in told["possible_holes"])
    assert told["data"]["is_enough"] is False
    assert told["data"]["reasons"][0].startswith("the nodes do not walk at random")
    assert {one["name"]: one["holds"] for one in told["assumptions"]}["hole_count"] is False
    features = json.loads(pictures[1].read_text())["features"]
    assert all((feature["properties"].get("probability") or 0.0) <= MOST_OF_OTHERS for feature in features)
    assert "b1 not known" in pictures[0].read_text()
    capsys.readouterr()
    assert main(given[:6]) == 0
    headline = capsys.readouterr().out.splitlines()[0]
    assert headline.startswith("1 component, holes: not known (")
    assert headline.endswith("NOT ENOUGH DATA YET")
    live = compute_map(run.table, run.spells, make_recipe(RecipeConfig()))
    assert (live.holes, live.hole_count is not None and live.hole_count.is_known) == ((), False), "nobody need ask for it"


def test_the_table_counts_what_is_so() -> None:
    outcome = OUTINGS.result_type(
        walkers="x",
        seed=1,
        is_random=False,
        unevenness=None,
        at_once=1.0,
        alike_lengths=0.5,
        true_holes=1,
        chances=(0.95, 0.91, 0.3),
        is_there=(True, False, False),
        value=2,
        probability=0.9,
    )
    assert " ".join(tell("x", [outcome]).split()) == "x 1 1 of 2 = 50% 1 of 3 = 33% 0 of 1 = 0% 0 of 1 = 0%"
