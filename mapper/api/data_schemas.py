"""What the JSON of parts of a map looks like: Betti numbers, holes, barcode, coverage, distances, pins."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from mapper.api.schemas import AnswerModel, DataItem, HoleCountItem, HoleItem, Place, RoutePlace

MAX_PIN_NAME = 64
_MAX_M = 1e8
"""Beyond any projection of the Earth: squares of such lengths are still exact enough."""
Metres = Annotated[FiniteFloat, Field(ge=-_MAX_M, le=_MAX_M)]


def _check_name(name: str) -> str:
    if not name.isprintable() or name != name.strip():
        raise ValueError("has control characters, or blanks around it")
    return name


PinName = Annotated[str, Field(min_length=1, max_length=MAX_PIN_NAME), AfterValidator(_check_name)]


class MapPart(AnswerModel):
    """Of which map something is a part."""

    version: int
    computed_wall_ns: int
    n_encounters: int
    length_unit: Literal["s", "m"]


class PossibleHole(AnswerModel):
    """A loop that is not called a hole and may be one."""

    birth: float
    death: float
    component: int
    probability: float | None


class BettiView(MapPart):
    """How many components and holes the map shows, and how sure that is."""

    b0: int = Field(description="Components")
    b1: int = Field(description="Holes")
    n_components: int = Field(description="Groups of encounters that no biobot joins, those too small to be mapped too")
    hole_count: HoleCountItem | None = Field(description="null: the method of this map does not tell")
    possible_holes: list[PossibleHole]
    data: DataItem | None = Field(description="null: the method of this map does not tell")


class FramedHole(AnswerModel):
    """A hole in the operator's frame [m]."""

    number: int
    outline_xy: list[Place]
    centre: Place | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    perimeter_error: float | None


class NumberedHole(HoleItem):
    """A hole of the map, and its number."""

    number: int
    in_frame: FramedHole | None = Field(description="The same in the operator's frame; null: pins fix none, or not for its component")


class HoleList(MapPart):
    """The holes of the map, and the loops that may be some."""

    holes: list[NumberedHole]
    possible_holes: list[HoleItem]


class HoleView(NumberedHole):
    """One hole, and the map it is of."""

    version: int
    computed_wall_ns: int
    n_encounters: int
    length_unit: Literal["s", "m"]


class Bar(AnswerModel):
    """One interval; ``is_real``: it counts in the Betti number."""

    birth: float
    death: float | None = Field(description="null: never")
    component: int
    is_real: bool
    probability: float | None = Field(description="That it goes around an obstacle; null: not known, or under 5 %")
    hole: int | None = Field(description="Its number among the map's holes, from 1")
    possible_hole: int | None = Field(description="Its number among the map's possible holes, from 1")


class ThresholdItem(AnswerModel):
    """What separates intervals of a component and dimension that count from the others.

    By rule: those that are longer than ``least_length`` and whose death over birth is above ``least_ratio`` count; null asks for nothing.
    By probability: the rule only takes part; as many of the likeliest count as there are holes, none below ``least_probability``.
    """

    dimension: int
    component: int
    decided_by: Literal["rule", "probability"]
    counts_any: bool = Field(description="Finite intervals can count at all")
    least_length: float | None
    least_ratio: float | None
    least_probability: float | None
    sure_length: float | None = Field(description="Longer intervals are there in 95 of 100 maps, whatever is counted; null: not known")


class DiagramView(AnswerModel):
    """The persistence diagram by dimension and component, the longest intervals first."""

    version: int
    intervals: dict[str, list[Bar]] = Field(description="By dimension: 0, 1")
    thresholds: list[ThresholdItem]
    betti_numbers: list[int]
    diameter: float
    length_unit: Literal["s", "m"]
    n_encounters: int


class BarcodeView(AnswerModel):
    """The intervals of each dimension over all components: those that count first, then the longest."""

    version: int
    bars: dict[str, list[Bar]] = Field(description="By dimension: 0, 1")
    thresholds: list[ThresholdItem]
    betti_numbers: list[int]
    diameter: float
    length_unit: Literal["s", "m"]
    n_encounters: int


class MinuteSeries(AnswerModel):
    """Encounters begun in each minute, a day at most, to that of the newest encounter."""

    begin_s: int | None = Field(description="First minute [s since 1970]; null: no encounters")
    counts: list[int]


class BiobotCoverage(AnswerModel):
    """What a biobot brought."""

    id: int
    key: str = Field(description="The id as text, for programs that cannot hold 64-bit numbers")
    n_encounters: int
    per_minute: float = Field(description="Over the last five minutes before the newest encounter")
    last_encounter_wall_ns: int


class ExpectedData(DataItem):
    """Whether the encounters are enough, and when they will be."""

    expected_wait_s: float | None = Field(
        description="At the rate of the last minutes; 0: they are enough; null: waiting alone does not help, nothing arrives, or who knows"
    )
    nothing_arrives: str | None = Field(description="Why no wait is promised though time would help; null: nothing is in the way")


class CoverageView(AnswerModel):
    """How well the encounters cover the place; of a map, its version is told."""

    n_encounters: int
    per_minute: MinuteSeries
    rate_per_min: float = Field(description="Over the last five minutes before the newest encounter")
    biobots: list[BiobotCoverage]
    giant_share: float | None = Field(description="Share of encounters in the largest group of biobots that encounters join")
    giant_biobots: int
    n_components: int | None = Field(description="null: there is no map")
    landmarks: list[int] = Field(description="Biobots that stood still by command")
    unmet_landmarks: list[int] = Field(description="Those of them that nobody met")
    well_seen_share: float | None = Field(description="Of the map's points; null: not known")
    data: ExpectedData | None = Field(description="null: the method of this map does not tell")


class FramedDistance(AnswerModel):
    """A distance in the operator's frame."""

    unit: Literal["m"]
    distance: float
    distance_error: float
    straight: float


class DistanceView(AnswerModel):
    """How far it is from one place to another: along the shortest way around obstacles, where biobots walked, and as the crow flies."""

    model_config = ConfigDict(extra="allow", populate_by_name=True)

    begin: RoutePlace = Field(alias="from")
    end: RoutePlace = Field(alias="to")
    length_unit: Literal["s", "m"]
    distance: float
    distance_error: float = Field(description="Standard error")
    straight: float
    in_frame: FramedDistance | None = Field(description="The same by the scale of the pins; null: they fix none")
    xy: list[Place] = Field(description="Corners of the way, in map coordinates")


class PinBody(BaseModel):
    """A place to be named."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, json_schema_extra={"examples": [{"place": "landmark:7", "x": 12.5, "y": -3.0}]}
    )

    place: str = Field(max_length=100, description="landmark:ID, landmark:ID@T, biobot:ID@T, point:INDEX, or xy:X,Y[,COMPONENT]")
    x: Metres | None = Field(default=None, description="Where it is in the operator's frame [m], with y; null: it is only named")
    y: Metres | None = Field(default=None, description="As x")

    @model_validator(mode="after")
    def _check_pair(self) -> "PinBody":
        if (self.x is None) != (self.y is None):
            raise ValueError("has one of x and y; give both, or neither")
        return self


class PinItem(AnswerModel):
    """A place that the operator named, and where it is on the newest map."""

    name: str
    place: str = Field(description="What is kept: a point or coordinates of a map became where a biobot was when, which outlives the map")
    x: float | None
    y: float | None
    map_x: float | None = Field(description="null: there is no map, or it does not show the place")
    map_y: float | None
    component: int | None
    gap_s: float | None = Field(description="How far the encounters that tell the place are from its time")
    residual_m: float | None = Field(description="How far x and y are from where the frame puts the place; null: it took no part")
    problem: str | None = Field(description="Why the map does not show it")


class PinList(AnswerModel):
    """All pins by name, and the frame that those with coordinates fix."""

    pins: list[PinItem]
    map_version: int | None
    frame: dict[str, object] | None = Field(
        description="How each pinned component is brought to the operator's frame [m]: operator = matrix * map + shift; null: not at all"
    )
    problems: list[str] = Field(description="What stands in the way of a frame")
