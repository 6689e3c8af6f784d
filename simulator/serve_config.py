"""Configuration of ``biobot-sim serve``."""

import math
from typing import Annotated

import msgspec

from simulator.config import WorldConfig
from simulator.line import parse_line

_Period = Annotated[float, msgspec.Meta(ge=0.01, le=3_600)]


class ServeConfig(WorldConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim serve``, on top of the world's; ``landmarks`` and ``dispersion_s`` are the gateway's business.

    Attributes
    ----------
    link
        The line that a gateway opens: ``pty:PATH``, ``tcp:HOST:PORT`` or ``serial:DEVICE``, with ``?baud=N`` if wanted. It must be given
        before anything is served.
    duration_s
        End by itself after this [s]; without it, on SIGTERM or SIGINT.
    speed_factor
        Multiplies the insects' speed and hazards; clocks, radio and protocol keep real time.
    drain_s
        After the insects have stopped, wait at most this long until the gateway has everything [s].
    loss
        Probability that a radio payload is lost, 0 up to, not including, 1.
    report_period_s, status_period_s, neighbours_period_s
        How long an encounter waits for company, and how often each backpack tells its state and its neighbours [s].
    provisional_s
        An encounter longer than this is reported while it goes on [s].
    drift_ppm
        Backpack clocks run wrong by up to this [parts per million].
    wander_ppm
        Their rates wander by up to this in the course of time, as with temperature [parts per million].
    boot
        The count of starts that the backpacks tell. Without it, it is taken from the wall clock, so that a gateway that has
        heard an earlier run does not take this one for a repetition.
    out
        Directory for truth, reports and ``run.json``; without it, nothing is written.
    force
        Write into a directory that is not empty, replacing files of an earlier run.
    ready_file
        Written with the line's address when it is up, removed at the end.
    position_samples
        At how many instants, evenly from start to end, all positions are written.
    """

    link: str | None = None
    speed_factor: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0
    drain_s: Annotated[float, msgspec.Meta(ge=0, le=86_400)] = 3.0
    loss: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    report_period_s: _Period = 1.0
    status_period_s: _Period = 10.0
    neighbours_period_s: _Period = 5.0
    provisional_s: _Period = 30.0
    drift_ppm: Annotated[float, msgspec.Meta(ge=0, le=1_000)] = 20.0
    wander_ppm: Annotated[float, msgspec.Meta(ge=0, le=1_000)] = 0.0
    boot: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)] | None = None
    out: str | None = None
    force: bool = False
    ready_file: str | None = None
    position_samples: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 201

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.link is not None:
            parse_line(self.link)
        if not math.isfinite(self.loss):
            msg = f"loss is {self.loss!r}; wanted a probability from 0 up to, not including, 1"
            raise ValueError(msg)
