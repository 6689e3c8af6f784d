"""Frames of a page in a real browser: how long each was, and what its main thread did meanwhile.

The time between two frames tells what somebody sees, on this machine with all that runs on it. Core time of tasks tells what the page
costs, however busy the machine is.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

from playwright.sync_api import Browser, CDPSession, Page

from studies.live_watch import share

_WATCH: Final = """() => {
  window.biobotGaps = [];
  let last = performance.now();
  const look = () => {
    const now = performance.now();
    biobotGaps.push(now - last);
    last = now;
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""
_CLEAR: Final = "() => { biobotGaps.length = 0; }"
_TOLD: Final = "() => biobotGaps"
# The time of a core, by the kind of work; of the page's main thread.
_WORK: Final = {"script": "ScriptDuration", "style": "RecalcStyleDuration", "layout": "LayoutDuration", "all": "TaskDuration"}
_TRACED: Final = ["-*", "toplevel", "disabled-by-default-devtools.timeline"]
_MS_PER_S: Final = 1_000
_US_PER_MS: Final = 1_000


@dataclass(slots=True)
class Frames:
    """``gaps_ms`` between one frame and the next; core time of each task and, by kind, of all work of the page's main thread [ms]."""

    gaps_ms: list[float] = field(default_factory=list)
    tasks_ms: list[float] = field(default_factory=list)
    work_ms: dict[str, float] = field(default_factory=dict)

    def told(self) -> dict[str, Any]:
        """Return the figures that a report has."""
        return {
            "frames": len(self.gaps_ms),
            **{f"p{name}_ms": share(self.gaps_ms, q) for name, q in (("50", 0.5), ("95", 0.95), ("99", 0.99))},
            "max_ms": max(self.gaps_ms, default=float("nan")),
            "longest_tasks_ms": sorted(self.tasks_ms)[-5:],
            "core_ms_per_s": {name: _MS_PER_S * spent / (sum(self.gaps_ms) or 1.0) for name, spent in self.work_ms.items()},
        }


class FrameWatch:
    """Watches a page from now on."""

    def __init__(self, browser: Browser, page: Page) -> None:
        self._browser = browser
        self._page = page
        self._debugger: CDPSession = page.context.new_cdp_session(page)
        self._debugger.send("Performance.enable", {"timeDomain": "threadTicks"})
        page.evaluate(_WATCH)

    @contextmanager
    def measured(self) -> Iterator[Frames]:
        """Collect the frames of what is done within the context."""
        found = Frames()
        before = self._work_ms()
        self._browser.start_tracing(page=self._page, categories=_TRACED)
        self._page.evaluate(_CLEAR)
        yield found
        found.gaps_ms = self._page.evaluate(_TOLD)
        found.work_ms = {name: spent - before[name] for name, spent in self._work_ms().items()}
        found.tasks_ms = _tasks_ms(json.loads(self._browser.stop_tracing())["traceEvents"])

    def _work_ms(self) -> dict[str, float]:
        metrics = {one["name"]: one["value"] for one in self._debugger.send("Performance.getMetrics")["metrics"]}
        return {name: _MS_PER_S * metrics[long_name] for name, long_name in _WORK.items()}


def _tasks_ms(events: list[dict[str, Any]]) -> list[float]:
    """Return the core time of the tasks of the busiest main thread of a page [ms]; there may be one of an empty page besides."""
    names = {(event["pid"], event["tid"]): event["args"]["name"] for event in events if event["name"] == "thread_name"}
    mains = {thread for thread, name in names.items() if name == "CrRendererMain"}
    found: dict[tuple[int, int], list[float]] = {thread: [] for thread in mains}
    for event in events:
        thread = event.get("pid"), event.get("tid")
        if event["name"] == "RunTask" and thread in found and "tdur" in event:
            found[thread].append(event["tdur"] / _US_PER_MS)
    return max(found.values(), key=sum, default=[])
