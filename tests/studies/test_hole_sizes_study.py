"""Sizes of holes and routes beside the truth: the studies on a few real runs."""

import json
from functools import cache

import numpy as np
import pytest
import shapely

from mapper.config import RecipeConfig, make_recipe
from mapper.hole_sizes import estimate_size
from mapper.types import Method
from studies import hole_sizes, routes, train_hole_sizes
from studies.cases import Options
from studies.cases.workers import Workers
from studies.hole_runs import HOLE_RUNS, SWARMS, HoleCase, HoleRun, ObstacleForm, Swarm, compute_hole_run, draw_obstacles
from studies.hole_sizes import compare, tell
from studies.train_hole_sizes import collect, train


@cache
def _runs() -> list[HoleRun]:
    return collect(Method.DEFAULT, Options(journal=None, workers=Workers(jobs=1)), runs={"hisser-field": 8})


@pytest.mark.parametrize("swarm", SWARMS.values(), ids=lambda swarm: swarm.name)
def test_obstacles_have_the_size_and_the_room_that_are_asked_for(swarm: Swarm) -> None:
    for seed in range(15):
        arena = draw_obstacles(swarm, list(ObstacleForm)[seed % 5], seed=seed)
        obstacles = [shapely.Polygon(ring) for ring in arena.interiors]
        assert 1 <= len(obstacles) <= swarm.most_obstacles
        for number, obstacle in enumerate(obstacles):
            assert swarm.sizes[0] - 1e-6 <= np.sqrt(obstacle.convex_hull.area) <= swarm.sizes[1] + 1e-6
            assert obstacle.distance(arena.exterior) >= swarm.passage - 1e-6
            assert all(obstacle.distance(other) >= swarm.passage - 1e-6 for other in obstacles[:number])


def test_a_run_is_the_same_again_and_survives_the_journal() -> None:
    case = HoleCase(swarm=SWARMS["hisser-field"], seed=3, recipe=make_recipe(RecipeConfig()))
    run = compute_hole_run(case)
    assert run == compute_hole_run(case) == HOLE_RUNS.unpack(json.loads(json.dumps(HOLE_RUNS.pack(run))))


def test_training_leaves_no_bias_on_what_it_was_trained_on() -> None:
    model = train(_runs())
    holes = [hole for run in _runs() for hole in run.matched]
    assert len(holes) >= 5
    misses = [np.log(estimate_size(hole.loop, model).perimeter / hole.hull_perimeter) for hole in holes]
    assert abs(np.mean(misses)) < 0.01
    assert min(*model.perimeter_variance, *model.area_variance) >= 0
    lines = tell(_runs(), model)
    assert lines[-1].split()[0] == str(len(holes))


def test_what_is_exact_agrees() -> None:
    agreement = compare([1.0, 2.0], [0.1, 0.1], [1.0, 2.0])
    assert (agreement.bias, agreement.rms, agreement.within_one, agreement.within_two) == (0.0, 0.0, 1.0, 1.0)


def test_the_commands_print_their_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert hole_sizes.main(["--swarm", "hisser-field", "--runs", "2", "--jobs", "1"]) == 0
    assert "hisser-field" in capsys.readouterr().out
    assert routes.main(["--swarm", "hisser-field", "--runs", "2", "--jobs", "1"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("hisser-field")
    for program in (hole_sizes, routes):
        with pytest.raises(SystemExit):
            program.main(["--runs", "0"])
    assert train_hole_sizes.TRAINING_RUNS.keys() == SWARMS.keys()
