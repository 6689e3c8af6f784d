"""What JSON looks like: bodies that come in are checked against these, answers are described by them in the OpenAPI document."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

_MAX_NODE = 2**64 - 1

Interval = Annotated[list[float | None], Field(min_length=2, max_length=2, description="[birth, death]; death null: never")]
Place = Annotated[list[float], Field(min_length=2, max_length=2, description="[x, y] in map coordinates")]


def _check_node(text: str) -> str:
    if int(text) > _MAX_NODE:
        raise ValueError(f"is more than {_MAX_NODE}, the highest id")
    return text


NodeNumber = Annotated[int, Field(ge=0, le=_MAX_NODE)]
NodeText = Annotated[str, Field(pattern=r"^[0-9]{1,20}$"), AfterValidator(_check_node)]


class AnswerModel(BaseModel):
    """An answer may have more fields than are described: clients ignore what they do not know."""

    model_config = ConfigDict(extra="allow")


class Problem(AnswerModel):
    """An error (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str


class GatewayItem(AnswerModel):
    """A gateway."""

    name: str
    is_alive: bool
    radios: dict[str, str]
    radios_up: list[str] = Field(description="Radios that are there right now, by their liveliness")
    counters: dict[str, int]


class ClockItem(AnswerModel):
    """The wall clock of one start of a gateway, beside the site's, by encounters that another gateway told of too."""

    wall_anchor_ns: int = Field(description="Names the start: UTC minus the monotonic clock, as that start had it")
    reference: str | None = Field(description="The gateway whose clock is the site's; null: too few encounters are shared to say")
    ahead_ns: int | None = Field(description="So much ahead of the site's clock at the newest shared encounters")
    bound_ns: int | None = Field(description="ahead_ns is not wrong by more")
    n_shared: int = Field(description="Shared encounters that say so")
    since_wall_ns: int | None = Field(description="When the first of them were [site's clock]")
    is_corrected: bool = Field(description="What it recorded is shifted; not done where ahead_ns is within bound_ns")


class GatewayClockItem(GatewayItem):
    """A gateway and the clocks of its starts, the newest first."""

    clocks: list[ClockItem]


class GatewayList(AnswerModel):
    """All gateways."""

    gateways: list[GatewayClockItem]


class BiobotItem(AnswerModel):
    """A biobot; null where nobody has said it yet."""

    id: int
    key: str = Field(description="The id as text, for programs that cannot hold 64-bit numbers")
    gateway: str
    is_reachable: bool
    state: Literal["online", "lost", "unknown"] = Field(
        description="lost: silent for longer than lost_after_s, though gateway and radio listen; unknown: they do not, or it never spoke"
    )
    mode: Literal["CRW", "S"]
    cause: Literal["command", "natural"]
    is_landmark: bool
    is_halted: bool = Field(description="It stands because all were stopped; it is no landmark")
    radio: str | None
    battery_mv: int | None
    rssi_dbm: int | None
    lqi: int | None
    last_heard_wall_ns: int | None
    silence_s: float | None = Field(
        description="How long it was not heard when this was answered, by the clock of the gateway that heard it last"
    )
    buffered: int | None
    dropped: int | None
    firmware: int | None
    n_neighbours: int | None
    n_encounters: int


class BiobotList(AnswerModel):
    """All biobots and gateways; ``now_wall_ns`` is this service's clock."""

    now_wall_ns: int
    lost_after_s: float = Field(description="The silence after which a biobot is lost, here and in alerts: [alerts] lost_s")
    gateways: list[GatewayItem]
    mappers: list[str] = Field(description="Mappers on the bus, this one among them")
    commanders: list[str] = Field(description="Commanders on the bus: whom they move is stopped when they are gone")
    biobots: list[BiobotItem]


class RecordName(AnswerModel):
    """The identity of a record."""

    gateway: str
    journal: str
    boot: int
    sequence: int


class JointItem(AnswerModel):
    """One encounter that several gateways told of."""

    is_counted: bool = Field(description="Of its records, this is the one that stands for it in map and counts")
    t_start_wall_ns: int
    t_end_wall_ns: int
    is_reciprocal: bool
    records: list[RecordName]


class OwnClockItem(AnswerModel):
    """What a biobot told of an encounter on its own clock: the same however often, to whom and how late it was told."""

    node: int
    boot: int = Field(description="Count of the backpack's starts, of which the clock runs from the newest")
    start_ms: int
    end_ms: int


class EncounterItem(AnswerModel):
    """An encounter in its newest revision; instants are on the site's wall clock [ns since 1970, UTC]."""

    gateway: str
    journal: str
    boot: int
    sequence: int
    revision: int
    node_a: int
    node_b: int
    t_start_wall_ns: int
    t_end_wall_ns: int
    clock_shift_ns: int = Field(description="Of these instants, what was added to the gateway's own wall clock")
    error_ns: int = Field(description="Neither instant is wrong by more, what was added included")
    is_reciprocal: bool
    is_ongoing: bool
    is_void: bool
    own_clocks: list[OwnClockItem] = Field(description="Of those of the two that reported it; empty: the gateway does not tell")
    joint: JointItem | None = Field(description="As things stand now; null: no other gateway told of it")


class EncounterList(AnswerModel):
    """Encounters in the order in which they were last changed; ``next`` is the cursor for what follows, null at the end."""

    encounters: list[EncounterItem]
    cursor: int = Field(description="Ask with after=cursor later to get what has changed since, corrections too")
    next: int | None


class PointItem(AnswerModel):
    """An encounter of the subsample, placed; ``t`` in seconds since 1970."""

    x: float
    y: float
    t: float
    id1: int
    id2: int
    component: int
    is_well_seen: bool | None = Field(description="Its distances are most likely right; null: not known")


class HoleItem(AnswerModel):
    """A hole called real, or one that may be there; null where nothing is known. Errors are standard errors."""

    outline: list[Place]
    points: list[int]
    birth: float
    death: float
    component: int
    probability: float | None = Field(
        description="That it goes around an obstacle, and no longer interval around the same; null: not known"
    )
    outline_xy: list[Place] = Field(description="Polygon of what stands in it: closed, counter-clockwise; empty: it cannot be drawn")
    centre: Place | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    perimeter_error: float | None


class HoleCountItem(AnswerModel):
    """How many holes the map shows, and how sure that is."""

    value: int
    probability: float = Field(description="That there are as many in truth")
    probabilities: dict[str, float] = Field(description="Of each number of holes; those below 1 in 10,000 are left out")
    is_known: bool = Field(description="False: the encounters tell nothing of it, and the probabilities are those of any place")


class DataItem(AnswerModel):
    """Whether the encounters are enough for what the map says."""

    is_enough: bool
    reasons: list[str] = Field(description="Why they are not")
    remedies: list[str] = Field(description="What would help")


class LandmarkItem(AnswerModel):
    """Where a landmark stood, and from when to when [s since 1970]; ``t_end`` null: it still stands."""

    id: int
    x: float
    y: float
    component: int
    t_start: float
    t_end: float | None


class ComplexView(AnswerModel):
    """The Rips complex at the drawn scale, as indices of points."""

    edges: list[list[int]]
    triangles: list[list[int]]


class AlignedItem(AnswerModel):
    """How a map was laid over the one before: turned, mirrored and moved, never stretched."""

    n_shared: int = Field(description="Encounters and landmarks that both show, of the largest component that found its place")
    rms: float = Field(description="Root mean square of how far these are from where they were")


class MapBody(AnswerModel):
    """A map; lengths in ``parameters.length_unit``."""

    frame: dict[str, object] | None = Field(
        description="How components are brought to the operator's frame [m]: operator = matrix * map + shift; null: pins fix none"
    )
    betti_numbers: list[int]
    intervals: dict[str, list[Interval]]
    points: list[PointItem]
    holes: list[HoleItem]
    possible_holes: list[HoleItem] = Field(description="Loops that are not called holes and may be, the likeliest first")
    hole_count: HoleCountItem | None = Field(description="null: not known")
    data: DataItem | None = Field(description="null: not known")
    landmarks: list[LandmarkItem]
    complex: ComplexView
    components: list[dict[str, object]]
    n_components: int
    diameter: float
    n_encounters: int
    n_used: int
    lost_spectrum: float
    window_s: float | None = Field(description="Encounters over so long before the end of the newest one are left out; null: none for that")
    since_s: float | None = Field(
        description="Encounters count from then [s since 1970]: the landmarks were set, or the window begins; null: neither"
    )
    until_s: float | None = Field(description="Encounters count until then [s since 1970]; null: all since")
    n_before: int = Field(description="Encounters that were over by then, and are left out")
    n_ahead: int = Field(description="Known encounters dated over a minute ahead of the mapper's clock; left out where there is a window")
    last_encounter_s: float
    parameters: dict[str, object]
    warnings: list[str]
    aligned: AlignedItem | None = Field(
        default=None,
        description="It lies as the map before; null: there was none, or none that shares anything: the picture may have turned",
    )


class MapView(MapBody):
    """The newest finished map; lengths in ``parameters.length_unit``."""

    version: int
    begun_wall_ns: int = Field(description="It is of all records that had come by then")
    computed_wall_ns: int
    computing_s: float


class MapStatusView(AnswerModel):
    """The newest finished map and what has come since it was begun; the map's own fields are null before the first."""

    now_wall_ns: int
    n_known: int = Field(description="Encounters in the store that are not void")
    n_waiting: int = Field(description="Records that have come since the map was begun, each revision counted as one")
    behind_s: float = Field(description="No record that is missing in the map came earlier than this [s] ago; 0: none is missing")
    is_computing: bool = Field(description="Another map is being made")
    waiting: str | None = Field(description="What the first map waits for, or why there is no newer one: too few encounters count now")
    version: int | None
    begun_wall_ns: int | None = Field(description="The map is of all records that had come by then")
    computed_wall_ns: int | None
    computing_s: float | None
    n_encounters: int | None = Field(description="Encounters that the map is of")
    n_before: int | None = Field(description="Encounters that were over at since_wall_ns, and are left out")
    since_wall_ns: int | None = Field(description="Landmarks were set, or the window begins; null: neither")
    n_ahead: int | None = Field(description="Known encounters dated over a minute ahead of the mapper's clock")
    last_encounter_wall_ns: int | None = Field(description="End of the newest encounter of the map")


class RoutePlace(AnswerModel):
    """A place that was asked for: ``gap_s`` is how far the encounter that tells it is from the time asked for."""

    place: str
    x: float
    y: float
    component: int
    point: int | None
    gap_s: float


class HolePassed(AnswerModel):
    """How far a route turns about a hole [full turns]: what is above 0 lies on the left of one who walks it."""

    hole: int = Field(description="Its number in the map's list, from 1")
    turns: float


class RouteItem(AnswerModel):
    """The shortest route of its kind, in map coordinates."""

    length: float
    length_error: float
    signature: list[int] = Field(description="Rays from the holes' centres to larger y that it crosses, negative: from right to left")
    passes: list[HolePassed]
    xy: list[Place]


class RoutesView(AnswerModel):
    """Routes of different kinds: none of them can be drawn into another without going through an obstacle."""

    model_config = ConfigDict(extra="allow", populate_by_name=True)

    begin: RoutePlace = Field(alias="from")
    end: RoutePlace = Field(alias="to")
    length_unit: str
    is_complete: bool = Field(description="There is no other that is not far longer")
    routes: list[RouteItem]


class EnginesView(AnswerModel):
    """What computes the maps."""

    kernels: Literal["compiled", "plain"] = Field(description="plain: there are no compiled ones here; the same maps, but later")
    persistence: str | None = Field(description="Library and version; null: none is installed, so no map can be made")


class HealthView(AnswerModel):
    """The process answers; counters since its start."""

    status: Literal["ok", "degraded"] = Field(description="degraded: it answers, but there are faults")
    software: str = Field(description="Version of the program")
    wall_ns: int
    n_encounters: int
    map_version: int | None
    waiting: str | None = Field(description="What the first map waits for, or why there is no newer one: too few encounters count now")
    counters: dict[str, int]
    faults: list[str]
    engines: EnginesView


class ReadyView(AnswerModel):
    """Whether the service can do its work: it is connected to the bus."""

    is_ready: bool
    is_connected: bool
    n_gateways_alive: int
    map_version: int | None
