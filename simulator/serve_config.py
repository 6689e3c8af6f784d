"""Configuration of ``biobot-sim serve``."""

import math
import re
from typing import Annotated

import msgspec

from simulator.config import WorldConfig
from simulator.lines.faults import FaultConfig
from simulator.lines.line import parse_line
from simulator.response import ResponseConfig

Period = Annotated[float, msgspec.Meta(ge=0.01, le=3_600)]
Duration = Annotated[float, msgspec.Meta(gt=0, le=1e9)]

_BETWEEN_LINKS = re.compile(r",\s*(?=(?:pty|tcp|serial):)")


class ServeConfig(WorldConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of ``biobot-sim serve``, on top of the world's; ``landmarks`` and ``dispersion_s`` are the gateway's business.

    Keys
    ----
    link
        The line that a gateway opens: ``pty:PATH``, ``tcp:HOST:PORT`` or ``serial:DEVICE``, with ``?baud=N`` if wanted; or a list of
        them, each with a coordinator of its own behind it. It must be given before anything is served.
    coordinator_places
        Where each coordinator is, as ``[[x, y], ...]`` in the arena's unit of length. Without it, in the middles of as many equal
        strips of the arena's bounding box, cut across its longer side: a single one in the middle.
    coverage_radius
        How far a backpack and a coordinator hear each other; without it, everywhere.
    handover_db
        A backpack that is still covered goes over to a coordinator that is stronger by this [dB].
    duration_s
        End by itself after this [s]; without it, on SIGTERM or SIGINT.
    speed_factor
        Multiplies the insects' speed and hazards; clocks, radio and protocol keep real time.
    response
        How insects respond to stimulation.
    metres_per_unit
        The length of the preset's unit, for the length of a stimulated run. Without it, that of its name; a unit without a name of
        its own counts as 0.04 m, which makes the 1 unit/s of ``paper-units`` the 4 cm/s of a stimulated hissing cockroach.
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
    battery_life_s
        The voltage that backpacks tell falls from full to empty over this [s]; that a backpack fails then is the world's business.
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
        Written with the lines' addresses, one a line, when they are up; removed at the end.
    position_samples
        At how many instants, evenly from start to end, all positions are written.
    imu
        Backpacks have an inertial unit and report, with each encounter, how far they were carried since the one before: the true path
        times a factor from 0.9 to 1.1 of each backpack's own.
    wall_following
        Backpacks can have their insects keep to walls, and say so.
    watch
        Show the insects in the terminal while they walk.
    faults
        What goes wrong on the lines and in the coordinators.
    """

    link: str | tuple[str, ...] | None = None
    coordinator_places: tuple[tuple[float, float], ...] | None = None
    coverage_radius: Annotated[float, msgspec.Meta(gt=0)] | None = None
    handover_db: Annotated[float, msgspec.Meta(ge=0, le=100)] = 6.0
    speed_factor: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0
    response: ResponseConfig = msgspec.field(default_factory=ResponseConfig)
    metres_per_unit: Annotated[float, msgspec.Meta(gt=0, le=1e6)] | None = None
    drain_s: Annotated[float, msgspec.Meta(ge=0, le=86_400)] = 3.0
    loss: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    report_period_s: Period = 1.0
    status_period_s: Period = 10.0
    neighbours_period_s: Period = 5.0
    provisional_s: Period = 30.0
    drift_ppm: Annotated[float, msgspec.Meta(ge=0, le=1_000)] = 20.0
    battery_life_s: Duration = 7_200.0
    wander_ppm: Annotated[float, msgspec.Meta(ge=0, le=1_000)] = 0.0
    boot: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)] | None = None
    out: str | None = None
    force: bool = False
    ready_file: str | None = None
    imu: bool = False
    wall_following: bool = False
    watch: bool = False
    faults: FaultConfig = msgspec.field(default_factory=FaultConfig)
    position_samples: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 201

    @property
    def links(self) -> tuple[str, ...]:
        """The lines, one for each coordinator; empty where none is given."""
        return split_links(self.link)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_links(self.links, coordinator_places=self.coordinator_places)
        if not math.isfinite(self.loss):
            msg = f"loss is {self.loss!r}; wanted a probability from 0 up to, not including, 1"
            raise ValueError(msg)
        if self.coverage_radius is not None and not math.isfinite(self.coverage_radius):
            msg = f"coverage_radius is {self.coverage_radius!r}; wanted a finite number"
            raise ValueError(msg)


def split_links(link: str | tuple[str, ...] | None) -> tuple[str, ...]:
    """Return each line of ``link``; in a string, as in an environment variable, commas may stand between several."""
    if link is None:
        return ()
    return tuple(_BETWEEN_LINKS.split(link)) if isinstance(link, str) else link


def check_links(links: tuple[str, ...], *, coordinator_places: tuple[tuple[float, float], ...] | None) -> None:
    """Raise ParameterError or ValueError for a line that is none, one given twice, or places that do not fit the lines."""
    for link in links:
        parse_line(link)
    twice = sorted({link for link in links if links.count(link) > 1 and not link.endswith(":0")})
    if twice:
        msg = f"link {twice[0]} is given twice; each coordinator needs a line of its own"
        raise ValueError(msg)
    if coordinator_places is None:
        return
    if links and len(coordinator_places) != len(links):
        msg = f"coordinator_places has {len(coordinator_places)} places, link has {len(links)} lines; wanted one [x, y] for each line"
        raise ValueError(msg)
    if not all(math.isfinite(value) for place in coordinator_places for value in place):
        msg = f"coordinator_places is {coordinator_places!r}; wanted finite numbers"
        raise ValueError(msg)
