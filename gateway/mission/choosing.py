"""The choice of landmarks and of who takes a lost one's place: from what is known of biobots to who is picked, and on record why."""

import asyncio
import time
from collections.abc import Callable, Collection, Mapping
from typing import Protocol

from firmware_protocol.contract.records import LandmarkChoice
from firmware_protocol.units import NodeId
from gateway.config import MissionTable
from gateway.log import EventLog
from gateway.mission.candidates import USUAL_SHARE, Candidates, choice_facts, choose, choose_next, count_wanted, find_candidates
from gateway.mission.planner import MissionPlanner
from gateway.nodes import NodeBook

_log = EventLog(__name__)


class Note(Protocol):
    """Puts an entry into the audit log."""

    def __call__(self, kind: str, *, facts: Mapping[str, object], operator: str = "", node: NodeId | None = None) -> None:
        """Note what happened; never raises and never waits."""


class Chooser:
    """Belongs to one event loop; parameters are as of ``Mission``."""

    def __init__(
        self,
        *,
        config: MissionTable,
        nodes: NodeBook,
        planner: MissionPlanner,
        note: Note,
        on_event: Callable[[str, str, Mapping[str, str]], None],
    ) -> None:
        self._config = config
        self._nodes = nodes
        self._planner = planner
        self._note = note
        self._on_event = on_event
        self._is_told = False

    def begin_phase(self) -> None:
        """Tell once more, in another phase, that there are too few candidates."""
        self._is_told = False

    async def choose(self, turn: int) -> LandmarkChoice:
        """Choose in a thread: of thousands of biobots it takes a while, and radios do not wait."""
        candidates = self._candidates(now_ns=time.monotonic_ns(), excluded=self._planner.resting.keys())
        n_wanted = count_wanted(self._config, n_known=max(candidates.n_heard, 1))
        choice = await asyncio.to_thread(choose, candidates, n_wanted=n_wanted, turn=turn)
        if len(choice.awaited) < n_wanted:
            self._tell_few(choice)
            return choice
        share = n_wanted / max(candidates.n_heard, 1)
        if not USUAL_SHARE[0] <= share <= USUAL_SHARE[1] and candidates.n_heard >= 1 / USUAL_SHARE[0]:
            _log.warning("mission.share", wanted=n_wanted, biobots=candidates.n_heard, advice="the method takes 0.1 to 0.2 of them")
        self._note("landmark.choice", facts=choice_facts(choice))
        _log.info("mission.choice", wanted=n_wanted, candidates=len(choice.candidates), clusters=len(choice.clusters))
        return choice

    def pick(self, standing: Collection[NodeId], excluded: Collection[NodeId], near: NodeId | None, *, now_ns: int) -> NodeId | None:
        """Return who takes a lost landmark's place, or None; ``now_ns`` is monotonic, the rest as of ``Picker``."""
        candidates = self._candidates(now_ns=now_ns, excluded=excluded)
        node = choose_next(candidates, standing=standing, excluded=excluded, near=near)
        if node is not None:
            self._note("landmark.replacement", facts={"replaces": near, "candidates": len(candidates.eligible)}, node=node)
            self._on_event("info", "mission.replacement", {"node": str(node), "replaces": "" if near is None else str(near)})
        return node

    def _tell_few(self, choice: LandmarkChoice) -> None:
        if self._is_told:
            return
        self._is_told = True
        counts = {"wanted": choice.n_wanted, "candidates": len(choice.candidates)}
        facts = counts | {why.replace(" ", "_"): len(who) for why, who in choice.left_out.items()}
        _log.warning("mission.no_candidates", **facts)
        self._on_event("warning", "mission.no_candidates", {what: str(number) for what, number in facts.items()})

    def _candidates(self, *, now_ns: int, excluded: Collection[NodeId]) -> Candidates:
        state = self._planner.state
        standing = state.landmarks | state.awaited
        return find_candidates(self._nodes.all(), config=self._config, now_ns=now_ns, resting=excluded, standing=standing)
