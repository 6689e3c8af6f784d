"""What left the gateway's lines towards electrodes: finds the frames of each stop, and what left after one that should not."""

import json
import threading
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any, Self

from firmware_protocol.envelope import BROADCAST_ADDRESS
from studies.bench_gateway import Part
from studies.line_load import FIRST_ADDRESS
from studies.stop_asking import Answered


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A Stimulate frame: on which line, for whom, and when all of it was written by the gateway and had left [ns, monotonic]."""

    line: str
    destination: int
    action: str
    written_ns: int
    left_ns: int


@dataclass(slots=True, kw_only=True)
class Stop:
    """A stop that was asked for; ``frames`` are those that it needed, in the order in which they came."""

    way: str
    is_full: bool
    """The journal's disk was."""
    node: int
    asked_ns: int
    answered: Answered = field(default_factory=Answered)
    frames: list[Frame] = field(default_factory=list)
    n_expected: int = 1

    @property
    def is_complete(self) -> bool:
        """Every frame has left."""
        return len(self.frames) >= self.n_expected

    def facts(self) -> dict[str, Any]:
        """Return what there is to know of it, for a file."""
        frames = [
            {"line": frame.line, "written_ms": (frame.written_ns - self.asked_ns) / 1e6, "left_ms": (frame.left_ns - self.asked_ns) / 1e6}
            for frame in self.frames
        ]
        answered_ms = None if self.answered.first_ns is None else (self.answered.first_ns - self.asked_ns) / 1e6
        return {"way": self.way, "is_full": self.is_full, "node": self.node, "answered_ms": answered_ms, "frames": frames}


class StopFrames:
    """Listens to the load, in a thread, until the load ends."""

    def __init__(self, load: Part, *, lines: list[str]) -> None:
        self._load = load
        self._names = {line.partition(" ")[2]: line.partition(" ")[0] for line in lines}
        self._changed = threading.Condition()
        self._expected: Stop | None = None
        self._frames: list[Frame] = []
        self._starts: dict[int, list[int]] = {}
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        pass  # the thread ends with the load's output

    def note_start(self, node: int, at_ns: int) -> None:
        """Know that a start of a biobot is asked for from an instant on: its frames may leave again."""
        self._starts.setdefault(node, []).append(at_ns)

    def expect(self, stop: Stop, *, n: int) -> None:
        """Give what comes from now on to a stop that needs so many frames."""
        with self._changed:
            stop.n_expected = n
            self._expected = stop

    def wait_for(self, stop: Stop, *, patience_s: float) -> None:
        """Return when all frames of the stop have left, or the patience is over."""
        with self._changed:
            self._changed.wait_for(lambda: stop.is_complete, timeout=patience_s)
            self._expected = None

    def left_after_stop(self) -> list[Frame]:
        """Return the frames that gave a stimulus to a biobot after its stop had left, and before its next start was asked for."""
        stopped_ns: dict[int, int] = {}
        late: list[Frame] = []
        for frame in sorted(self._frames, key=lambda one: one.left_ns):
            node = frame.destination - FIRST_ADDRESS
            if frame.action == "stop":
                nodes = range(1, 1 << 12) if frame.destination == BROADCAST_ADDRESS else (node,)
                is_here = [one for one in nodes if frame.destination != BROADCAST_ADDRESS or self._line_of(one) == frame.line]
                stopped_ns.update(dict.fromkeys(is_here, frame.left_ns))
            elif node in stopped_ns:
                asked = self._starts.get(node, [])
                at = bisect_right(asked, frame.left_ns) - 1
                if at < 0 or asked[at] < stopped_ns[node]:
                    late.append(frame)
        return late

    @property
    def n_stimuli(self) -> int:
        """Frames that were no stops."""
        return sum(frame.action != "stop" for frame in self._frames)

    def _line_of(self, node: int) -> str:
        return list(self._names.values())[node % len(self._names)]

    def _listen(self) -> None:
        assert self._load.process.stdout is not None
        for text in self._load.process.stdout:
            facts = json.loads(text)
            if "command" not in facts:
                continue
            frame = Frame(
                line=self._names[facts["line"]],
                destination=facts["destination"],
                action=facts["action"],
                written_ns=facts["written_ns"],
                left_ns=facts["left_ns"],
            )
            with self._changed:
                self._frames.append(frame)
                self._offer(frame)
                self._changed.notify_all()

    def _offer(self, frame: Frame) -> None:
        stop = self._expected
        if stop is None or stop.is_complete or frame.action != "stop" or frame.written_ns < stop.asked_ns:
            return
        wanted = BROADCAST_ADDRESS if stop.n_expected > 1 else FIRST_ADDRESS + stop.node
        if frame.destination == wanted and (stop.n_expected == 1 or frame.line not in {one.line for one in stop.frames}):
            stop.frames.append(frame)
