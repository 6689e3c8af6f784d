"""What a reader of the documents has at hand: a run of the simulator, logs of contacts, a journal, a recording, a plan."""

import contextlib
import gzip
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet
from PIL import Image

from gateway.journal_file import open_journal_file
from gateway.recordings.recording_file import RecordingHeader, encode_header, encode_record
from gateway.transports.recording import LineRecord, RecordKind
from simulator.__main__ import main as simulate
from tests.gateway.audited import WALL_NS, a_stage, commit


def lay_out(directory: Path) -> None:
    """Put all files there that the commands of the documents read and none of them writes."""
    run = directory / "run"
    status = simulate(["run", "--scenario", "no-obstacle", "--seed", "1", "--biobots", "40", "--duration", "60", "--out", str(run)])
    assert status == 0
    for name in ("monday", "tuesday", "wednesday"):
        shutil.copytree(run, directory / name)
    for name, source in {
        "a.csv": "encounters",
        "b.csv": "encounters",
        "contacts.csv": "encounters",
        "a_modes.csv": "modes",
        "b_modes.csv": "modes",
    }.items():
        shutil.copy(run / f"{source}.csv", directory / name)
    _write_logs(run / "encounters.csv", directory)
    _write_journal(directory / "gateway.sqlite")
    header = RecordingHeader(port="serial:/dev/ttyACM0", dialect="native", software="a gateway", wall_ns=10**18, monotonic_ns=0)
    heard = LineRecord(kind=RecordKind.BYTES_IN, monotonic_ns=1, wall_ns=10**18 + 1, data=bytes(7))
    (directory / "x.biorec").write_bytes(encode_header(header) + encode_record(heard))
    Image.new("L", (500, 400), 255).save(directory / "plan.png")
    (directory / "pins.toml").write_text("".join(f"[[pins]]\nbiobot = {n}\nt_s = 30\nx = {n}\ny = {n * n}\n" for n in (2, 3, 5)))
    (directory / "my.toml").write_text('name = "mine"\nrepeats = 2\n[grid.run]\nscenario = ["no-obstacle"]\nbiobots = [20, 40]\n')


def _write_journal(path: Path) -> None:
    with contextlib.closing(open_journal_file(path, now_wall_ns=WALL_NS, now_ns=0, machine_boot="", gateway="gateway1")) as file:
        commit(file, [a_stage(number) for number in range(3)])


def _write_logs(encounters: Path, directory: Path) -> None:
    """Write the same encounters in the other forms that logs have."""
    rows = [line.split(",") for line in encounters.read_text().splitlines()[1:]]
    log = ["on,off,who,whom", *(f"{round(1000 * float(on))},{round(1000 * float(off))},{who},{whom}" for on, off, who, whom in rows)]
    (directory / "log.csv").write_text("\n".join(log) + "\n")
    with gzip.open(directory / "tij.dat.gz", "wt") as sightings:
        seen = sorted((round(float(on)) + later, who, whom) for on, _, who, whom in rows for later in (0, 20))
        sightings.writelines(f"{at_s}\t{who}\t{whom}\n" for at_s, who, whom in seen)
    names = {"1": "north door", "2": "south door"}
    named = {
        "t_start_s": [float(row[0]) for row in rows],
        "t_end_s": [float(row[1]) for row in rows],
        "id1": [names.get(row[2], row[2]) for row in rows],
        "id2": [names.get(row[3], row[3]) for row in rows],
    }
    pa.parquet.write_table(pa.table(named), directory / "log.parquet")
    (directory / "readers.txt").write_text("south door\n")
