"""Which faults befall what, when and for how long: drawn from the seed. No I/O, no clock."""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """What can go wrong; the value is what the table calls it."""

    UNPLUG = "cable pulled and put back"
    POWER_CUT = "dongle gone with all that it held, backpacks live on"
    RESET = "dongle starts anew by itself"
    STALL = "line stalls"
    CORRUPT = "burst of corrupted bytes, both ways"
    NOISE = "noise of 1 to 64 KiB on the line"
    WANDER = "a tenth of a dongle's biobots join another"
    REBOOT = "backpack starts anew, its clock at 0"
    KILL_GATEWAY = "gateway SIGKILL"
    TERM_GATEWAY = "gateway SIGTERM and new start"
    FREEZE_GATEWAY = "gateway SIGSTOP"
    FULL_JOURNAL = "disk of a journal full"
    JUMP_GATEWAY = "wall clock of a gateway jumps"
    CUT_GATEWAY = "network of a gateway cut"
    KILL_MAPPER = "mapper SIGKILL"
    FREEZE_MAPPER = "mapper SIGSTOP"
    FULL_STORE = "disk of the mapper's store full"
    JUMP_MAPPER = "wall clock of the mapper jumps"
    CUT_MAPPER = "network of the mapper cut"
    KILL_ROUTER = "router SIGKILL"
    FREEZE_ROUTER = "router SIGSTOP"


class Unit(Enum):
    """Of what there are several: one fault at a time befalls each."""

    LINE = "line"
    GATEWAY = "gateway"
    MAPPER = "mapper"
    ROUTER = "router"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Habit:
    unit: Unit
    weight: float
    lasts_s: tuple[float, float]


_HABITS = {
    Kind.UNPLUG: _Habit(unit=Unit.LINE, weight=9, lasts_s=(0.1, 4.0)),
    Kind.POWER_CUT: _Habit(unit=Unit.LINE, weight=9, lasts_s=(0.1, 4.0)),
    Kind.RESET: _Habit(unit=Unit.LINE, weight=8, lasts_s=(0.0, 0.0)),
    Kind.STALL: _Habit(unit=Unit.LINE, weight=8, lasts_s=(0.2, 6.0)),
    Kind.CORRUPT: _Habit(unit=Unit.LINE, weight=9, lasts_s=(0.2, 4.0)),
    Kind.NOISE: _Habit(unit=Unit.LINE, weight=5, lasts_s=(0.0, 0.0)),
    Kind.WANDER: _Habit(unit=Unit.LINE, weight=5, lasts_s=(0.0, 0.0)),
    Kind.REBOOT: _Habit(unit=Unit.LINE, weight=5, lasts_s=(0.0, 0.0)),
    Kind.KILL_GATEWAY: _Habit(unit=Unit.GATEWAY, weight=8, lasts_s=(0.0, 3.0)),
    Kind.TERM_GATEWAY: _Habit(unit=Unit.GATEWAY, weight=3, lasts_s=(0.0, 1.0)),
    Kind.FREEZE_GATEWAY: _Habit(unit=Unit.GATEWAY, weight=4, lasts_s=(0.5, 6.0)),
    Kind.FULL_JOURNAL: _Habit(unit=Unit.GATEWAY, weight=4, lasts_s=(1.0, 6.0)),
    Kind.JUMP_GATEWAY: _Habit(unit=Unit.GATEWAY, weight=3, lasts_s=(0.0, 0.0)),
    Kind.CUT_GATEWAY: _Habit(unit=Unit.GATEWAY, weight=4, lasts_s=(0.5, 8.0)),
    Kind.KILL_MAPPER: _Habit(unit=Unit.MAPPER, weight=4, lasts_s=(0.0, 3.0)),
    Kind.FREEZE_MAPPER: _Habit(unit=Unit.MAPPER, weight=3, lasts_s=(0.5, 8.0)),
    Kind.FULL_STORE: _Habit(unit=Unit.MAPPER, weight=3, lasts_s=(1.0, 6.0)),
    Kind.JUMP_MAPPER: _Habit(unit=Unit.MAPPER, weight=2, lasts_s=(0.0, 0.0)),
    Kind.CUT_MAPPER: _Habit(unit=Unit.MAPPER, weight=3, lasts_s=(0.5, 8.0)),
    Kind.KILL_ROUTER: _Habit(unit=Unit.ROUTER, weight=5, lasts_s=(0.0, 3.0)),
    Kind.FREEZE_ROUTER: _Habit(unit=Unit.ROUTER, weight=3, lasts_s=(0.5, 6.0)),
}

JUMPS_S = (-600.0, -3.0, 0.0, 2.0, 45.0, 3_600.0)
"""How far wall clocks may be off after a jump [s]."""

_FIRST_SHARE, _LAST_SHARE = 0.03, 0.97


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """``at_s`` into the run ``kind`` befalls the ``index``-th ``unit`` for ``lasts_s``; ``draw`` (0 to 1) decides the rest."""

    at_s: float
    kind: Kind
    unit: Unit
    index: int
    lasts_s: float
    draw: float


def draw_faults(
    seed: int, *, n_faults: int, span_s: float, kinds: Sequence[Kind], counts: dict[Unit, int], mapper_from_s: float, brevity: float = 1.0
) -> list[Fault]:
    """Draw a plan: every kind that is possible at least once where there are faults enough, at times spread evenly over the run.

    Parameters
    ----------
    span_s
        How long the run takes about; the first and the last 3 % are left alone.
    kinds, counts
        What is possible here, and how many of each unit there are.
    mapper_from_s
        Nothing befalls the mapper before.
    brevity
        All durations are multiplied by this.
    """
    rng = random.Random(seed)
    every = list(kinds)[:n_faults]
    drawn = every + rng.choices(list(kinds), weights=[_HABITS[kind].weight for kind in kinds], k=n_faults - len(every))
    faults = []
    for kind in drawn:
        habit = _HABITS[kind]
        first_s = max(_FIRST_SHARE * span_s, mapper_from_s if habit.unit is Unit.MAPPER else 0.0)
        faults.append(
            Fault(
                at_s=rng.uniform(first_s, max(first_s, _LAST_SHARE * span_s)),
                kind=kind,
                unit=habit.unit,
                index=rng.randrange(counts[habit.unit]),
                lasts_s=brevity * rng.uniform(*habit.lasts_s),
                draw=rng.random(),
            )
        )
    return sorted(faults, key=lambda one: (one.at_s, one.kind.value, one.index))
