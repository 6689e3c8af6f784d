"""The mission's state machine (docs/mission.md has its table). Pure: it is told what is so, and returns what to do."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec

from firmware_protocol.contract.mission_orders import MissionAction
from firmware_protocol.contract.records import LandmarkChange, LandmarkChoice, MissionPhase
from firmware_protocol.units import NS_PER_S, Nanoseconds, NodeId
from gateway.config import MissionTable
from gateway.mission.candidates import why_few
from gateway.mission.phases import COMMANDING, POSSIBLE, name_of
from gateway.mission.steps import Choose, FollowWalls, LetGo, MakeLandmark, MissionState, MissionStep, Picker, Tell
from gateway.mission.wall_phases import WallPhases

MAX_CHANGES = 64
_MIN_FAILURES = 10
"""So many landmarks may fail in a round before none is replaced any more, or as many as were wanted."""

_TRY_AGAIN_NS = 5 * NS_PER_S
"""Pause before a choice or a replacement for which there was nobody is tried again."""

REST_NS = 1_800 * NS_PER_S
"""Who wandered or did not obey is not chosen again for so long."""

_P, _A = MissionPhase, MissionAction


@dataclass(slots=True, kw_only=True)
class MissionPlanner:
    """The state and the events that change it; ``now_ns`` is the journal's running time throughout.

    A landmark stands when its biobot answers the stop, or reports that it stands by then; where it does neither, the next best takes
    its place. Exploration begins when as many stand as are wanted; until then the state's reason says what is waited for. A mission that is
    paused commands nobody, and its time stands still.
    """

    config: MissionTable
    state: MissionState = field(default_factory=MissionState)
    resting: dict[NodeId, int] = field(default_factory=dict)
    """Who may not be chosen, and until when."""
    _waits_from_ns: int = 0
    _next_try_ns: int = 0
    _is_choosing: bool = False
    _is_changed: bool = False
    _warned: set[NodeId] = field(default_factory=set)
    """Landmarks that were stopped again."""
    _excused: set[NodeId] = field(default_factory=set)
    """Those that did not answer, and were found to stand after all."""
    _wall_phases: WallPhases = field(init=False)

    def __post_init__(self) -> None:
        self._wall_phases = WallPhases(config=self.config)

    def resume(self, state: MissionState, *, now_ns: int) -> list[MissionStep]:
        """Go on with the mission of an earlier process. Neighbour reports are waited for from now: those given before are gone."""
        self.state, self._waits_from_ns = state, now_ns
        for change in state.changes:
            self._rest(change.node, now_ns=now_ns)
        return self._outstanding(now_ns)

    def remaining_ns(self, now_ns: int) -> int | None:
        """Return how long the phase lasts yet, or None where no time ends it."""
        state = self.state
        phase = state.interrupted if state.phase is _P.PAUSED else state.phase
        lengths: list[float] = []
        if phase is _P.DISPERSION:
            lengths.append(self.config.dispersion_s)
        elif phase is _P.EXPLORATION:
            lengths += [self.config.redisperse_every_s] if self.config.redisperse_every_s else []
            lengths += [self.config.exploration_s - state.explored_ns / NS_PER_S] if self.config.exploration_s else []
        return None if not lengths else max(0, int(min(lengths) * NS_PER_S) - state.elapsed_ns(now_ns))

    def tick(
        self, *, now_ns: int, n_known: int, is_graph_known: bool, pick: Picker, followers: Callable[[], Collection[NodeId]] = tuple
    ) -> list[MissionStep]:
        """Return what time brings about.

        Parameters
        ----------
        n_known
            Biobots heard of; where there are none, nothing begins.
        is_graph_known
            All of them have told whom they hear; without, it is waited for, but not for ever.
        followers
            Says who walks and can follow walls.
        """
        return [
            *self._tick_phase(now_ns=now_ns, n_known=n_known, is_graph_known=is_graph_known, pick=pick),
            *self._walls(now_ns, followers),
        ]

    def _tick_phase(self, *, now_ns: int, n_known: int, is_graph_known: bool, pick: Picker) -> list[MissionStep]:
        state = self.state
        match state.phase:
            case MissionPhase.IDLE if n_known and self.config.is_enabled:
                return self._disperse(now_ns=now_ns, reason="the first biobot was heard")
            case MissionPhase.DISPERSION if state.elapsed_ns(now_ns) >= self.config.dispersion_s * NS_PER_S:
                return self._begin_selection(now_ns=now_ns, reason=f"dispersed for {self.config.dispersion_s:g} s")
            case MissionPhase.LANDMARK_SELECTION:
                return self._select(now_ns=now_ns, n_known=n_known, is_graph_known=is_graph_known, pick=pick)
            case MissionPhase.EXPLORATION:
                return self._explore(now_ns=now_ns, is_graph_known=is_graph_known, pick=pick)
            case _:
                return self._revision()

    def order(
        self, action: MissionAction, *, operator: str, order_id: str, now_ns: int, standing: Collection[NodeId] = ()
    ) -> tuple[str | None, list[MissionStep]]:
        """Take an order; return why it is refused, or None, and what is to be done.

        ``standing``: who stands by somebody's stop. Whoever orders a start wants all to walk, so they are let go.
        """
        state = self.state
        if action not in self.possible():
            can = ", ".join(one.value for one in self.possible())
            return f"the mission is {name_of(state)}, where {action.value!r} is not possible; possible is: {can}", []
        named: dict[str, Any] = {"operator": operator, "order_id": order_id}
        reason = f"ordered by {operator}"
        match action:
            case MissionAction.START:
                return None, self._disperse(now_ns=now_ns, reason=reason, standing=standing, **named)
            case MissionAction.PAUSE:
                return None, self._pause(now_ns=now_ns, reason=reason, **named)
            case MissionAction.RESUME:
                return None, self._continue(now_ns=now_ns, reason=reason, **named)
            case MissionAction.SELECT:
                return None, self._begin_selection(now_ns=now_ns, reason=reason, **named)
            case MissionAction.REDISPERSE:
                for node in () if state.choice is None else state.choice.failed:
                    self.resting.pop(node, None)  # whoever orders it has looked at them
                return None, self._disperse(now_ns=now_ns, reason=reason, **named)
            case MissionAction.FINISH:
                return None, self._enter(_P.DONE, now_ns=now_ns, reason=reason, releasing={}, **named)
            case MissionAction.SHOW:
                return None, []

    def possible(self) -> tuple[MissionAction, ...]:
        """Return the orders that would be taken now."""
        phase = self.state.phase
        waits = (_A.PAUSE,) if phase is _P.IDLE and self.config.is_enabled else ()
        return (*POSSIBLE[phase], *waits, _A.SHOW)

    def stop_all(self, *, operator: str, walking: Collection[NodeId], now_ns: int) -> list[MissionStep]:
        """Pause, because everybody was stopped; those who walked until then are let go when it is resumed."""
        state = self.state
        halted = {**dict.fromkeys(frozenset(walking) - state.landmarks - state.awaited, now_ns), **state.releasing}
        if state.following:
            self._change(following={})
        if state.phase is _P.PAUSED:
            self._change(releasing=halted)
            return self._revision()
        if _A.PAUSE not in self.possible():
            return []
        return self._pause(now_ns=now_ns, reason=f"{operator} stopped all", operator=operator, releasing=halted)

    def take_choice(self, choice: LandmarkChoice, *, now_ns: int) -> list[MissionStep]:
        """Take what ``Choose`` asked for; where fewer can be chosen than are wanted it is asked for again after a while."""
        if not self._is_choosing:
            return []
        self._is_choosing = False
        if len(choice.awaited) < choice.n_wanted:
            self._next_try_ns = now_ns + _TRY_AGAIN_NS
            return self._explain(why_few(choice))
        self._change(choice=choice)
        return [*self._revision(), *(MakeLandmark(node=node) for node in choice.awaited)]

    def settle(self, node: NodeId, *, is_standing: bool, reason: str, now_ns: int, wall_ns: int) -> list[MissionStep]:
        """Take what came of ``MakeLandmark``."""
        state = self.state
        if node in state.awaited:
            assert state.choice is not None
            awaited = tuple(one for one in state.choice.awaited if one != node)
            failed = state.choice.failed if is_standing else (*state.choice.failed, node)
            self._change(choice=msgspec.structs.replace(state.choice, awaited=awaited, failed=failed))
            if is_standing:
                self._change(landmarks=state.landmarks | {node})
            else:
                self._rest(node, now_ns=now_ns)
                self._next_try_ns = 0
            return []
        if node in self._warned and node in state.landmarks and not is_standing:
            return self.lose(node, reason=reason, is_let_go=False, now_ns=now_ns, wall_ns=wall_ns)
        return []

    def is_walking(self, node: NodeId, *, reason: str, now_ns: int, wall_ns: int) -> list[MissionStep]:
        """Take a landmark's word that it walks: it is stopped once more, and given up the next time."""
        if node not in self.state.landmarks or self.state.phase is not _P.EXPLORATION:
            return []
        if node in self._warned:
            return self.lose(node, reason=reason, is_let_go=True, now_ns=now_ns, wall_ns=wall_ns)
        self._warned.add(node)
        return [MakeLandmark(node=node, is_again=True)]

    def lose(self, node: NodeId, *, reason: str, is_let_go: bool, now_ns: int, wall_ns: int) -> list[MissionStep]:
        """Give up a landmark; another one takes its place as soon as there is one."""
        state = self.state
        if node not in state.landmarks or state.phase is not _P.EXPLORATION:
            return []
        self._rest(node, now_ns=now_ns)
        self._warned.discard(node)
        change = LandmarkChange(node=node, replacement=None, reason=reason, wall_ns=Nanoseconds(wall_ns))
        self._change(
            landmarks=state.landmarks - {node},
            changes=(*state.changes, change)[-MAX_CHANGES:],
            releasing={**state.releasing, node: now_ns} if is_let_go else state.releasing,
        )
        self._next_try_ns = 0
        return [*self._revision(), LetGo(node=node, decided_ns=now_ns)] if is_let_go else self._revision()

    def stands_after_all(self, node: NodeId, *, now_ns: int) -> list[MissionStep]:
        """Take the word of one that did not answer that it stands: it is a landmark where one is wanted, else it is let go, once."""
        state, choice = self.state, self.state.choice
        if state.phase not in COMMANDING or choice is None or node not in choice.failed or node in self._excused:
            return []
        self._excused.add(node)
        if len(state.landmarks | state.awaited) < choice.n_wanted:
            failed = tuple(one for one in choice.failed if one != node)
            self._change(landmarks=state.landmarks | {node}, choice=msgspec.structs.replace(choice, failed=failed))
            return self._revision()
        self._change(releasing={**state.releasing, node: now_ns})
        return [*self._revision(), LetGo(node=node, decided_ns=now_ns)]

    def released(self, node: NodeId) -> None:
        """Take that ``LetGo`` has had its one answer."""
        if node in self.state.releasing:
            self._change(releasing={one: at_ns for one, at_ns in self.state.releasing.items() if one != node})

    def follows(self, step: FollowWalls, *, now_ns: int) -> bool:
        """Return whether what a step asks for is wanted yet: it is not when its time is over, nor of a landmark or one commanded since."""
        return self._wall_phases.wants(step, self.state, now_ns=now_ns)

    def leave_walls(self, node: NodeId, *, decided_ns: int | None = None) -> list[MissionStep]:
        """Take that a biobot was told to walk as before, or (without an instant) that somebody else commands it, and it is told nothing."""
        if node in self.state.following and decided_ns in {None, self.state.following[node]}:
            self._change(following={one: at_ns for one, at_ns in self.state.following.items() if one != node})
        return self._revision()

    def _walls(self, now_ns: int, followers: Callable[[], Collection[NodeId]]) -> list[MissionStep]:
        """Begin a wall phase, or end it."""
        if self.state.phase not in COMMANDING:
            return []
        changes, steps = self._wall_phases.decide(self.state, now_ns=now_ns, followers=followers)
        if not changes and not steps:
            return []
        self._change(**changes)
        return [*self._revision(), *steps]

    def _select(self, *, now_ns: int, n_known: int, is_graph_known: bool, pick: Picker) -> list[MissionStep]:
        state = self.state
        if state.choice is None:
            waited_ns = min(state.elapsed_ns(now_ns), now_ns - self._waits_from_ns)
            is_ready = is_graph_known or waited_ns >= self.config.selection_timeout_s * NS_PER_S
            if not n_known:
                return self._explain("waits until a biobot is heard; look at the radios and at the backpacks")
            if not is_ready:
                text = f"waits until all have told whom they hear, {self.config.selection_timeout_s:g} s at most"
                return self._explain(text) if waited_ns >= _TRY_AGAIN_NS else []
            if self._is_choosing or now_ns < self._next_try_ns:
                return []
            self._is_choosing = True
            return [Choose(turn=max(0, state.round - 1))]
        steps = self._fill(now_ns=now_ns, is_graph_known=is_graph_known, pick=pick)
        if self.state.awaited:
            return steps or self._revision()
        reason = f"{len(state.landmarks)} landmarks stand"
        if state.choice.failed:
            reason += f"; not reached: {', '.join(str(node) for node in sorted(state.choice.failed))}"
        if len(state.landmarks) < state.choice.n_wanted:
            wait = "waits for another candidate" if self._may_replace(state.choice) else "so many failed that none is asked any more"
            return self._explain(f"{reason}; {state.choice.n_wanted} are wanted: {wait}; look at them, then order redisperse, or finish")
        return self._enter(_P.EXPLORATION, now_ns=now_ns, reason=reason)

    def _explore(self, *, now_ns: int, is_graph_known: bool, pick: Picker) -> list[MissionStep]:
        state, config = self.state, self.config
        explored_s = (state.explored_ns + state.elapsed_ns(now_ns)) / NS_PER_S
        if config.exploration_s and explored_s >= config.exploration_s:
            return self._enter(_P.DONE, now_ns=now_ns, reason=f"explored for {config.exploration_s:g} s", releasing={})
        if config.redisperse_every_s and state.elapsed_ns(now_ns) >= config.redisperse_every_s * NS_PER_S:
            return self._disperse(now_ns=now_ns, reason=f"explored for {config.redisperse_every_s:g} s from these landmarks")
        return self._fill(now_ns=now_ns, is_graph_known=is_graph_known, pick=pick) or self._revision()

    def _fill(self, *, now_ns: int, is_graph_known: bool, pick: Picker) -> list[MissionStep]:
        """Ask one more where fewer landmarks stand or are asked than are wanted."""
        state, choice = self.state, self.state.choice
        if choice is None or len(state.landmarks | state.awaited) >= choice.n_wanted or now_ns < self._next_try_ns:
            return []
        if not self._may_replace(choice) or not (is_graph_known or self._has_waited(now_ns)):
            return []
        self.resting = {node: until_ns for node, until_ns in self.resting.items() if until_ns > now_ns}
        vacant = next((index for index, change in enumerate(state.changes) if change.replacement is None), None)
        lost = state.changes[vacant].node if vacant is not None else (choice.failed[-1] if choice.failed else None)
        node = pick(state.landmarks | state.awaited, self.resting.keys() | state.releasing.keys() | set(choice.failed), lost)
        if node is None:
            self._next_try_ns = now_ns + _TRY_AGAIN_NS
            return []
        if vacant is not None:
            filled = msgspec.structs.replace(state.changes[vacant], replacement=node)
            self._change(changes=(*state.changes[:vacant], filled, *state.changes[vacant + 1 :]))
        self._change(choice=msgspec.structs.replace(choice, awaited=(*choice.awaited, node)))
        return [*self._revision(), MakeLandmark(node=node)]

    def _may_replace(self, choice: LandmarkChoice) -> bool:
        # So many silent animals are a fault of ours: each replacement may be one more that stands without our knowing.
        return len(choice.failed) < max(_MIN_FAILURES, choice.n_wanted)

    def _has_waited(self, now_ns: int) -> bool:
        return now_ns - self._waits_from_ns >= self.config.selection_timeout_s * NS_PER_S

    def _begin_selection(self, *, now_ns: int, reason: str, **named: Any) -> list[MissionStep]:
        self._is_choosing, self._next_try_ns = False, 0
        return self._enter(_P.LANDMARK_SELECTION, now_ns=now_ns, reason=reason, choice=None, **named)

    def _disperse(self, *, now_ns: int, reason: str, standing: Collection[NodeId] = (), **named: Any) -> list[MissionStep]:
        """Let those that stand go, and have all walk; a mission that was done begins anew."""
        state = self.state
        is_anew = state.phase in {_P.IDLE, _P.DONE}
        ran_ns = state.elapsed_ns(now_ns) if state.phase is _P.EXPLORATION else 0
        self._warned.clear()
        self._excused.clear()
        self._is_choosing = False
        steps = self._enter(
            _P.DISPERSION,
            now_ns=now_ns,
            reason=reason,
            round=1 if is_anew else state.round + 1,
            explored_ns=0 if is_anew else state.explored_ns + ran_ns,
            landmarks=frozenset(),
            releasing={**dict.fromkeys(state.landmarks | state.awaited | frozenset(standing), now_ns), **state.releasing},
            choice=None,
            changes=() if is_anew else state.changes,
            **named,
        )
        return [*steps, *self._outstanding(now_ns)]

    def _pause(self, *, now_ns: int, reason: str, **named: Any) -> list[MissionStep]:
        state = self.state
        self._is_choosing = False
        return self._enter(
            _P.PAUSED,
            now_ns=now_ns,
            reason=reason,
            interrupted=state.phase,
            spent_ns=state.elapsed_ns(now_ns),
            wall_phase=state.wall_phase,
            **named,
        )

    def _continue(self, *, now_ns: int, reason: str, **named: Any) -> list[MissionStep]:
        state = self.state
        assert state.interrupted is not None
        # Silence and reports are judged from now on: during the pause nobody may have said anything.
        self._waits_from_ns, self._next_try_ns = now_ns, 0
        steps = self._enter(
            state.interrupted,
            now_ns=now_ns,
            reason=reason,
            is_continued=True,
            spent_ns=state.spent_ns,
            wall_phase=state.wall_phase,
            **named,
        )
        return [*steps, *self._outstanding(now_ns)]

    def _outstanding(self, now_ns: int) -> list[MissionStep]:
        """Return the commands that were decided on, and whose outcome is not known."""
        if self.state.phase not in COMMANDING:
            return []
        going = [LetGo(node=node, decided_ns=at_ns) for node, at_ns in sorted(self.state.releasing.items())]
        walls = self._wall_phases.again(self.state, now_ns=now_ns)
        return [*(MakeLandmark(node=node) for node in sorted(self.state.awaited)), *going, *walls]

    def _rest(self, node: NodeId, *, now_ns: int) -> None:
        self.resting[node] = now_ns + REST_NS

    def _enter(self, phase: MissionPhase, *, now_ns: int, **changed: Any) -> list[MissionStep]:
        """Begin a phase; what is not given of its name, its cause and its time is empty."""
        bare: dict[str, Any] = {"spent_ns": 0, "wall_phase": 0, "interrupted": None, "is_continued": False, "operator": "", "order_id": ""}
        self.state = replace(self.state, **bare | changed, phase=phase, began_ns=now_ns)
        self._is_changed = False
        return [Tell(state=self.state, is_revision=False)]

    def _change(self, **changed: Any) -> None:
        self.state = replace(self.state, **changed)
        self._is_changed = True

    def _explain(self, reason: str) -> list[MissionStep]:
        """Write down, once, what the phase waits for."""
        if self.state.reason != reason:
            self._change(reason=reason)
        return self._revision()

    def _revision(self) -> list[MissionStep]:
        """Return the writing down of what has changed since it last was."""
        if not self._is_changed:
            return []
        self._is_changed = False
        return [Tell(state=self.state, is_revision=True)]
