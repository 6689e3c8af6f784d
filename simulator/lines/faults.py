"""Which faults a line and its dongle are to have, how often, and when: a configuration, and draws that depend on nothing but it.

Damage to bytes is drawn for each byte that passes in a direction, spells (a stall, a pulled cable, a reset, a full buffer) for each
second of the run. Each draw is keyed by (seed, line, kind and direction, count): same seed and same bytes, same damage; same seed, the
same spells whatever happens on the line.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal, get_type_hints

import msgspec

from firmware_protocol.units import NS_PER_S
from simulator import chance

PerByte = Annotated[float, msgspec.Meta(ge=0, le=0.5)]
PerSecond = Annotated[float, msgspec.Meta(ge=0, le=10)]
Lasting = Annotated[float, msgspec.Meta(ge=0.01, le=3_600)]


class Direction(Enum):
    """Which way bytes go on a line."""

    UP = "up"
    """From the dongle to the gateway."""
    DOWN = "down"


class ByteFault(Enum):
    """What can happen to a byte."""

    BIT_FLIP = "bit_flip"
    DROP = "drop"
    INSERT = "insert"
    """A byte of any value comes before it."""
    TRUNCATE = "truncate"
    """It and up to 31 more are lost: a frame is cut short."""


class SpellKind(Enum):
    """What can befall a line or its dongle for a while."""

    STALL = "stall"
    UNPLUG = "unplug"
    RESET = "reset"
    FULL = "full"


class FaultConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Faults that are put into lines and dongles on purpose; without any, there are none.

    Keys
    ----
    bit_flip, drop, insert, truncate
        Probability, for each byte that passes, that one of its bits is turned, that it is lost, that another one comes before it, and
        that a run of 2 to 32 bytes is lost from it on, which cuts a frame short.
    stall, stall_s
        How often the line stops [per second], and for how long nothing moves then, either way [s].
    unplug, unplug_s
        How often the cable is pulled [per second], and for how long it stays so [s]: a pty goes and comes back under the same path, a
        TCP port drops its connection and refuses others, a serial port is closed.
    reset, reset_s
        How often the dongle's firmware starts anew, without what it held in memory [per second], and how long it is dead then [s].
    full, full_s
        How often the dongle's buffers are full [per second], and for how long [s]: it takes nothing from the air, and answers each
        request that it has no room.
    wrong_status
        Probability, for each payload sent, that the dongle tells another outcome than the true one.
    direction
        Which way bytes are damaged: ``up`` is from the dongle to the gateway.
    lines
        Which lines have faults, counted from 1 in the order of ``link``; empty: all.
    """

    bit_flip: PerByte = 0.0
    drop: PerByte = 0.0
    insert: PerByte = 0.0
    truncate: PerByte = 0.0
    stall: PerSecond = 0.0
    stall_s: Lasting = 1.0
    unplug: PerSecond = 0.0
    unplug_s: Lasting = 1.0
    reset: PerSecond = 0.0
    reset_s: Lasting = 0.2
    full: PerSecond = 0.0
    full_s: Lasting = 1.0
    wrong_status: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0
    direction: Literal["both", "up", "down"] = "both"
    lines: tuple[Annotated[int, msgspec.Meta(ge=1)], ...] = ()

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for name in self.__struct_fields__ if isinstance(value := getattr(self, name), float)):
            msg = "not a number, or infinite; wanted finite rates and times"
            raise ValueError(msg)

    def of_line(self, index: int) -> "FaultConfig | None":
        """Return the faults of a line, counted from 0; None where it has none."""
        rates = (self.bit_flip, self.drop, self.insert, self.truncate, self.stall, self.unplug, self.reset, self.full, self.wrong_status)
        return self if any(rates) and (not self.lines or index + 1 in self.lines) else None


# Streams of draws; those of one direction lie 20 above those of the other.
_BYTE_STREAM = {ByteFault.BIT_FLIP: 400, ByteFault.DROP: 401, ByteFault.INSERT: 402, ByteFault.TRUNCATE: 403}
_VALUE_STREAM = {ByteFault.BIT_FLIP: 410, ByteFault.DROP: 411, ByteFault.INSERT: 412, ByteFault.TRUNCATE: 413}
_DIRECTION_STEP = {Direction.UP: 0, Direction.DOWN: 20}
_SPELL_STREAM = {SpellKind.STALL: 440, SpellKind.UNPLUG: 441, SpellKind.RESET: 442, SpellKind.FULL: 443}
_NEVER = 2.0**62
_STATUS_STREAM, _OTHER_STATUS_STREAM = 450, 451


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """What befalls one byte; ``value`` (64 random bits) says which bit, which byte or how many."""

    at: int
    """The byte's count in its direction, from 0."""
    kind: ByteFault
    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Spell:
    """A stretch of the run in which something is wrong [ns since its beginning]."""

    kind: SpellKind
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultDraws:
    """All draws of one line, counted from 0."""

    config: FaultConfig
    seed: int
    line: int

    def damages(self, kind: ByteFault, direction: Direction) -> Iterator[Damage]:
        """Yield what one kind does to the bytes of a direction, in order and without end; nothing where it does nothing."""
        rate = getattr(self.config, kind.value)
        if not rate or self.config.direction not in {"both", direction.value}:
            return
        at, count = -1, 0
        step = _DIRECTION_STEP[direction]
        while True:
            draw = chance.uniform(seed=self.seed, biobot=self.line, stream=_BYTE_STREAM[kind] + step, index=count)
            at += 1 + math.floor(min(math.log(draw) / math.log1p(-rate), _NEVER))  # the geometric distribution, by its inverse
            value = chance.word(seed=self.seed, biobot=self.line, stream=_VALUE_STREAM[kind] + step, index=count)
            yield Damage(at=at, kind=kind, value=value)
            count += 1

    def spells(self, kind: SpellKind) -> Iterator[Spell]:
        """Yield the spells of one kind, in order and without end; nothing where there are none. Between two, time is exponential."""
        per_second: float = getattr(self.config, kind.value)
        if not per_second:
            return
        lasting_ns = round(getattr(self.config, f"{kind.value}_s") * NS_PER_S)
        end_ns = count = 0
        while True:
            wait_s = chance.exponential(seed=self.seed, biobot=self.line, stream=_SPELL_STREAM[kind], index=count) / per_second
            begin_ns = end_ns + round(min(wait_s * NS_PER_S, _NEVER))
            end_ns = begin_ns + lasting_ns
            yield Spell(kind=kind, begin_ns=begin_ns, end_ns=end_ns)
            count += 1

    def other_status(self, count: int, *, n_others: int) -> int | None:
        """Return which of the ``n_others`` untrue outcomes the ``count``-th payload sent gets; None: the truth."""
        if chance.uniform(seed=self.seed, biobot=self.line, stream=_STATUS_STREAM, index=count) >= self.config.wrong_status:
            return None
        return chance.word(seed=self.seed, biobot=self.line, stream=_OTHER_STATUS_STREAM, index=count) % n_others


class FaultFlag(argparse.Action):
    """``--fault KEY=VALUE[,KEY=VALUE...]``: the keys of the table ``faults``, with hyphens for underscores if wanted."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option_string: str | None = None
    ) -> None:
        """Put each value where the configuration looks for it."""
        hints = get_type_hints(FaultConfig, include_extras=True)
        for item in str(values).split(","):
            key, equals, text = item.partition("=")
            name = key.strip().replace("-", "_")
            if not equals or name not in hints:
                example = "--fault bit-flip=1e-4 --fault unplug=0.1,unplug-s=2"
                parser.error(f"{option_string} {item!r}; wanted one of {', '.join(hints)}, = and a value, as in {example}")
            value = _READERS.get(name, _number)(text.strip())
            try:
                msgspec.convert(value, hints[name])
            except msgspec.ValidationError as error:
                parser.error(f"{option_string} {item!r}: {error}; docs/wire.md tells the limits")
            setattr(namespace, f"faults.{name}", value)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text  # refused where the configuration is checked, by the key's name


def _lines(text: str) -> Sequence[int | str]:
    return [int(one) if one.isascii() and one.isdigit() else one for one in text.split("+")]


_READERS: dict[str, Callable[[str], object]] = {"direction": str, "lines": _lines}

FAULT_KEYS = ", ".join(name.replace("_", "-") for name in FaultConfig.__struct_fields__)
"""What ``--fault`` knows, for help."""
