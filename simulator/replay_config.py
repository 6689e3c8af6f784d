"""Configuration of ``biobot-sim replay``."""

import math
from typing import Annotated

import msgspec

from simulator.lines.faults import FaultConfig
from simulator.serve_config import Duration, Period, check_links, split_links


class ReplayConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim replay``; what is not said here is as in ``serve``.

    Keys
    ----
    source
        A directory as ``run`` and ``serve`` write it, or a CSV file of encounters with the columns t_start_s, t_end_s, id1, id2.
    speed_factor
        So many recorded seconds go by in one.
    renumber
        Give the biobots the numbers 1, 2, ... in the order of their recorded ids; needed where these are larger than a node number.
    seed
        For the draws of radios and backpacks; the insects do what they did.
    link, coordinator_places, coverage_radius, handover_db, drain_s, loss, report_period_s, status_period_s, neighbours_period_s,
    provisional_s, drift_ppm, battery_life_s, boot, out, force, ready_file, position_samples
        As in ``biobot-sim serve``.
    faults
        A table of its own.
    """

    source: str | None = None
    link: str | tuple[str, ...] | None = None
    coordinator_places: tuple[tuple[float, float], ...] | None = None
    coverage_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    handover_db: Annotated[float, msgspec.Meta(ge=0, le=100)] = 6.0
    speed_factor: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0
    renumber: bool = False
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    drain_s: Annotated[float, msgspec.Meta(ge=0, le=86_400)] = 3.0
    loss: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    report_period_s: Period = 1.0
    status_period_s: Period = 10.0
    neighbours_period_s: Period = 5.0
    provisional_s: Period = 30.0
    drift_ppm: Annotated[float, msgspec.Meta(ge=0, le=1_000)] = 20.0
    battery_life_s: Duration = 7_200.0
    boot: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)] | None = None
    out: str | None = None
    force: bool = False
    ready_file: str | None = None
    faults: FaultConfig = msgspec.field(default_factory=FaultConfig)
    position_samples: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 201

    @property
    def links(self) -> tuple[str, ...]:
        """The lines, one for each coordinator; empty where none is given."""
        return split_links(self.link)

    def __post_init__(self) -> None:
        check_links(self.links, coordinator_places=self.coordinator_places)
        if not math.isfinite(self.loss) or not math.isfinite(self.speed_factor):
            msg = f"loss is {self.loss!r}, speed_factor is {self.speed_factor!r}; wanted finite numbers"
            raise ValueError(msg)
        if self.seed >= 2**64:
            msg = f"seed is {self.seed}; wanted 0 to 2^64 - 1"
            raise ValueError(msg)
