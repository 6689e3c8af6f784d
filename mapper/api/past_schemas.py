"""What JSON looks like of what was: maps of the past and their differences; see ``schemas`` for all else."""

from pydantic import Field

from mapper.api.schemas import AnswerModel, Place


class PastMapItem(AnswerModel):
    """A map of the past."""

    version: int
    wall_ns: int = Field(description="When it was done")
    begun_wall_ns: int = Field(description="It is of all records that had come by then")
    n_encounters: int
    b0: int
    b1: int
    hole_count_probability: float | None = Field(description="That there are as many holes in truth; null: not known")
    is_enough: bool | None = Field(description="The encounters are enough for what it says; null: not known")
    made_by: str = Field(description="Names program and recipe: maps of one name were made alike")


class PastMapList(AnswerModel):
    """Maps of the past, the newest last; ``next`` is the version to ask after for what follows, null at the end."""

    maps: list[PastMapItem]
    next: int | None


class DifferenceMap(AnswerModel):
    """The figures of one of two maps."""

    version: int
    wall_ns: int
    betti_numbers: list[int]
    hole_count_probability: float | None
    is_enough: bool | None
    n_components: int
    n_encounters: int
    n_used: int
    diameter: float


class DifferenceFrame(AnswerModel):
    """How a component of the map lies in one of the earlier map."""

    before: int = Field(description="The earlier map's component")
    after: int = Field(description="This map's component")
    n_shared: int = Field(description="Encounters and landmarks that both show")
    rms: float = Field(description="Root mean square of how far these are apart, after one map is laid over the other")
    turn_deg: float
    is_mirrored: bool


class DifferenceHole(AnswerModel):
    """A hole of one of both maps."""

    hole: int = Field(description="Its number there, from 1")
    component: int
    centre: Place
    probability: float | None
    area: float | None
    area_error: float | None
    perimeter: float | None
    possible_in_other: float | None = Field(
        description="How likely the other map, which does not call it one, has a hole there; null: none"
    )
    is_comparable: bool = Field(description="The other map shows the surroundings: it says something that it has no such hole")


class StayedHoleItem(AnswerModel):
    """A hole that both maps show."""

    before: DifferenceHole
    after: DifferenceHole
    moved: float = Field(description="How far its centre is from where it was")


class DifferenceLandmarks(AnswerModel):
    """Who stands as a landmark in one of both maps only; ids as text."""

    came: list[str]
    went: list[str]
    n_stayed: int


class DifferenceView(AnswerModel):
    """What is different in a map from an earlier one; lengths in ``length_unit``."""

    before: DifferenceMap
    after: DifferenceMap
    length_unit: str
    is_comparable: bool = Field(description="Both share enough to be laid over each other")
    frames: list[DifferenceFrame]
    appeared: list[DifferenceHole]
    vanished: list[DifferenceHole]
    stayed: list[StayedHoleItem]
    landmarks: DifferenceLandmarks
    summary: list[str] = Field(description="The same for people")
