"""Carries out on the world what backpacks do to insects, and the insects' responses a moment later. No clock."""

import dataclasses
import heapq
import math
from dataclasses import dataclass

from firmware_protocol.messages import Action, WireCause, WireMode
from firmware_protocol.units import NS_PER_S, NodeId
from simulator.backpacks.stimulator import Actuation
from simulator.events import Cause
from simulator.habitat import Habitat
from simulator.response import Responder, Response, ResponseConfig, Train

_CAUSE = {WireCause.NATURAL: Cause.NATURAL, WireCause.COMMAND: Cause.COMMAND}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutedActuation:
    """What was done to an insect at ``t_s`` [s of the run], and what it made of it.

    Parameters
    ----------
    command, action
        The command and what it asked for; None where a hold was over: of a stop, or (mode S) of a start or turn.
    mode, cause
        The insect's mode after it, and who decided on it.
    responded
        Whether it turned or ran because of the train; None where no train was delivered. A response that a later command
        overtook did not happen.
    latency_s
        How long after ``t_s`` the response came [s].
    turn_deg, run
        How far it turned [degrees, positive to the left] and was made to run [length].
    """

    t_s: float
    id: int
    command: int | None
    action: str | None
    mode: str
    cause: str
    responded: bool | None = None
    latency_s: float = 0.0
    turn_deg: float = 0.0
    run: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reaction:
    due_ns: int
    node: NodeId
    response: Response
    record: int | None
    """Index of its entry in ``executed``."""


class Steering:
    """See the module. A stop always works; a start lets the insect go, and may make it run; a turn may turn it.

    Parameters
    ----------
    world
        In which the insects live; the caller has advanced it to the instant of each call.
    metres_per_unit
        Length of the world's unit [m].
    speed_factor
        How much faster than life the insects live.
    keeps_history
        False: ``executed`` stays empty, for runs without end of which nobody asks.
    """

    def __init__(
        self, world: Habitat, *, seed: int, response: ResponseConfig, metres_per_unit: float, speed_factor: float, keeps_history: bool
    ) -> None:
        self.executed: list[ExecutedActuation] = []
        self._world = world
        self._responder = Responder(seed=seed, config=response)
        self._metres_per_unit = metres_per_unit
        self._speed_factor = speed_factor
        self._keeps_history = keeps_history
        self._held: set[NodeId] = set()
        self._reactions: dict[NodeId, _Reaction] = {}
        self._dues: list[tuple[int, NodeId]] = []

    def actuate(self, node: NodeId, actuation: Actuation, *, now_ns: int) -> None:
        """Do to an insect what its backpack decided on; what it responds with comes later, by ``react``."""
        cause = _CAUSE[actuation.cause]
        self._forget_reaction(node)
        if actuation.mode is WireMode.S:
            self._held.add(node)
            self._world.stop(node, cause=cause)
        elif actuation.mode is WireMode.CRW:
            self._held.discard(node)
            let_go = self._world.follow_walls if actuation.action is Action.FOLLOW_WALLS else self._world.start
            let_go(node, cause=cause)
        train = actuation.train
        response = None
        if train is not None:
            felt_s = now_ns / NS_PER_S * self._speed_factor
            response = self._responder.respond(node, Train(action=train.action, amplitude_v=train.amplitude_mv / 1000.0, t_s=felt_s))
            if node in self._held and train.action is not Action.STOP:
                response = Response(has_responded=False, latency_s=0.0)
        record = self._note(node, actuation, response)
        if response is not None and (response.turn_rad or response.run_m):
            due_ns = now_ns + round(response.latency_s / self._speed_factor * NS_PER_S)
            self._reactions[node] = _Reaction(due_ns=due_ns, node=node, response=response, record=record)
            heapq.heappush(self._dues, (due_ns, node))

    def next_due_ns(self) -> int | None:
        """Return when ``react`` has something to do, or None."""
        while self._dues and not self._is_current(*self._dues[0]):
            heapq.heappop(self._dues)
        return self._dues[0][0] if self._dues else None

    def react(self, now_ns: int) -> None:
        """Let insects respond whose time has come."""
        while (due_ns := self.next_due_ns()) is not None and due_ns <= now_ns:
            _, node = heapq.heappop(self._dues)
            response = self._reactions[node].response
            moved = False
            if response.turn_rad:
                moved = self._world.turn(node, response.turn_rad)
            if response.run_m:
                moved = self._world.run_straight(node, response.run_m / self._metres_per_unit) or moved
            if moved:
                del self._reactions[node]
            else:  # dead, stuck or held meanwhile
                self._forget_reaction(node)

    def silence(self, node: NodeId) -> None:
        """Forget a biobot whose backpack is off; a response that its last train brought about comes no more."""
        self._forget_reaction(node)

    def end(self) -> None:
        """Let no response come any more: the insects stand still for good."""
        for node in list(self._reactions):
            self._forget_reaction(node)

    def _is_current(self, due_ns: int, node: NodeId) -> bool:
        reaction = self._reactions.get(node)
        return reaction is not None and reaction.due_ns == due_ns

    def _forget_reaction(self, node: NodeId) -> None:
        reaction = self._reactions.pop(node, None)
        if reaction is not None and reaction.record is not None:
            overtaken = dataclasses.replace(self.executed[reaction.record], responded=False, turn_deg=0.0, run=0.0)
            self.executed[reaction.record] = overtaken

    def _note(self, node: NodeId, actuation: Actuation, response: Response | None) -> int | None:
        if not self._keeps_history:
            return None
        noted = ExecutedActuation(
            t_s=self._world.now_s,
            id=node,
            command=actuation.command,
            action=None if actuation.action is None else actuation.action.name.lower(),
            mode=self._world.mode(node).value,
            cause=_CAUSE[actuation.cause].value,
        )
        if response is not None:
            noted = dataclasses.replace(
                noted,
                responded=response.has_responded,
                latency_s=round(response.latency_s / self._speed_factor, 6),
                turn_deg=round(math.degrees(response.turn_rad), 3),
                run=round(response.run_m / self._metres_per_unit, 6),
            )
        self.executed.append(noted)
        return len(self.executed) - 1
