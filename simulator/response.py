"""What an insect makes of a pulse train: whether it responds, how far it turns or runs, how soon, and how it gets used to it. Pure.

A response is a matter of chance. What is published is named at each number; what is not is marked as own.

The insect's own time is what counts here: in a run whose insects live faster, recovery and latency are as much shorter.

References
----------
[Eri15] J. Erickson, M. Herrera, M. Bustamante, A. Shingiro, T. Bowen, "Effective stimulus parameters for directed locomotion in
    Madagascar hissing cockroach biobot", PLoS ONE 10, e0134348, 2015.
[Cha24] Charge-balanced stimulation of cockroaches, PMC11223913: turns succeed in more than 76.25 % of trials.
[Cod] CodeRoach, limits for living animals: at least 2 s between trains.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import msgspec

from firmware_protocol.messages import Action
from simulator import chance

_RESPONDS_STREAM = 260
_SPREAD_STREAM = 261
_SPREAD_ANGLE_STREAM = 262
_RUN_STREAM = 263
_LATENCY_STREAM = 264
_HABITUATES_STREAM = 265

# [Eri15]: turns of 149 degrees at 1 V fall to 80 degrees at 4 V. Linear in between: own.
_WEAKEST_V, _STRONGEST_V = 1.0, 4.0
_TURN_WEAKEST_DEG, _TURN_STRONGEST_DEG = 149.0, 80.0
# [Eri15]: a stimulated run is 15.6 to 25.6 cm long. Uniform in between: own.
_RUN_SHORTEST_M, _RUN_LONGEST_M = 0.156, 0.256
_LATENCY_SHORTEST_S, _LATENCY_LONGEST_S = 0.05, 0.20  # own
_CLOSE_S = 2.0  # [Cod]: trains closer than this are too close
_CLOSE_SHARE = 0.5  # own: of probability, angle and length
_HABITUATED_SHARE = 0.5  # own: of angle and length, in a fully habituated insect
_SPREAD_LIMIT = 2.5  # own: a turn is never further from its mean than this many standard deviations

_Probability = Annotated[float, msgspec.Meta(ge=0, le=1)]


class ResponseConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How insects respond to stimulation.

    Keys
    ----
    probability
        That a fresh insect responds to a train of at least 1 V; 0.76 is what charge-balanced pulses reach [Cha24]. Below 1 V it falls
        evenly to none at 0 V (own).
    probability_habituated
        The same of an insect that is fully used to it (own).
    share_habituating
        Share of the insects that get used to it at all; about half did not with 2 V, 50 Hz and 0.5 s [Eri15].
    habituation_per_train
        Each train takes this share of what is left of an insect's freshness (own).
    recovery_s
        Without trains, habituation falls to 1/e in this time [s] (own).
    turn_spread
        Standard deviation of a turn, as a share of its mean (own).
    """

    probability: _Probability = 0.76
    probability_habituated: _Probability = 0.5
    share_habituating: _Probability = 0.5
    habituation_per_train: _Probability = 0.05
    recovery_s: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 600.0
    turn_spread: Annotated[float, msgspec.Meta(ge=0, le=0.4)] = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Train:
    """A pulse train that reached an insect at ``t_s`` [s of its own time]."""

    action: Action
    amplitude_v: float
    t_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """What the insect does ``latency_s`` [s] after the train; it turned by 0 and ran 0 m where it did not respond.

    Parameters
    ----------
    turn_rad
        Positive is to the left.
    run_m
        A straight run [m].
    """

    has_responded: bool
    latency_s: float
    turn_rad: float = 0.0
    run_m: float = 0.0


@dataclass(slots=True, kw_only=True)
class _Insect:
    habituates: bool
    habituation: float = 0.0
    last_train_s: float = -math.inf
    n_trains: int = 0


class Responder:
    """All insects' responses, with what each still feels of earlier trains; draws are keyed by (seed, biobot, number of its train)."""

    def __init__(self, *, seed: int, config: ResponseConfig) -> None:
        self._seed = seed
        self._config = config
        self._insects: dict[int, _Insect] = {}

    def habituation(self, biobot: int, *, t_s: float) -> float:
        """Return how used to trains an insect is at ``t_s`` [s]: 0 fresh, 1 fully."""
        insect = self._insects.get(biobot)
        if insect is None or insect.n_trains == 0:
            return 0.0
        return insect.habituation * math.exp(-(t_s - insect.last_train_s) / self._config.recovery_s)

    def respond(self, biobot: int, train: Train) -> Response:
        """Draw what an insect makes of a train; trains of one insect come in order of time."""
        insect = self._insects.setdefault(biobot, self._meet(biobot))
        index = insect.n_trains
        habituation = self.habituation(biobot, t_s=train.t_s)
        is_close = train.t_s - insect.last_train_s < _CLOSE_S
        if insect.habituates:
            insect.habituation = habituation + self._config.habituation_per_train * (1.0 - habituation)
        insect.last_train_s, insect.n_trains = train.t_s, index + 1

        strength = (_CLOSE_SHARE if is_close else 1.0) * min(1.0, train.amplitude_v / _WEAKEST_V)
        fresh, tired = self._config.probability, self._config.probability_habituated
        probability = strength * (fresh + (tired - fresh) * habituation)
        latency_s = _between(_LATENCY_SHORTEST_S, _LATENCY_LONGEST_S, self._draw(biobot, _LATENCY_STREAM, index))
        if train.action is Action.STOP:
            return Response(has_responded=True, latency_s=0.0)  # it always works: the backpack holds the insect still
        if self._draw(biobot, _RESPONDS_STREAM, index) >= probability:
            return Response(has_responded=False, latency_s=latency_s)
        vigour = strength * (1.0 - (1.0 - _HABITUATED_SHARE) * habituation)
        if train.action in {Action.START, Action.FOLLOW_WALLS}:
            run_m = vigour * _between(_RUN_SHORTEST_M, _RUN_LONGEST_M, self._draw(biobot, _RUN_STREAM, index))
            return Response(has_responded=True, latency_s=latency_s, run_m=run_m)
        side = 1.0 if train.action is Action.TURN_LEFT else -1.0
        turn_rad = side * vigour * mean_turn_rad(train.amplitude_v) * self._draw_spread(biobot, index)
        return Response(has_responded=True, latency_s=latency_s, turn_rad=turn_rad)

    def _meet(self, biobot: int) -> _Insect:
        return _Insect(habituates=self._draw(biobot, _HABITUATES_STREAM, 0) < self._config.share_habituating)

    def _draw(self, biobot: int, stream: int, index: int) -> float:
        return chance.uniform(seed=self._seed, biobot=biobot, stream=stream, index=index)

    def _draw_spread(self, biobot: int, index: int) -> float:
        """Draw a factor of mean 1 from a normal distribution with cut tails, by the Box-Muller transform."""
        radius = math.sqrt(-2.0 * math.log(self._draw(biobot, _SPREAD_STREAM, index)))
        normal = radius * math.cos(2.0 * math.pi * self._draw(biobot, _SPREAD_ANGLE_STREAM, index))
        return 1.0 + self._config.turn_spread * max(-_SPREAD_LIMIT, min(_SPREAD_LIMIT, normal))


def mean_turn_rad(amplitude_v: float) -> float:
    """Return how far a fresh insect turns on average at an amplitude [V], without sign; beyond 1 V and 4 V as at these."""
    share = (min(max(amplitude_v, _WEAKEST_V), _STRONGEST_V) - _WEAKEST_V) / (_STRONGEST_V - _WEAKEST_V)
    return math.radians(_between(_TURN_WEAKEST_DEG, _TURN_STRONGEST_DEG, share))


def _between(low: float, high: float, share: float) -> float:
    return low + share * (high - low)
