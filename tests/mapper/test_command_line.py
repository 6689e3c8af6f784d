"""``biobot-mapper run`` as a person and a program see it."""

import importlib.util
import json
import os
import re
import socket
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from mapper.__main__ import main
from mapper.rips_engines import name_engine
from tests.gateway.certified import Certified
from tests.mapper.worlds import NS, walk_track

HEADER = "t_start_s,t_end_s,id1,id2\n"
KEYS = {
    "betti_numbers",
    "intervals",
    "points",
    "holes",
    "diameter",
    "n_encounters",
    "n_used",
    "components",
    "lost_spectrum",
    "parameters",
}


def _seconds(instant_ns: int) -> str:
    return f"{instant_ns / NS:.3f}"


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the encounters of a ring of 20 landmarks, and their modes."""
    folder = tmp_path_factory.mktemp("ring")
    rows, spells = walk_track(n_landmarks=20, n_walkers=30, duration_s=120, seed=1, is_ring=True)
    lines = [f"{_seconds(max(start, 0))},{_seconds(max(end, 0))},{first},{second}\n" for start, end, first, second in rows]
    (folder / "encounters.csv").write_text(HEADER + "".join(lines))
    stood = [f"-1,,{spell.node},S,command\n" for spell in spells]
    (folder / "modes.csv").write_text("t_start_s,t_end_s,id,mode,cause\n" + "".join(stood))
    return folder


def _run(*arguments: object, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mapper", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=os.environ | (environment or {}))


def test_a_file_becomes_a_map_in_every_format(ring: Path, tmp_path: Path) -> None:
    svg, png = tmp_path / "map.svg", tmp_path / "map.png"
    done = _run("run", ring / "encounters.csv", "--modes", ring / "modes.csv", "--json", "-", "--svg", svg, "--png", png)
    assert (done.returncode, done.stderr) == (0, "")
    content = json.loads(done.stdout)
    assert content.keys() >= KEYS
    assert content["betti_numbers"] == [1, 1]
    assert content["intervals"]["0"][0] == [0.0, None]
    assert content["parameters"]["length_unit"] == "s"
    (hole,) = content["holes"]
    corner, point = hole["outline"][0], content["points"][hole["points"][0]]
    assert corner == [point["x"], point["y"]]
    assert ET.parse(svg).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    data = png.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    assert data.endswith(b"IEND\xaeB`\x82")


def test_without_json_a_summary_is_printed(ring: Path) -> None:
    stationary = ",".join(str(1001 + k) for k in range(20))
    done = _run("run", ring / "encounters.csv", "--stationary", stationary, "--method", "paper", "--speed-mps", "0.04")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("1 component, 1 hole\n")
    assert " m\n" in done.stdout


def test_the_same_input_gives_the_same_bytes(ring: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        flags = [f"--{kind}={tmp_path / name}.{kind}" for kind in ("json", "svg", "png")]
        assert main(["run", str(ring / "encounters.csv"), "--modes", str(ring / "modes.csv"), *flags]) == 0
    for kind in ("json", "svg", "png"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (HEADER + "x,1,1,2\n", "line 2: t_start_s is 'x'"),
        (HEADER + "2,1,1,2\n", "line 2: t_end_s 1 is before t_start_s 2"),
        (HEADER + "1,2,5,5\n", "line 2: id1 and id2 are both 5"),
        (HEADER + "nan,2,5,6\n", "line 2: t_start_s is 'nan'"),
        (HEADER + "1,inf,5,6\n", "line 2: t_end_s is 'inf'"),
        (HEADER + "1,2,5\n", "line 2: 3 fields, so id2 is missing"),
        (HEADER + "0,000,0,002,20,54\n", "line 2: 6 fields, but the header names 4; is the decimal sign a comma?"),
        (HEADER + "1,2,5,6\n1,5,2,3,4\n", "line 3: 5 fields, but the header names 4"),
        (HEADER + "2,5,3,4,\n", "line 2: 5 fields, but the header names 4"),
        (os.urandom(999) + b"\xff", "is this a CSV file?"),
        ("", "line 1: the file is empty"),
        ("a,b,c\n", "line 1: the header 'a,b,c' lacks t_start_s"),
        (HEADER, "0 encounters, but a map needs at least 2"),
        (HEADER + "1,2,5,6\n", "1 encounter, but a map needs at least 2"),
    ],
)
def test_bad_input_ends_with_file_line_and_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | bytes, reason: str
) -> None:
    path = tmp_path / "encounters.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["run", str(path)]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"biobot-mapper: error: {path}: ")
    assert reason in output.err


def test_a_bad_row_shows_no_traceback_in_a_process_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text(HEADER + 12 * "1,2,5,5\n")
    done = _run("run", path)
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 11
    assert done.stderr.endswith("and 2 more\n")


# Refuses to import some libraries, as where they are not installed.
REFUSE = """
import sys
from importlib.abc import MetaPathFinder

class Refuse(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {refused!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refuse())
from mapper.__main__ import main
sys.exit(main())
"""


# Interrupts itself while the libraries are imported.
INTERRUPT = """
import os
import signal
import sys
from importlib.abc import MetaPathFinder

class Interrupt(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == {during!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from mapper.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("during", ["msgspec", "mapper.config", "mapper.encounter_csv"])
def test_an_interrupt_while_libraries_are_imported_is_no_traceback(ring: Path, during: str) -> None:
    command = [sys.executable, "-c", INTERRUPT.format(during=during), "run", str(ring / "encounters.csv")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


# Runs with little more memory than the program and its libraries take; what is imported when it is wanted is among them: where there is
# no room for an import, the interpreter itself adds lines of its own.
LIMITED = """
import resource
import sys
from pathlib import Path
import mapper.command_line, mapper.encounter_csv, mapper.kernels, mapper.log_map, mapper.map_sketch, mapper.pins, mapper.pipeline
import mapper.places, mapper.reading, mapper.time_limits, scipy.optimize, scipy.sparse.csgraph
from mapper.__main__ import main

used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {spare}, resource.RLIM_INFINITY))
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("spare", "reason"),
    [
        (1_000_000, "not enough memory for all that is read; split the file by time"),
        (20_000_000, "not enough memory for 100000 encounters; map a window of time (--window-s, --from-s, --until-s)"),
    ],
)
def test_too_little_memory_is_one_line(tmp_path: Path, spare: int, reason: str) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text(HEADER + "".join(f"{k / 100},{k / 100},{k % 97},{100 + k % 89}\n" for k in range(100_000)))
    done = subprocess.run(
        [sys.executable, "-c", LIMITED.format(spare=spare), "run", str(path)], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (1, "", f"biobot-mapper: error: {reason}\n")


def _run_without(refused: set[str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", REFUSE.format(refused=refused), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_map_is_the_same_with_every_engine_and_without_gudhi(ring: Path) -> None:
    maps = []
    for other, engine in (("redzed_tda", "holos_tda"), ("holos_tda", "redzed_tda")):
        if importlib.util.find_spec(engine) is not None:
            done = _run_without({"gudhi", other}, "run", ring / "encounters.csv", "--modes", ring / "modes.csv", "--json", "-")
            assert (done.returncode, done.stderr) == (0, "")
            maps.append(json.loads(done.stdout))
    assert maps[0]["holes"]
    assert all(other == maps[0] for other in maps)


def test_without_a_persistence_engine_the_message_says_what_to_do(ring: Path) -> None:
    done = _run_without({"gudhi", "redzed_tda", "holos_tda"}, "run", ring / "encounters.csv")
    assert done.returncode == 1
    assert done.stderr.startswith("biobot-mapper: error: holos-tda is not installed, but persistence needs it; pip install holos-tda")


def test_warm_up_makes_a_map_of_a_known_place_and_names_what_makes_it() -> None:
    done = _run("warm-up", environment={"BIOBOT_KERNELS": "compiled"})
    assert (done.returncode, done.stderr) == (0, "")
    said = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert list(said) == ["kernels", "persistence", "start-up", "picture", "serve"]
    assert said["kernels"] == "compiled"
    assert said["persistence"] == name_engine()
    assert re.fullmatch(r"\d+\.\d\d s to import, \d+\.\d\d s for the first map, of 240 encounters", said["start-up"])


def test_warm_up_is_quiet_where_all_is_well_and_tells_of_slow_kernels_where_not() -> None:
    fast, slow = (_run("warm-up", "--quiet", environment={"BIOBOT_KERNELS": kind}) for kind in ("compiled", "plain"))
    assert (fast.returncode, fast.stdout, fast.stderr) == (0, "", "")
    assert (slow.returncode, slow.stdout) == (0, "")
    assert slow.stderr.startswith("biobot-mapper: warning: plain kernels, 3 to 50 times slower than compiled ones: they were asked for")


@pytest.mark.parametrize(
    ("refused", "library"), [({"redzed_tda", "holos_tda"}, "holos-tda"), ({"scipy"}, "scipy"), ({"matplotlib"}, "matplotlib")]
)
def test_warm_up_fails_where_a_library_is_missing(refused: set[str], library: str) -> None:
    done = _run_without(refused, "warm-up")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"biobot-mapper: error: {library} is not installed, but ")
    assert "pip install" in done.stderr


def test_directories_and_missing_files_are_refused(ring: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    encounters = str(ring / "encounters.csv")
    assert main(["run", str(tmp_path)]) == 1
    assert "cannot be read: is a directory" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "none.csv")]) == 1
    assert "cannot be read: no such file or directory" in capsys.readouterr().err
    assert main(["run", encounters, "--modes", str(tmp_path / "none.csv")]) == 1
    assert f"{tmp_path / 'none.csv'}: cannot be read" in capsys.readouterr().err
    for flag in ("--json", "--svg", "--png"):
        assert main(["run", encounters, flag, str(tmp_path)]) == 1
        assert "cannot write: is a directory" in capsys.readouterr().err


def test_stationary_biobots_that_met_nobody_are_named(ring: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(ring / "encounters.csv"), "--stationary", "1001,1002,1003,999"]) == 0
    assert "warning: stationary biobots 999 are in no encounter" in capsys.readouterr().err
    assert main(["run", str(ring / "encounters.csv"), "--stationary", "998,999"]) == 1
    assert "no encounter has a biobot of --stationary 998, 999" in capsys.readouterr().err


def test_several_components_are_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "encounters.csv"
    path.write_text(
        HEADER + "".join(f"{t},{t},{a},{b}\n" for t, a, b in [(0, 1, 2), (1, 2, 3), (2, 1, 3), (0, 7, 8), (3, 7, 9), (5, 8, 9)])
    )
    assert main(["run", str(path)]) == 0
    output = capsys.readouterr()
    assert output.out.startswith("2 components, holes: not known (")
    assert "warning: the encounters fall into 2 components" in output.err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["run"],
        ["run", "x.csv", "--method", "magic"],
        ["run", "x.csv", "--metric", "euclid"],
        ["run", "x.csv", "--speed-mps", "fast"],
        ["run", "x.csv", "--speed-mps", "0"],
        ["run", "x.csv", "--speed-mps", "-1"],
        ["run", "x.csv", "--speed-mps", "nan"],
        ["run", "x.csv", "--speed-mps", "inf"],
        ["run", "x.csv", "--stationary", "1,,2"],
        ["run", "x.csv", "--stationary", "9223372036854775808"],
        ["run", "x.csv", "--config", "nowhere.toml"],
    ],
)
def test_bad_usage_ends_with_status_two(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status: object = main(arguments)
    except SystemExit as left:
        status = left.code
    assert status == 2
    assert "error: " in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"], ["run", "--version"], ["warm-up", "--help"]])
def test_help_and_version_fit_one_screen(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 0
    assert 0 < len(capsys.readouterr().out.splitlines()) <= 40


def test_the_configuration_is_file_then_environment_then_flags(ring: Path, tmp_path: Path) -> None:
    config = tmp_path / "mapper.toml"
    config.write_text('[recipe]\nmethod = "paper"\nn_points = 40\noutlier_q = 0.8\nspeed_mps = 2\n')
    variables = {"BIOBOT_MAPPER__RECIPE__N_POINTS": "50", "BIOBOT_MAPPER__RECIPE__OUTLIER_Q": "0.7"}
    done = _run("run", ring / "encounters.csv", "--config", config, "--speed-mps", "3", "--json", "-", environment=variables)
    assert done.returncode == 0
    parameters = json.loads(done.stdout)["parameters"]
    chosen = (parameters["method"], parameters["n_points"], parameters["outlier_q"], parameters["speed_mps"])
    assert chosen == ("paper", 50, 0.7, 3.0)


@pytest.mark.parametrize("place", [["--config", "{}", "--check-config"], ["run", "--config", "{}", "--check-config"]])
def test_check_config_reports_every_fault_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str], place: list[str]) -> None:
    config = tmp_path / "mapper.toml"
    arguments = [part.format(config) for part in place]
    config.write_text("[recipe]\nn_points = 100\n")
    assert main(arguments) == 0
    assert "is valid" in capsys.readouterr().out
    config.write_text('[recipe]\nn_points = 1\nmethod = "magic"\ncolour = "red"\n')
    assert main(arguments) == 2
    errors = capsys.readouterr().err
    assert all(word in errors for word in ("n_points", "magic", "colour"))


def test_a_mapper_speaks_under_its_certificates_name_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A router would let through nothing that it says under another; with all else that is wrong, it is told before anything is opened."""
    tls = Certified(tmp_path / "ca").tls("demo/mapper/map1")
    config = tmp_path / "mapper.toml"
    table = f'[tls]\nca = "{tls.ca}"\ncertificate = "{tls.certificate}"\nkey = "{tls.key}"\n'
    for serve, faults in (
        ('site = "demo"', []),
        ('site = "demo"\nname = "map1"', []),
        ('site = "demo"\nname = "map2"', ["it is for demo/mapper/map1, but this is mapper 'map2'", "leave serve.name out"]),
        ('site = "ruin"\nport = -1', ["it is for demo/mapper/map1", "site 'ruin'", "serve.port is -1"]),
    ):
        config.write_text(f"[serve]\n{serve}\n{table}")
        assert main(["serve", "--config", str(config), "--check-config"]) == (2 if faults else 0)
        errors = capsys.readouterr().err
        assert [fault for fault in faults if fault not in errors] == []
    config.write_text(f'[serve]\nsite = "demo"\nport = -1\n{table}'.replace("key.pem", "lost.pem"))
    assert main(["serve", "--config", str(config), "--check-config"]) == 2
    errors = capsys.readouterr().err
    assert "serve.port is -1" in errors
    assert "lost.pem: cannot be read" in errors


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["serve", "--window-s", "-4"], "serve.window_s is -4"),
        (["serve", "--port", "99999"], "serve.port is 99999"),
        (["serve", "--site", "a/b"], "site"),
        (["run", "--window-s", "-4"], "--window-s is -4; wanted 0.001 to"),
        (["run", "--from-s", "5", "--until-s", "5"], "--from-s and --until-s are both 5"),
        (["run", "--speed-mps", "-1"], "recipe.speed_mps is -1"),
        (["feasibility", "--side", "-5"], "--side is -5"),
    ],
)
def test_check_config_looks_at_the_flags_too(capsys: pytest.CaptureFixture[str], arguments: list[str], fault: str) -> None:
    assert main([*arguments, "--check-config"]) == 2
    assert fault in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["serve", "--port", "0"], ["run", "--window-s", "4"], ["feasibility"], ["warm-up"], []])
def test_check_config_finds_good_flags_valid(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert main([*arguments, "--check-config"]) == 0
    assert "is valid" in capsys.readouterr().out


def test_kernels_of_no_known_kind_are_bad_configuration() -> None:
    for arguments in (["--check-config"], ["warm-up"], ["run", os.devnull]):
        done = _run(*arguments, environment={"BIOBOT_KERNELS": "foo"})
        assert done.returncode == 2
        assert done.stderr == "biobot-mapper: error: BIOBOT_KERNELS is 'foo'; set it to auto, compiled, plain, or not at all\n"


@pytest.mark.parametrize(("candidates", "code"), [(0, 0), (999, 2), (1_000, 0), (20_000, 0)])
def test_a_limit_of_candidates_leaves_enough_to_pick_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], candidates: int, code: int
) -> None:
    config = tmp_path / "mapper.toml"
    config.write_text(f"[recipe]\nmax_candidates = {candidates}\n")
    assert main(["--config", str(config), "--check-config"]) == code
    assert ("at least 1000" in capsys.readouterr().err) == (code == 2)


def test_a_reader_that_leaves_is_no_traceback(ring: Path) -> None:
    command = [sys.executable, "-m", "mapper", "run", str(ring / "encounters.csv"), "--json", "-"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read()
    assert "Traceback" not in errors
    assert process.returncode == 1


def test_an_input_is_never_overwritten_by_an_output(tmp_path: Path) -> None:
    file = tmp_path / "in.csv"
    text = "t_start_s,t_end_s,id1,id2\n1,2,1,2\n3,4,1,3\n"
    file.write_text(text)
    command = [sys.executable, "-m", "mapper", "run", str(file), "--json", str(tmp_path / "." / "in.csv")]

    result = subprocess.run(command, capture_output=True, text=True, check=False)

    assert result.returncode == 1
    assert "overwritten" in result.stderr
    assert file.read_text() == text


def test_check_config_of_serve_tries_endpoints_and_the_store_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--connect", "foo", "--check-config"]) == 2
    assert "serve.connect: endpoint 'foo' must be LINK/ADDRESS" in capsys.readouterr().err
    store = tmp_path / "store"
    assert main(["serve", "--store", str(store), "--check-config"]) == 0
    assert not list(tmp_path.iterdir())
    store.write_text("a diary")
    assert main(["serve", "--store", str(store), "--check-config"]) == 2
    assert "is not a store of records" in capsys.readouterr().err


def test_check_config_of_serve_says_what_would_be_in_the_way_now_and_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It may be the very service whose configuration is checked: warnings, not faults."""
    store = tmp_path / "store"
    holds = "import sys, pathlib, mapper.store_file as s; kept = s.open_store_file(pathlib.Path(sys.argv[1])); print(flush=True); input()"
    command = [sys.executable, "-c", holds, str(store)]
    with (
        socket.create_server(("127.0.0.1", 0)) as page,
        socket.create_server(("127.0.0.1", 0)) as bus,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder,
    ):
        assert holder.stdout is not None
        holder.stdout.readline()
        port, endpoint = page.getsockname()[1], f"tcp/127.0.0.1:{bus.getsockname()[1]}"
        assert main(["serve", "--store", str(store), "--port", str(port), "--listen", endpoint, "--check-config"]) == 0
        told = capsys.readouterr().err.splitlines()
    assert told[0].startswith(f"biobot-mapper: warning: serve.port: 127.0.0.1:{port}: another program has it; end what listens there")
    assert told[1].startswith(f"biobot-mapper: warning: serve.listen: {endpoint}: another program has it; end what listens there")
    assert told[2].startswith(f"biobot-mapper: warning: serve.store {store}: process {holder.pid} has it open; end it if")
    assert len(told) == 3
    assert main(["serve", "--store", str(store), "--port", "0", "--connect", "tcp/ROUTER:7447", "--check-config"]) == 0
    assert "serve.connect: tcp/ROUTER:7447: ROUTER stands for the router's address" in capsys.readouterr().err
    assert main(["serve", "--store", str(store), "--port", "0", "--check-config"]) == 0
    assert capsys.readouterr().err == "", "what is in nobody's way is not told"
