"""What the page is of: mappers on stores that simulated walks have filled, and gateways that tell them more."""

import csv
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import httpx
import numpy as np

from mapper.access import Role, add_token
from studies.live_feeder import NAME as FEEDER
from studies.live_life import Life, fill_store
from studies.page_speed.herd import NAME as HERD
from studies.parts import Parts
from studies.ports import free_port

_NS_PER_S: Final = 1_000_000_000
_OPERATOR: Final = "operator"


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """A simulated walk: in which arena, for how long [s]; what a store has of it, None: all."""

    scenario: str
    duration_s: float
    n_stored: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A mapper that serves; its page's address, and an operator's token."""

    url: str
    token: str

    def ask(self, path: str) -> Any:
        """Return the JSON behind a path, or None where there is none yet."""
        answer = httpx.get(self.url + path, timeout=60, headers={"Authorization": f"Bearer {self.token}"})
        return answer.json() if answer.status_code == httpx.codes.OK else None


def walk(directory: Path, wanted: Walk) -> tuple[Life, list[int]]:
    """Let the paper's swarm walk, in metres, and read whom it met, and who stood still."""
    command = ["run", "--scenario", wanted.scenario, "--preset", "paper-50cm", "--seed", "3", "--duration", str(wanted.duration_s)]
    subprocess.run([sys.executable, "-m", "simulator", *command, "--out", str(directory), "--force"], check=True, capture_output=True)
    rows = np.array([[float(value) for value in row.values()] for row in _rows(directory / "encounters.csv")])
    rows = rows[np.argsort(rows[:, 1], kind="stable")]
    times_ns, ids = np.rint(rows[:, :2] * _NS_PER_S).astype(np.int64), rows[:, 2:].astype(np.int64)
    life = Life(id1=ids[:, 0], id2=ids[:, 1], t_start_ns=times_ns[:, 0], t_end_ns=times_ns[:, 1])
    return life, [int(row["id"]) for row in _rows(directory / "modes.csv") if row["mode"] == "S"]


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def serve(parts: Parts, *, name: str, walked: Walk | None = None, n_biobots: int = 0, rate: float = 0.0) -> Site:
    """Start a mapper on what was walked, and gateways: one that tells of so many biobots, and one that tells of the rest of the walk.

    It returns when the page has something to show.
    """
    out = parts.out / name
    out.mkdir()
    ends = {HERD: f"tcp/127.0.0.1:{free_port()}", FEEDER: f"tcp/127.0.0.1:{free_port()}"}
    anchor_ns = time.time_ns()
    first = 0
    if walked is not None:
        life, landmarks = walk(out / "walk", walked)
        life.save(out / "life.npz")
        anchor_ns -= int(life.t_end_ns[-1])
        first = len(life) if walked.n_stored is None else walked.n_stored
        fill_store(out / "mapper.sqlite", life, n_encounters=first, anchor_ns=anchor_ns, landmarks=landmarks)
    if n_biobots:
        herd = ["--biobots", n_biobots, "--journal", out / "herd.sqlite", "--listen", ends[HERD]]
        parts.start(f"{name}-herd", "studies.page_speed.herd", *herd)
    tokens = out / "tokens.json"
    add_token(tokens, name=_OPERATOR, role=Role.OPERATOR, secret_file=out / "token")
    mapper = ["serve", "--store", out / "mapper.sqlite", "--port", 0, "--url-file", out / "url", "--tokens", tokens]
    parts.start(name, "mapper", *mapper, *(argument for end in ends.values() for argument in ("--connect", end)))
    parts.wait((out / "url").exists, what="mapper ready")
    site = Site(url=(out / "url").read_text().strip().rstrip("/"), token=(out / "token").read_text().strip())
    if walked is not None:
        parts.wait(lambda: site.ask("/api/v1/map/status")["n_encounters"] == first, what="first map")
    if n_biobots:
        parts.wait(lambda: len(site.ask("/api/v1/biobots")["biobots"]) == n_biobots, what="all biobots")
    if rate:
        feeder = ["--life", out / "life.npz", "--journal", out / "feeder.sqlite", "--listen", ends[FEEDER], "--anchor-ns", anchor_ns]
        parts.start(f"{name}-feeder", "studies.live_feeder", *feeder, "--first", first, "--rate", rate, "--done-file", out / "done")
        parts.wait(lambda: site.ask("/api/v1/map/status")["n_known"] > first, what="records of the feeder")
    return site
