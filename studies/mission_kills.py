"""A mission whose gateway is killed at random moments, in every phase: ``python -m studies.mission_kills``.

A simulated swarm walks; a real gateway runs the mission. SIGKILL ends the gateway, and another one is started on the same journal, again
and again, until the mission is done. Then the journal says whether each phase came once, whether landmarks were chosen once, and whether
those that stand at the end, by the simulator's truth, are those that were chosen and those that replaced who did not answer.
"""

import argparse
import csv
import random
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.records import Cause, MissionPhase, MissionRecord, Mode
from firmware_protocol.units import NodeId
from gateway.journal_file import JournalReader
from studies.parts import Parts
from studies.ports import free_port
from studies.system import PartFailedError

_KILLED_IN = (MissionPhase.DISPERSION, MissionPhase.LANDMARK_SELECTION, MissionPhase.EXPLORATION)
_POLL_S = 0.01
_TIMEOUT_S = 120.0
_CONFIG = "[stimulation]\nstop_retry_s = 4\n"
"""A stop is given up after five times as long. Nothing is lost here, so it is no test of patience: a busy machine only answers late."""
_WHOLE = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A mission, and how often its gateway is killed. Lengths are in seconds."""

    seed: int
    kills: int
    biobots: int = 40
    landmarks: int = 6
    dispersion_s: float = 1.5
    exploration_s: float = 3.0
    longest_selection_s: float = 0.4
    """A kill in the selection comes at most so long after its beginning."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What became of a mission. ``killed_in``: the phase that the journal had when the gateway was dead, None before any."""

    killed_in: tuple[MissionPhase | None, ...]
    n_killed_choosing: int
    """Of the kills in the selection, those after the choice was on disk and before all had answered."""
    problems: tuple[str, ...]
    duration_s: float


def kill_a_mission(plan: Plan, *, out: Path) -> Ending:
    """Run a mission to its end through all kills.

    Raises
    ------
    PartFailedError
        A process ended by itself, or the mission does not come to its end.
    """
    draw = random.Random(f"mission-kills {plan.seed}")
    begun_s = time.monotonic()
    ready, journal = out / "ready", out / "gateway.sqlite"
    killed_in: list[MissionPhase | None] = []
    n_killed_choosing = 0
    with Parts(out=out) as parts:
        parts.start(
            "simulator", "simulator", "serve", "--scenario", "two-obstacles", "--link", f"pty:{out / 'radio'}", "--biobots", plan.biobots,
            "--seed", plan.seed, "--neighbours-period-s", 0.5, "--ready-file", ready, "--out", out / "truth",
        )  # fmt: skip
        parts.wait(ready.exists, what="the simulator is ready")
        for number in range(plan.kills):
            _start_gateway(parts, plan, out=out)
            target = _KILLED_IN[draw.randrange(len(_KILLED_IN))] if plan.kills > len(_KILLED_IN) else _KILLED_IN[number]
            _wait_until(parts, journal, phase=target)
            longest_s = {
                MissionPhase.DISPERSION: plan.dispersion_s,
                MissionPhase.LANDMARK_SELECTION: plan.longest_selection_s,
                MissionPhase.EXPLORATION: plan.exploration_s,
            }[target]
            time.sleep(draw.uniform(0, longest_s))
            parts.stop("gateway", number=signal.SIGKILL)
            found = _newest(journal)
            killed_in.append(None if found is None else found.phase)
            n_killed_choosing += found is not None and found.choice is not None and bool(found.choice.awaited)
            if found is not None and found.phase is MissionPhase.DONE:
                break
        _start_gateway(parts, plan, out=out)
        _wait_until(parts, journal, phase=MissionPhase.DONE)
        parts.stop("gateway")
        parts.stop("simulator")
    problems = check_mission(journal, truth=out / "truth" / "modes.csv", n_landmarks=plan.landmarks)
    duration_s = time.monotonic() - begun_s
    return Ending(killed_in=tuple(killed_in), n_killed_choosing=n_killed_choosing, problems=tuple(problems), duration_s=duration_s)


def check_mission(journal: Path, *, truth: Path, n_landmarks: int) -> list[str]:
    """Return what is wrong with the mission that a journal tells of; nothing, where all is well.

    Parameters
    ----------
    truth
        The simulator's spells of all insects.
    """
    reader = JournalReader(journal)
    try:
        records = reader.read_recent_missions(limit=_WHOLE)
    finally:
        reader.close()
    problems: list[str] = []
    newest = {record.identity: record for record in records}
    phases = [record.phase for record in newest.values()]
    if phases != [*_KILLED_IN, MissionPhase.DONE]:
        problems.append(f"the phases were {', '.join(phase.value for phase in phases)}; wanted each once")
    choices = [record.choice for record in records if record.choice is not None]
    if len({(choice.candidates, choice.clusters) for choice in choices}) != 1:
        problems.append("landmarks were chosen more than once, or never")
        return problems
    picks = {pick for cluster in choices[0].clusters for pick in cluster.picks}
    asked: set[NodeId] = set()
    for choice in choices:
        asked |= set(choice.awaited)
    failed = set(choices[-1].failed)
    done = records[-1]
    lost = {change.node for change in done.changes}
    if set(done.landmarks) != asked - failed - lost or not picks <= asked:
        problems.append(f"landmarks {sorted(done.landmarks)} are not those asked {sorted(asked)} without {sorted(failed | lost)}")
    if not failed | lost and set(done.landmarks) != picks:
        problems.append(f"landmarks {sorted(done.landmarks)} are not those chosen {sorted(picks)}")
    if len(done.landmarks) != n_landmarks:
        problems.append(f"{len(done.landmarks)} landmarks; wanted {n_landmarks}")
    with truth.open(newline="") as file:
        last = {int(row["id"]): row for row in sorted(csv.DictReader(file), key=lambda row: float(row["t_start_s"]))}
    standing = {node for node, row in last.items() if (row["mode"], row["cause"]) == (Mode.S.value, Cause.COMMAND.value)}
    if not set(done.landmarks) <= standing <= set(done.landmarks) | failed | lost:
        problems.append(f"{sorted(standing)} stand by command, but the landmarks are {sorted(done.landmarks)}")
    return problems


def _start_gateway(parts: Parts, plan: Plan, *, out: Path) -> None:
    config = out / "gateway.toml"
    config.write_text(_CONFIG)
    parts.start(
        "gateway", "gateway", "run", "--config", config, "--port", (out / "ready").read_text().strip(), "--journal", out / "gateway.sqlite",
        "--listen", f"tcp/127.0.0.1:{free_port()}", "--mission", "--dispersion-s", plan.dispersion_s, "--landmarks", plan.landmarks,
        "--exploration-s", plan.exploration_s, "--log-format", "json",
    )  # fmt: skip


def _newest(journal: Path) -> MissionRecord | None:
    if not journal.exists():
        return None
    reader = JournalReader(journal)
    try:
        found = reader.read_recent_missions(limit=1)
    except sqlite3.OperationalError:  # it is being made, and has no tables yet
        return None
    finally:
        reader.close()
    return found[0] if found else None


def _wait_until(parts: Parts, journal: Path, *, phase: MissionPhase) -> None:
    """Wait until the mission is in a phase, or past it."""
    deadline_s = time.monotonic() + _TIMEOUT_S
    order = [*_KILLED_IN, MissionPhase.DONE]
    while True:
        parts.check()
        found = _newest(journal)
        if found is not None and order.index(found.phase) >= order.index(phase):
            return
        if time.monotonic() > deadline_s:
            raise PartFailedError(f"the mission is not in {phase.value} after {_TIMEOUT_S:g} s; the logs are in {parts.out}")
        time.sleep(_POLL_S)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what became of each mission; return the exit status: 0 all is well, 1 something is wrong, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.mission_kills", description="Kill the gateway in the middle of missions.")
    parser.add_argument("--kills", type=int, default=50, metavar="N", help="in all (default: %(default)s)")
    parser.add_argument("--each", type=int, default=5, metavar="N", help="kills of one mission (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the first mission (default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.kills < 1 or not 1 <= options.each <= 20:
        parser.error(f"--kills {options.kills} --each {options.each}; wanted at least 1 kill, and 1 to 20 of each mission")
    where: Counter[str] = Counter()
    n_choosing, n_bad, seed = 0, 0, options.seed
    while where.total() < options.kills:
        plan = Plan(seed=seed, kills=min(options.each, options.kills - where.total()))
        with tempfile.TemporaryDirectory(prefix="mission-kills-") as directory:
            ending = kill_a_mission(plan, out=Path(directory))
        where.update("before any" if phase is None else phase.value for phase in ending.killed_in)
        n_choosing += ending.n_killed_choosing
        n_bad += bool(ending.problems)
        told = "; ".join(ending.problems) or "the same landmarks to the end"
        print(f"mission {seed}: {len(ending.killed_in)} kills in {ending.duration_s:.0f} s: {told}", flush=True)
        seed += 1
    places = ", ".join(f"{count} in {name.replace('_', ' ')}" for name, count in sorted(where.items()))
    print(f"{where.total()} kills ({places}; {n_choosing} while chosen landmarks were awaited): {n_bad} missions with problems")
    return 1 if n_bad else 0


if __name__ == "__main__":
    sys.exit(main())
