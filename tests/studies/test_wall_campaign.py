"""Laws of the campaign against walls: arenas are as nasty as they should be, insects stay in, and one that did not would be told."""

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, Point, Polygon, box

from simulator.arenas.arena import build_arena
from simulator.errors import ArenaError
from simulator.legs import Legs
from simulator.world import World
from studies.errors import CampaignFileError
from studies.nasty_arenas import Nastiness, draw_nasty_arena
from studies.wall_campaign import Progress, find_escapes, load_progress, main, make_world, run_world, store_progress


def test_insects_stay_in_every_kind_of_arena_under_every_law() -> None:
    progress = Progress(seed=11)
    for _ in range(24):
        run_world(progress, steps=2_500, lines_one_in=1)
    assert progress.worlds == 24
    assert progress.steps >= (24 - progress.unplaceable) * 2_500
    assert progress.lines == progress.legs
    assert len(progress.by_kind) == len(Nastiness) + 4


@pytest.mark.parametrize("kind", Nastiness)
def test_a_kind_and_a_seed_make_one_arena(kind: Nastiness) -> None:
    one, other = (draw_nasty_arena(kind, np.random.default_rng(4)) for _ in range(2))
    assert one.polygon.equals(other.polygon)
    assert one.area > 0


def test_sharp_corners_are_sharper_than_a_hundredth_of_a_radian() -> None:
    sharpest = 1.0
    for seed in range(20):
        polygon = draw_nasty_arena(Nastiness.SHARP_CORNERS, np.random.default_rng(seed)).polygon
        assert isinstance(polygon, Polygon)
        for ring in (polygon.exterior, *polygon.interiors):
            along = np.diff(np.array(ring.coords), axis=0)
            heading = np.arctan2(along[:, 1], along[:, 0])
            turn = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
            sharpest = min(sharpest, float(np.pi - turn.max()))
    assert sharpest < 0.01


def test_a_leg_through_a_wall_is_found_though_both_its_ends_are_inside() -> None:
    arena = build_arena(Polygon(box(0, 0, 10, 10).exterior, [box(4, 4, 6, 6).exterior]))
    through = {"t_start_s": [0.0, 0.0], "t_end_s": [1.0, 1.0], "x": [1.0, 1.0], "y": [5.0, 1.0], "vx": [8.0, 8.0], "vy": [0.0, 0.0]}
    legs = Legs(biobot=np.arange(2), **{name: np.array(values) for name, values in through.items()})
    problems, lines = find_escapes(arena, legs, lines_one_in=1)
    assert lines == 2
    assert len(problems) == 1
    assert "biobot 1" in problems[0]


def test_a_leg_that_ends_outside_is_found_without_its_line() -> None:
    arena = build_arena(box(0, 0, 10, 10))
    values = {"t_start_s": [0.0, 0.0], "t_end_s": [1.0, 3.0], "x": [1.0, 5.0], "y": [5.0, 5.0], "vx": [1.0, 2.0], "vy": [0.0, 0.0]}
    legs = Legs(biobot=np.arange(2), **{name: np.array(column) for name, column in values.items()})
    assert len(find_escapes(arena, legs, lines_one_in=16)[0]) == 1


def test_a_campaign_goes_on_where_it_was_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = tmp_path / "state.json"
    progress = Progress(seed=1)
    run_world(progress, steps=1_000)
    store_progress(progress, state)
    assert load_progress(state, seed=1) == progress
    assert main(["--steps", "0", "--state", str(state)]) == 0
    assert "1 worlds" in capsys.readouterr().out


@pytest.mark.parametrize("content", ["", "[]", '{"seed": 1, "worlds": 2, "more": 3}', json.dumps({"seed": 2})])
def test_a_foreign_state_is_refused(content: str, tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    state.write_text(content)
    with pytest.raises(CampaignFileError, match=r"state\.json"):
        load_progress(state, seed=1)


def test_a_campaign_that_cannot_go_on_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = tmp_path / "state.json"
    state.write_text("{")
    assert main(["--state", str(state)]) == 1
    assert "give another --state" in capsys.readouterr().err


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.data())
def test_no_command_and_no_new_wall_lets_an_insect_out(number: int, data: st.DataObject) -> None:
    world, kind, _ = make_world(3, number)
    assume(kind != Nastiness.NARROW_GAPS)  # reflected to and fro in a crack, one insect makes millions of legs a second
    extent = max(world.arena.bounds[2] - world.arena.bounds[0], world.arena.bounds[3] - world.arena.bounds[1])
    built_s = 0.0
    for _ in range(12):
        world.advance(world.now_s + data.draw(st.floats(0.0, 0.5)))
        one = data.draw(st.integers(1, 64))
        match data.draw(st.sampled_from(["turn", "run", "stop", "start", "silence", "restore", "build"])):
            case "turn":
                world.turn(one, data.draw(st.floats(-7.0, 7.0)))
            case "run":
                world.run_straight(one, extent * data.draw(st.floats(1e-6, 3.0)))
            case "stop":
                world.stop(one)
            case "start":
                world.start(one)
            case "silence":
                world.silence(one)
            case "restore":
                world = World.restore(world.snapshot())
            case _:
                left = world.arena.polygon.difference(Point(world.position(one)).buffer(extent * data.draw(st.floats(0.001, 0.2))))
                assert isinstance(left, Polygon | MultiPolygon)
                assert escapes(world, built_s) == []
                with suppress(ArenaError):  # what is left is nothing, or too thin to stand in
                    world.replace_arena(build_arena(left))
                    built_s = world.now_s
    assert escapes(world, built_s) == []


def escapes(world: World, built_s: float) -> list[str]:
    legs = world.legs()
    return find_escapes(world.arena, legs.take(np.flatnonzero(legs.t_start_s >= built_s)), lines_one_in=1)[0]
