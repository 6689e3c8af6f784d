"""What JSON looks like where biobots and missions are told what to do; see ``schemas`` for all else."""

from typing import Annotated, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from firmware_protocol.contract.mission_orders import MissionAction
from mapper.api.schemas import AnswerModel, NodeNumber, NodeText
from mapper.emergency_stop import MAX_STOP_ID

STOP_PATH: Final = "/api/v1/stop"
COMMANDS_PATH: Final = "/api/v1/commands"
MAX_WAIT_S: Final = 60.0

_ID: Final = r"^[A-Za-z0-9._-]+$"
_STOPS_ALL: Final = "stop_all"

CommandId = Annotated[str, Field(min_length=1, max_length=64, pattern=_ID)]
GatewayName = Annotated[str, Field(min_length=1, max_length=63, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
StageName = Literal["accepted", "radio_confirmed", "biobot_confirmed", "refused", "failed", "unknown"]
OutcomeName = Literal["biobot_confirmed", "refused", "failed", "unknown", "undelivered"]
RefusalName = Annotated[str | None, Field(description="Why it was refused, for programs: a word of the contract (CONTRACT.md §4)")]
PhaseName = Literal["idle", "dispersion", "landmark_selection", "exploration", "paused", "done"]
_Biobot = NodeNumber | NodeText


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class _GivenBody(_Body):
    """What somebody gives: who that is, the token says, and nobody else."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_operator(cls, given: object) -> object:
        if isinstance(given, dict) and "operator" in given:
            raise ValueError("operator is not taken from the body: it is the name of the token's holder; leave it out")
        return given


class PulseBody(_Body):
    """A pulse train of one's own; what is left out is as the gateway's configuration has it. Beyond a limit it is refused."""

    frequency_hz: int | None = Field(default=None, ge=1, le=255)
    pulse_width_us: int | None = Field(default=None, ge=1, le=0xFFFF, description="Of one phase")
    amplitude_mv: int | None = Field(default=None, ge=0, le=0xFFFF, description="Of the first phase")
    duration_ms: int | None = Field(default=None, ge=0, le=0xFFFF, description="Of the train")
    channel: int | None = Field(default=None, ge=0, le=255)
    waveform: Literal["symmetric", "asymmetric", "monophasic"] | None = None


class CommandBody(_GivenBody):
    """A command to one biobot, or a stop of all."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"biobot": 17, "action": "stop"},
                {"biobot": 17, "action": "turn_left", "hold_ms": 2000, "id": "left-1"},
                {"biobot": 17, "action": "start", "pulse": {"frequency_hz": 50, "duration_ms": 300}, "wait_s": 0},
            ]
        }
    )

    biobot: _Biobot | None = Field(
        default=None, description="Its id, as a number or as a decimal string (a program may not hold 64-bit numbers); none for stop_all"
    )
    action: Literal["start", "stop", "turn_left", "turn_right", "follow_walls", "stop_all"]
    ttl_ms: int = Field(default=5_000, ge=1, le=60_000, description="Not carried out later than this after now; a stop always is")
    hold_ms: int = Field(
        default=0,
        ge=0,
        le=3_600_000,
        description="Controlled motion: the biobot is stopped after this, and when this mapper is gone; 0: it goes on by itself",
    )
    pulse: PulseBody | None = None
    id: CommandId | None = Field(default=None, description="Repeat a request under the same id, and the command is given once")
    wait_s: float | None = Field(default=None, ge=0, le=MAX_WAIT_S, description="Answer after so long at most; none: at its end")

    @model_validator(mode="after")
    def _check_biobot(self) -> Self:
        if (self.action == _STOPS_ALL) != (self.biobot is None):
            raise ValueError("biobot must be left out for stop_all, and given for every other action")
        return self


class StopBody(_GivenBody):
    """An emergency stop; nothing of it must be given."""

    model_config = ConfigDict(json_schema_extra={"examples": [{}, {"biobots": [3, 17], "wait_s": 3}]})

    biobots: list[_Biobot] | None = Field(
        default=None, min_length=1, max_length=256, description="Some alone; left out: all, at every gateway"
    )
    id: Annotated[str, Field(min_length=1, max_length=MAX_STOP_ID, pattern=_ID)] | None = Field(
        default=None, description="The same id again is the same stop: gateways that told nothing are asked once more"
    )
    wait_s: float | None = Field(
        default=None,
        ge=0,
        le=MAX_WAIT_S,
        description="Wait so long for its end; 0: for nothing; none: up to 1 s for what gateways say first",
    )


class OrderBody(_GivenBody):
    """An order to the mission of a gateway, or of all."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"action": "pause"}]})

    action: Annotated[MissionAction, Field(strict=False)]
    gateway: GatewayName | None = Field(default=None, description="Whose mission; none: each that takes it")
    ttl_ms: int = Field(default=5_000, ge=1, le=60_000)
    id: CommandId | None = Field(default=None, description="Repeat a request under the same id, and the order is given once")


class StageView(AnswerModel):
    """One answer of a gateway."""

    gateway: str
    stage: StageName
    wall_ns: int
    reason: str
    mode: Literal["CRW", "S"] | None
    refusal: RefusalName
    deadline_wall_ns: int | None = Field(description="The next stage is told by then; null: it is the last, or nothing was promised")


class GatewayAnswerView(AnswerModel):
    """How a command stands at one gateway; ``stage`` null: it told nothing yet."""

    gateway: str
    stage: StageName | None
    outcome: OutcomeName | None
    reason: str
    refusal: RefusalName


class CommandView(AnswerModel):
    """A command and what became of it; ``outcome`` null: under way. Null elsewhere: it was given elsewhere, and this is not told."""

    id: str
    biobot: int | None = Field(description="null: all")
    gateway: str | None = Field(description="null: all")
    action: str
    operator: str
    origin: Literal["here", "elsewhere"] = Field(description="Whether it was given through this mapper")
    part_of: str | None = Field(description="The stop of all that this stop of one biobot is a part of")
    began_wall_ns: int = Field(description="When it was given, or heard of")
    issued_wall_ns: int | None
    ttl_ms: int | None
    hold_ms: int | None
    commander: str | None = Field(description="Who must be there as long as it lasts")
    pulse: PulseBody | None
    stages: list[StageView]
    answers: list[GatewayAnswerView]
    outcome: OutcomeName | None = Field(description="Of several gateways, that of the one that is worst off")
    reason: str
    refusal: RefusalName


class CommandList(AnswerModel):
    """The newest commands, newest first."""

    commands: list[CommandView]


class StopAnswerView(GatewayAnswerView):
    """How the stop of a biobot, or (null) of all, stands at one gateway."""

    biobot: int | None
    command_id: str


class StopView(AnswerModel):
    """A stop; follow it by the ids of its commands, or repeat it under its id."""

    id: str
    operator: str
    biobots: list[int] | None = Field(description="null: all")
    has_ended: bool
    answers: list[StopAnswerView]
    unanswered: list[str] = Field(description="Gateways that told nothing yet: their biobots may walk on")


class AccountView(AnswerModel):
    """How a biobot was stimulated through one gateway."""

    biobot: int
    gateway: str
    wall_ns: int
    n_trains: int
    on_ms: int
    n_trains_in_window: int
    on_ms_in_window: int
    window_s: float
    last_train_wall_ns: int | None
    ready_in_ms: int
    ready_wall_ns: int = Field(description="No train is admitted before [gateway's clock]")
    n_commands: int
    n_confirmed: int
    n_unknown: int
    n_refused: int
    n_answerable: int
    n_obeyed: int
    habituation: float = Field(description="An estimate: 0 fresh, 1 fully used to it")
    controlled_by: str | None = Field(description="The operator who moves it now")


class AccountList(AnswerModel):
    """Accounts by biobot and gateway."""

    accounts: list[AccountView]


class MissionPhaseItem(AnswerModel):
    """A phase that began; further fields, such as whom it chose and why, are as the gateway records them (CONTRACT.md §3)."""

    gateway: str
    phase: PhaseName
    t_start_wall_ns: int
    landmarks: list[int]
    reason: str
    operator: str = Field(description="Who ordered it; empty: it came by itself")
    round: int = Field(description="Dispersions of this mission so far")
    interrupted: PhaseName | None = Field(description="Of a pause: what it interrupts")


class MissionView(AnswerModel):
    """The phases of all missions, the newest one, and the newest of each gateway."""

    phase: MissionPhaseItem | None
    gateways: list[MissionPhaseItem]
    phases: list[MissionPhaseItem]


class OrderAnswerView(AnswerModel):
    """What one gateway answered to an order; further fields are as CONTRACT.md has them."""

    gateway: str
    is_taken: bool
    phase: PhaseName
    landmarks: list[int]
    reason: str
    round: int
    remaining_s: float | None = Field(description="Until the phase ends by itself; null: it does not, or not by time")
    possible: list[str] = Field(description="Orders that would be taken now")


class OrderView(AnswerModel):
    """An order, and what it was answered; one gateway at least has taken it."""

    id: str
    action: str
    operator: str
    answers: list[OrderAnswerView]
