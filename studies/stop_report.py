"""Puts the stops of a run into words: percentiles of each way and of each kind of line, and what the time consisted of."""

import os
from collections.abc import Sequence
from typing import Final

import numpy as np

from studies.stop_frames import Stop, StopFrames

TARGET_MS: Final = 20.0
_PERCENTILES: Final = (50, 90, 99, 100)


def report(stops: Sequence[Stop], frames: StopFrames) -> tuple[str, bool]:
    """Return the report, and whether every stop left and nothing left after it."""
    lines = [
        "",
        "Request to the last octet at the line's speed [ms]:",
        "",
        "| way | stops | p50 | p90 | p99 | max |",
        "|---|---|---|---|---|---|",
    ]
    groups = sorted({(stop.is_full, stop.way) for stop in stops})
    for is_full, way in groups:
        group = [stop for stop in stops if (stop.is_full, stop.way) == (is_full, way)]
        lines.append(_row(_name(way, is_full=is_full), [_left_ms(stop, at) for stop in group for at in range(len(stop.frames))]))
    lines += ["", "By kind of line, all ways:", "", "| line | frames | p50 | p90 | p99 | max |", "|---|---|---|---|---|---|"]
    for name in sorted({frame.line for stop in stops for frame in stop.frames}):
        lines.append(_row(name, [_left_ms(stop, at) for stop in stops for at, frame in enumerate(stop.frames) if frame.line == name]))
    lines += [
        "",
        "What it consists of, median and p99 [ms]:",
        "",
        "| way | until the first answer | until written | on the line |",
        "|---|---|---|---|",
    ]
    for is_full, way in groups:
        group = [stop for stop in stops if (stop.is_full, stop.way) == (is_full, way)]
        answered = [(stop.answered.first_ns - stop.asked_ns) / 1e6 for stop in group if stop.answered.first_ns is not None]
        written = [(frame.written_ns - stop.asked_ns) / 1e6 for stop in group for frame in stop.frames]
        line = [(frame.left_ns - frame.written_ns) / 1e6 for stop in group for frame in stop.frames]
        lines.append(f"| {_name(way, is_full=is_full)} | {_two(answered)} | {_two(written)} | {_two(line)} |")
    n_missing = sum(not stop.is_complete for stop in stops)
    late = frames.left_after_stop()
    lines += [
        "",
        f"{n_missing} of {len(stops)} stops did not leave; {len(late)} of {frames.n_stimuli} stimuli left after their biobot's stop.",
    ]
    lines += [f"  {frame}" for frame in late[:5]]
    lines.append(f"Load average {', '.join(f'{one:.1f}' for one in os.getloadavg())} on {os.cpu_count()} cores.")
    return "\n".join(lines), not n_missing and not late


def _left_ms(stop: Stop, at: int) -> float:
    return (stop.frames[at].left_ns - stop.asked_ns) / 1e6


def _name(way: str, *, is_full: bool) -> str:
    return {"zenoh": "Zenoh", "rest": "REST", "all": "stop of all, Zenoh"}[way] + (", disk full" if is_full else "")


def _row(name: str, values: Sequence[float]) -> str:
    cells = [f"{np.percentile(values, p):.1f}" for p in _PERCENTILES] if values else ["-"] * len(_PERCENTILES)
    return f"| {name} | {len(values)} | {' | '.join(cells)} |"


def _two(values: Sequence[float]) -> str:
    return f"{np.percentile(values, 50):.1f}, {np.percentile(values, 99):.1f}" if values else "-"
