"""How fluid the operator's page is, in a real browser: ``python -m studies.page_speed``.

Rows that all change twice a second; a map of many triangles, and one of 100,000 encounters, dragged and enlarged; and all of that at once
while maps come in. Of each: the time from one frame to the next, and the core time of the page's main thread, which says what the page
costs however busy the machine is.
"""

import argparse
import json
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from playwright.sync_api import Browser

from studies.chromium import CHROMIUM, launched
from studies.page_speed.scenes import watch_live, watch_map, watch_rows
from studies.page_speed.site import Walk, serve
from studies.parts import Parts
from studies.system import PartFailedError

_MARK: Final = "page-speed"
_MANY_TRIANGLES: Final = Walk(scenario="two-obstacles", duration_s=200.0)
_MANY_ENCOUNTERS: Final = Walk(scenario="five-obstacles", duration_s=900.0)
_LIVE: Final = Walk(scenario="five-obstacles", duration_s=900.0, n_stored=100_000)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and report; 0 where no frame took longer than asked, 1 where one did."""
    parser = argparse.ArgumentParser(prog="python -m studies.page_speed", description=__doc__)
    parser.add_argument("--biobots", type=int, default=500, help="rows of the table (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="that rows and maps are looked at (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=150.0, help="encounters a second while maps come in (default: %(default)s)")
    parser.add_argument("--scenes", default="rows,triangles,encounters,live", help="which (default: %(default)s)")
    parser.add_argument("--most-ms", type=float, default=50.0, help="99 of 100 frames take no longer (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("page-speed-out"), help="made anew; logs stay there (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there too")
    options = parser.parse_args(arguments)
    out: Path = options.out.resolve()
    if CHROMIUM is None:
        print("error: no chromium on the PATH; make system-packages installs it", file=sys.stderr)
        return 2
    if out.exists() and any(out.iterdir()) and not (out / _MARK).exists():
        print(f"error: {out} is not empty and not of an earlier run; choose another --out", file=sys.stderr)
        return 2
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / _MARK).touch()
    try:
        facts = _measure(options, out)
    except PartFailedError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.json is not None:
        options.json.write_text(json.dumps(facts, indent=1) + "\n")
    print(_report(facts))
    return 0 if all(one["p99_ms"] <= options.most_ms for _, one in _rows_of(facts)) else 1


def _measure(options: argparse.Namespace, out: Path) -> dict[str, Any]:
    n, seconds = options.biobots, options.seconds
    scenes: dict[str, tuple[dict[str, Any], Callable[[Browser, Any], dict[str, Any]]]] = {
        "rows": ({"n_biobots": n}, lambda browser, site: watch_rows(browser, site, n_biobots=n, seconds=seconds)),
        "triangles": ({"walked": _MANY_TRIANGLES}, watch_map),
        "encounters": ({"walked": _MANY_ENCOUNTERS}, watch_map),
        "live": (
            {"walked": _LIVE, "n_biobots": n, "rate": options.rate},
            lambda browser, site: watch_live(browser, site, seconds=seconds),
        ),
    }
    facts: dict[str, Any] = {"cpus": os.cpu_count(), "load_before": os.getloadavg()[0], "scenes": {}}
    with launched() as browser:
        for name in options.scenes.split(","):
            prepared, watch = scenes[name]
            with Parts(out=out) as parts:
                print(name, file=sys.stderr, flush=True)
                site = serve(parts, name=name, **prepared)
                facts["scenes"][name] = watch(browser, site)
                if "walked" in prepared:
                    facts["scenes"][name]["map"] = site.ask("/api/v1/map/status")["n_encounters"]
    facts["load_after"] = os.getloadavg()[0]
    return facts


def _rows_of(facts: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [
        (f"{name}: {what}", one)
        for name, scene in facts["scenes"].items()
        for what, one in scene.items()
        if isinstance(one, dict) and "p99_ms" in one
    ]


def _report(facts: dict[str, Any]) -> str:
    lines = [
        f"{facts['cpus']} cores, load {facts['load_before']:.1f} before, {facts['load_after']:.1f} at the end",
        "",
        "main thread: core time of its longest task, and of all a second, of which script, style and layout",
        "",
        "| | frames | p50 ms | p95 ms | p99 ms | max ms | longest task, core ms | core ms a second | script | style | layout |",
        "|---" * 11 + "|",
    ]
    for name, one in _rows_of(facts):
        frames = " | ".join(f"{one[key]:.0f}" for key in ("frames", "p50_ms", "p95_ms", "p99_ms", "max_ms"))
        core = " | ".join(f"{one['core_ms_per_s'][kind]:.0f}" for kind in ("all", "script", "style", "layout"))
        lines.append(f"| {name} | {frames} | {one['longest_tasks_ms'][-1]:.0f} | {core} |")
    if "rows" in facts["scenes"]:
        sorting = facts["scenes"]["rows"]["sorting"]
        lines += ["", "sorted and shown after: " + ", ".join(f"by {label} {waited:.0f} ms" for label, waited in sorting.items())]
    if "live" in facts["scenes"]:
        lines += ["", f"maps that came in while live: {facts['scenes']['live']['maps']}"]
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
