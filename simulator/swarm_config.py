"""How a swarm's backpacks are made, and the clocks and coordinators that they are made with."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from firmware_protocol.units import BootId, NodeId
from simulator import chance
from simulator.backpacks.backpack import MAX_NODE
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.clock import BackpackClock, DriftingClock
from simulator.dongles.choice import DEFAULT_DIALECT, make_dongle
from simulator.dongles.interface import Dongle
from simulator.errors import ParameterError
from simulator.lines.faults import FaultConfig
from simulator.lines.faulty_dongle import with_faults
from simulator.radios.coverage import CoverageConfig
from simulator.radios.radio import RadioConfig
from simulator.radios.sensing import SensingConfig
from simulator.response import ResponseConfig
from simulator.wandering_clock import WanderingClock

_CLOCK_STREAM = 220
_DRIFT_STREAM = 221


@dataclass(frozen=True, slots=True, kw_only=True)
class SwarmConfig:
    """How the backpacks are made.

    Parameters
    ----------
    seed, boot
        For all draws; the count of starts that every backpack has reached.
    drift_ppm
        Clocks run too fast or too slow by up to this, drawn uniformly for each; crystals differ by about 10 ppm [Mar04].
    wander_ppm
        Their rates wander from that by up to this, in steps of a minute.
    switched_on_s
        Each backpack was switched on up to this long before the run, drawn uniformly [s].
    coverage
        The coordinators; None: one in the middle that is heard everywhere.
    response, metres_per_unit, speed_factor
        How insects respond to trains; the world's unit of length [m] and how much faster than life its insects live, for that.
    keeps_history
        False: what was done to insects and reported of them is counted only, for runs without end of which nobody asks.
    sensing
        How encounters are formed from beacons; None: they are exact.
    has_imu
        Backpacks measure how far they are carried, and report it with each encounter.
    dialects
        What each coordinator speaks; empty: all the native dialect.
    faults
        What goes wrong in the coordinators.

    References
    ----------
    [Mar04] M. Maroti, B. Kusy, G. Simon, A. Ledeczi, "The flooding time synchronization protocol", SenSys 2004.
    """

    seed: int
    boot: BootId
    drift_ppm: float = 20.0
    wander_ppm: float = 0.0
    switched_on_s: float = 60.0
    backpack: BackpackConfig = field(default_factory=BackpackConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    coverage: CoverageConfig | None = None
    response: ResponseConfig = field(default_factory=ResponseConfig)
    metres_per_unit: float = 1.0
    speed_factor: float = 1.0
    keeps_history: bool = True
    sensing: SensingConfig | None = None
    has_imu: bool = False
    dialects: tuple[str, ...] = ()
    faults: FaultConfig = field(default_factory=FaultConfig)


def check_node_numbers(ids: Sequence[int]) -> None:
    """Refuse ids, given in ascending order, that are no node numbers."""
    if ids[-1] > MAX_NODE:
        raise ParameterError(name="biobots", got=ids[-1], wanted=f"ids up to {MAX_NODE}: a node number has 16 bits")


def draw_clock(node: NodeId, config: SwarmConfig) -> BackpackClock:
    """Draw a backpack's clock: when it was switched on, and how wrong it runs."""
    since_boot = chance.uniform(seed=config.seed, biobot=node, stream=_CLOCK_STREAM, index=0)
    drift = 2 * chance.uniform(seed=config.seed, biobot=node, stream=_DRIFT_STREAM, index=0) - 1
    start_ms, drift_ppb = int(since_boot * config.switched_on_s * 1000), round(drift * config.drift_ppm * 1000)
    if not config.wander_ppm:
        return DriftingClock(start_ms=start_ms, drift_ppb=drift_ppb)
    wander_ppb = round(config.wander_ppm * 1000)
    return WanderingClock(start_ms=start_ms, drift_ppb=drift_ppb, wander_ppb=wander_ppb, seed=config.seed, node=node)


def make_coordinators(count: int, config: SwarmConfig) -> tuple[Dongle, ...]:
    """Make the dongles of a swarm, each of its dialect and with the faults that are asked for."""
    dialects = config.dialects or (DEFAULT_DIALECT,) * count
    return tuple(
        with_faults(make_dongle(dialect, index=index), config.faults, seed=config.seed, line=index)
        for index, dialect in enumerate(dialects)
    )
