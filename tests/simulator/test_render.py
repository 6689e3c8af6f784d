"""Laws of ``biobot-sim render``: pictures and films of a run that is on disk."""

import argparse
import io
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from firmware_protocol.errors import ConfigurationError
from simulator.config_sources import load_config
from simulator.errors import MissingLibraryError, OutputError, ParameterError
from simulator.pictures.film import plan_film
from simulator.pictures.instant import InstantPainter
from simulator.pictures.picture import PictureSize, draw_arena, drawing_style, length_text, make_figure, nice_length
from simulator.pictures.recorded_run import read_run
from simulator.pictures.render import RenderConfig, add_arguments, render
from tests.simulator.runs import change_description, change_truth, make_run, run_with_a_door_that_closes

SMALL = {"size": "300x280", "dpi": 60.0}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("made") / "run")


@pytest.fixture
def directory(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


def picture(directory: Path, target: Path, /, **fields: object) -> bytes:
    render(RenderConfig(**({"directory": str(directory), target.suffix[1:]: str(target)} | SMALL | fields)))  # type: ignore[arg-type]
    return target.read_bytes()


@pytest.mark.parametrize("kind", ["png", "svg"])
@pytest.mark.parametrize("at_s", [None, 7.3])
def test_the_same_run_gives_the_same_bytes(made: Path, tmp_path: Path, kind: str, at_s: float | None) -> None:
    first = picture(made, tmp_path / f"a.{kind}", at_s=at_s)
    assert first == picture(made, tmp_path / f"b.{kind}", at_s=at_s)


def test_another_process_gives_the_same_bytes(made: Path, tmp_path: Path) -> None:
    """Hashes of strings differ from process to process, and must not show."""
    command = [sys.executable, "-W", "error", "-m", "simulator", "render", str(made), "--svg", str(tmp_path / "b.svg")]
    done = subprocess.run([*command, "--size", "300x280", "--dpi", "60"], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert picture(made, tmp_path / "a.svg") == (tmp_path / "b.svg").read_bytes()


def test_a_png_has_the_size_asked_for(made: Path, tmp_path: Path) -> None:
    assert Image.open(io.BytesIO(picture(made, tmp_path / "a.png"))).size == (300, 280)


def test_an_svg_says_what_it_shows(made: Path, tmp_path: Path) -> None:
    text = " ".join(ET.fromstring(picture(made, tmp_path / "a.svg")).itertext())
    for wanted in ("two-obstacles, paper-units, seed 3", "40 biobots (6 landmarks)", "in 20 s", "lengths in units", "10 units", "landmark"):
        assert wanted in text


def test_a_dollar_sign_in_a_name_is_no_formula(directory: Path, tmp_path: Path) -> None:
    change_description(directory, arena="a$b$<c>.geojson")
    assert b"a$b$&lt;c&gt;.geojson" in picture(directory, tmp_path / "a.svg")


def test_the_paths_asked_for_are_drawn(made: Path, tmp_path: Path) -> None:
    assert b"path of 17" in picture(made, tmp_path / "a.svg", ids="3,17")
    assert b"paths of 40 biobots" in picture(made, tmp_path / "b.svg", paths=1000)
    assert b"path" not in b"".join(one for one in picture(made, tmp_path / "c.svg", paths=0).split(b"<text")[1:] if b"path of" in one)


def test_the_axes_hold_every_arena_of_the_run(directory: Path) -> None:
    run = run_with_a_door_that_closes(directory)
    with drawing_style():
        _, _, axes = make_figure(run, size=PictureSize(width=300, height=280, dpi=60))
        draw_arena(axes, run.arenas[0][1])
        (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    x_min, y_min, x_max, y_max = run.bounds
    assert x_low < x_min < x_max < x_high
    assert y_low < y_min < y_max < y_high


def test_insects_are_painted_where_they_are(made: Path) -> None:
    """A pixel of the walkers' colour near each walker, and the obstacles' middles are grey at any time."""
    run = read_run(made)
    with drawing_style():
        painter = InstantPainter(run, size=PictureSize(width=900, height=900, dpi=100), trail_s=0.0, step_s=0.5)
        frame = painter.pixels(9.5).astype(int)
        to_pixels = painter._axes.transData.transform
        walking = ~np.logical_or(*run.standing_at(9.5))
        for x, y in to_pixels(run.track.at(9.5)[walking]):
            near = frame[900 - int(y) - 4 : 900 - int(y) + 4, int(x) - 4 : int(x) + 4].reshape(-1, 3)
            assert (np.abs(near - (0, 0x72, 0xB2)).sum(axis=1) < 60).any()
        for x, y in to_pixels([[14.5, 14.5], [35.5, 35.5]]):
            assert frame[900 - int(y), int(x)].tolist() == [0xD9, 0xD9, 0xD9]


def test_the_walls_of_an_instant_are_drawn(directory: Path) -> None:
    run = run_with_a_door_that_closes(directory)
    with drawing_style():
        painter = InstantPainter(run, size=PictureSize(width=300, height=280, dpi=60), trail_s=0.0, step_s=0.5)
        x, y = map(int, painter._axes.transData.transform([35.5, 35.5]))
        colours = [painter.pixels(at_s)[280 - y, x].tolist() for at_s in (11.0, 13.0, 11.0)]
    assert colours[0] == colours[2] == [0xD9, 0xD9, 0xD9]
    assert colours[1] != colours[0]


def test_the_whole_picture_tells_that_walls_change(directory: Path, tmp_path: Path) -> None:
    run_with_a_door_that_closes(directory)
    assert b"walls change at 12 s" in picture(directory, tmp_path / "a.svg")


@pytest.mark.parametrize(("fps", "seconds"), [(10.0, 1.0), (30.0, 0.7), (3.0, 0.1)])
def test_a_gif_has_as_many_frames_and_lasts_as_long_as_asked(made: Path, tmp_path: Path, fps: float, seconds: float) -> None:
    with Image.open(io.BytesIO(picture(made, tmp_path / "a.gif", fps=fps, seconds=seconds))) as gif:
        wanted = max(2, round(fps * seconds))
        assert gif.n_frames == wanted  # type: ignore[attr-defined]
        total_ms = 0
        for k in range(wanted):
            gif.seek(k)
            total_ms += gif.info["duration"]
        assert total_ms == pytest.approx(1000 * wanted / fps, abs=10)
        assert gif.convert("RGB").getpixel((2, 2)) == (255, 255, 255)


def test_a_gif_is_the_same_every_time(made: Path, tmp_path: Path) -> None:
    assert picture(made, tmp_path / "a.gif", seconds=0.2) == picture(made, tmp_path / "b.gif", seconds=0.2)


def test_an_mp4_has_as_many_frames_as_asked_and_is_the_same_every_time(made: Path, tmp_path: Path) -> None:
    encoder = pytest.importorskip("imageio_ffmpeg", reason="the extra 'video' is not installed")
    first = picture(made, tmp_path / "a.mp4", fps=10.0, seconds=1.2)
    assert encoder.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 12
    assert first == picture(made, tmp_path / "b.mp4", fps=10.0, seconds=1.2)


def test_without_the_encoder_the_remedy_is_told(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingLibraryError, match=r"biobot-gateway\[video\]"):
        picture(made, tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_film_at_a_speed_is_as_long_as_the_run_divided_by_it(made: Path) -> None:
    assert plan_film(read_run(made), fps=10.0, seconds=None, speed=4.0).n_frames == 50
    assert plan_film(read_run(made), fps=10.0, seconds=None, speed=None).n_frames == 100


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"gif": "a.gif", "fps": 60.0}, "at most 50 in a GIF"),
        ({"gif": "a.gif", "seconds": 1e6}, "at most 2,000"),
        ({"mp4": "a.mp4", "seconds": 1e6}, "at most 100,000"),
        ({"mp4": "a.mp4", "size": "301x280"}, "even numbers"),
        ({"png": "a.png", "at_s": 20.1}, "from 0 to 20 s"),
        ({"png": "a.png", "ids": "3,99"}, r"ids is \[99\]"),
    ],
)
def test_what_the_run_or_the_format_cannot_give_is_refused(made: Path, tmp_path: Path, fields: dict[str, object], problem: str) -> None:
    placed = {name: str(tmp_path / str(value)) if name in {"png", "gif", "mp4"} else value for name, value in fields.items()}
    with pytest.raises(ParameterError, match=problem):
        render(RenderConfig(**({"directory": str(made)} | SMALL | placed)))  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, "give DIR"),
        ({"directory": "x"}, "give at least one of --png FILE, --svg FILE"),
        ({"directory": "x", "png": "a", "svg": "./a"}, "one file"),
        ({"directory": "x", "gif": "a", "at_s": 1.0}, "with --at"),
    ],
)
def test_nothing_to_do_is_bad_usage(fields: dict[str, str], problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        render(RenderConfig(**fields))  # type: ignore[arg-type]


def test_a_run_that_lasts_no_time_has_a_picture_and_no_film(directory: Path, tmp_path: Path) -> None:
    with np.load(directory / "truth.npz") as archive:
        start = archive["position"][:1]
    change_truth(directory, t_s=np.zeros(1), position=start)
    assert picture(directory, tmp_path / "a.png")
    assert picture(directory, tmp_path / "b.png", at_s=0.0)
    with pytest.raises(ParameterError, match="duration of the run"):
        picture(directory, tmp_path / "a.gif")


@pytest.mark.parametrize("name", ["encounters.csv", "truth.npz", "arena.geojson", "run.json"])
def test_a_file_of_the_run_is_never_written_over(directory: Path, name: str) -> None:
    before = (directory / name).read_bytes()
    with pytest.raises(ParameterError, match="a file of the run itself"):
        render(RenderConfig(directory=str(directory), png=str(directory / name)))
    assert (directory / name).read_bytes() == before


def test_a_picture_that_cannot_be_written_leaves_what_was_there(made: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory"):
        picture(made, tmp_path / "missing" / "a.png")
    (tmp_path / "a.png").mkdir()
    with pytest.raises(OutputError, match="is a directory"):
        picture(made, tmp_path / "a.png")
    (tmp_path / "a.gif").write_bytes(b"old")
    with pytest.raises(ParameterError):
        picture(made, tmp_path / "a.gif", fps=60.0)
    assert (tmp_path / "a.gif").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.png"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["x"], "give at least one of --png FILE"),
        (["--png", "a.png"], "give DIR"),
        (["x", "--png", "a.png", "--size", "big"], "wanted WIDTHxHEIGHT"),
        (["x", "--png", "a.png", "--size", "9x9"], "wanted WIDTHxHEIGHT"),
        (["x", "--gif", "a.gif", "--fps", "0"], "fps"),
        (["x", "--gif", "a.gif", "--seconds", "nan"], "seconds"),
        (["x", "--gif", "a.gif", "--seconds", "1", "--speed", "1"], "not allowed with"),
        (["x", "--png", "a.png", "--ids", "three"], "wanted ids with commas"),
        (["x", "--png", "a.png", "--at", "-1"], "at_s"),
    ],
)
def test_bad_usage_is_told_in_a_line(capsys: pytest.CaptureFixture[str], arguments: list[str], problem: str) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    status = 0
    try:
        args = parser.parse_args(arguments, namespace=argparse.Namespace(config=None))
        config = load_config(RenderConfig, args)
        render(config)
    except SystemExit as ended:
        status, told = int(ended.code or 0), capsys.readouterr().err
    except ConfigurationError as error:
        status, told = 2, str(error)
    assert status == 2
    assert problem in told


def test_a_directory_without_a_run_is_told_in_a_line(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-m", "simulator", "render", str(tmp_path / "nowhere"), "--png", str(tmp_path / "a.png")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"biobot-sim: {tmp_path}/nowhere: does not exist; give the directory")
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_neither_a_run_nor_its_service_waits_for_matplotlib() -> None:
    program = "import simulator.run, simulator.service, sys; sys.exit('matplotlib' in sys.modules or 'PIL' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0


def test_scale_bars_are_round() -> None:
    assert [nice_length(one) for one in (12.5, 0.125, 1.0, 0.99, 60.0)] == pytest.approx([10.0, 0.1, 1.0, 0.5, 50.0])
    assert [length_text(1.0, "unit"), length_text(10.0, "unit"), length_text(0.1, "m")] == ["1 unit", "10 units", "0.1 m"]
