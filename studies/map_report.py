"""The benchmark of maps as Markdown."""

from collections.abc import Sequence

import numpy as np

from studies.map_measures import Bench, Verdict, judge

_REST = "done"  # as the mapper calls what comes after its last stage


def to_markdown(bench: Bench) -> str:
    """Write tables of stages, comparisons and verdicts."""
    about = ", ".join(f"{name} {value}" if name else value for name, value in bench.machine.items())
    start_s = f"{np.median(bench.start_s):.2f} s, of cores {np.median(bench.start_core_s):.2f}"
    parts = [
        f"{about}; load average {bench.load[0]:.1f} before and {bench.load[1]:.1f} after; seed {bench.seed}.",
        "From encounters in memory to distance matrix, diagrams and embedding: medians of whole maps in a process of their own [ms].",
        _stages(bench),
        "Ratios of cores' time, which other programs disturb less, and by the wall's clock; results compared point by point.",
        _table(
            ("what", "encounters", "ours [core s]", "theirs [core s]", "ratio", "by the clock", "theirs", "results"),
            [
                (
                    one.name,
                    f"{one.encounters:,}",
                    f"{one.ours_core_s:.3g}",
                    f"{one.theirs_core_s:.3g}",
                    f"**{_ratio(one.ratio)}**",
                    _ratio(one.wall_ratio),
                    one.note,
                    "; ".join(one.differences) or "equal",
                )
                for one in bench.comparisons
            ],
        ),
        f"From the start of a process to its first map, of {bench.start_encounters:,} encounters: {start_s} s.",
        *([f"Left out, because it would have taken too long: {'; '.join(bench.left_out)}."] if bench.left_out else []),
        _verdicts(judge(bench)),
    ]
    return "\n\n".join(parts)


def _stages(bench: Bench) -> str:
    names = list(dict.fromkeys(stage for timing in bench.maps for stage in timing.stages_s))
    header = ("case", "kernels", "encounters", *("rest" if name == _REST else name for name in names), "total", "cores", "memory", "points")
    rows = [
        (
            timing.case,
            timing.kernels.value,
            f"{timing.encounters:,}",
            *(_ms(timing.stages_s.get(name, 0.0)) for name in names),
            f"**{_ms(timing.total_s)}**",
            _ms(timing.core_s),
            f"{timing.peak_bytes / 1e9:.2f} GB",
            timing.points,
        )
        for timing in bench.maps
    ]
    return _table(header, rows)


def _verdicts(verdicts: Sequence[Verdict]) -> str:
    rows = [(one.name, one.got, one.wanted, "met" if one.is_met else "**missed**") for one in verdicts]
    return _table(("wanted", "got", "limit", ""), rows)


def _ratio(value: float) -> str:
    return f"{value:,.1f}" if value < 10 else f"{value:,.0f}"


def _ms(seconds: float) -> str:
    digits = max(0, 2 - int(np.floor(np.log10(max(seconds * 1e3, 0.01)))) - 1)
    return f"{seconds * 1e3:,.{digits}f}"


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)
