"""Who stands because all were stopped, and not because it was told to by itself: no landmark. Pure but for the clock it is given."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import NS_PER_S, NodeId

_FROM_NS: Final = -NS_PER_S
_TO_NS: Final = 30 * NS_PER_S
"""A biobot that is halted stands from about that moment on, as well as its clock is known, or when one of the repetitions has come."""
_KEPT: Final = 64


@dataclass(slots=True, kw_only=True)
class Halts:
    """Remembers stops of all, and stops of single biobots.

    Parameters
    ----------
    now_ns
        The monotonic clock.
    """

    now_ns: Callable[[], int] = time.monotonic_ns
    _of_all_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _alone_ns: dict[NodeId, int] = field(default_factory=dict)

    def hear(self, request: StimulationRequest, stage: CommandStage) -> None:
        """Hear of every command's stages."""
        if stage.stage is Stage.FAILED and not stage.part_of and request.action is StimulationAction.STOP:
            self._alone_ns.pop(request.node, None)
        if stage.stage is not Stage.ACCEPTED:
            return
        if request.action is StimulationAction.STOP_ALL:
            self._of_all_ns.append(self.now_ns())
        elif request.action is StimulationAction.STOP and not stage.part_of:
            self._alone_ns[request.node] = self.now_ns()

    def is_halted(self, node: NodeId, *, stands_since_ns: int, walked_since_ns: int | None) -> bool:
        """Say whether a biobot that stands by command does so because all were stopped.

        Parameters
        ----------
        stands_since_ns
            When it began to stand [monotonic].
        walked_since_ns
            When what it did before began; None: not known. A stop of it alone after that makes it stand of its own, whichever came first.
        """
        alone_ns = self._alone_ns.get(node)
        if alone_ns is not None and (walked_since_ns is None or alone_ns > walked_since_ns):
            return False
        return any(_FROM_NS <= stands_since_ns - all_ns <= _TO_NS for all_ns in self._of_all_ns)

    def was_stopped_alone(self, node: NodeId, *, since_ns: int) -> bool:
        """Say whether a biobot was told to stop by itself at a time or later [monotonic]."""
        return self._alone_ns.get(node, since_ns - 1) >= since_ns
