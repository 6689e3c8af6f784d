"""Commands to biobots, their stages, and what a gateway tells of each biobot's stimulation (CONTRACT.md §4).

None of it is journaled as a record: the gateway's audit log has it.
"""

from enum import Enum
from typing import Annotated

import msgspec

from firmware_protocol.contract.records import AnyNode, Mode, Struct
from firmware_protocol.first_use import prepare
from firmware_protocol.units import Nanoseconds

_Count = Annotated[int, msgspec.Meta(ge=0)]
CommandId = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._-]+$")]
OperatorName = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
_Name = Annotated[str, msgspec.Meta(max_length=63, pattern=r"^([A-Za-z0-9_][A-Za-z0-9_.-]*)?$")]


class StimulationAction(Enum):
    """What an operator asks of a biobot, or (the last) of all."""

    START = "start"
    STOP = "stop"
    TURN_LEFT = "turn_left"
    TURN_RIGHT = "turn_right"
    FOLLOW_WALLS = "follow_walls"
    """To walk as after a start, and to keep to walls; only for backpacks that can. Without a train, but where the request's pulse has a
    ``duration_ms``."""
    STOP_ALL = "stop_all"
    """Every biobot that the gateway can reach; the request's node is ``EVERYBODY``."""


class WaveformName(Enum):
    """Shape of one pulse (WIRE_FORMAT.md §6.5); all but the last are balanced in charge."""

    SYMMETRIC = "symmetric"
    ASYMMETRIC = "asymmetric"
    MONOPHASIC = "monophasic"


class PulseRequest(Struct, frozen=True, kw_only=True):
    """A pulse train of one's own; None: as the gateway's configuration has it. What is beyond its limits, or the backpack's, is refused."""

    frequency_hz: Annotated[int, msgspec.Meta(ge=1, le=255)] | None = None
    pulse_width_us: Annotated[int, msgspec.Meta(ge=1, le=0xFFFF)] | None = None
    """Of one phase."""
    amplitude_mv: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)] | None = None
    """Of the first phase."""
    duration_ms: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)] | None = None
    """Of the train."""
    channel: Annotated[int, msgspec.Meta(ge=0, le=255)] | None = None
    waveform: WaveformName | None = None


class StimulationRequest(Struct, frozen=True, kw_only=True):
    """A command to one biobot or to all, sent as a query to ``command/{gateway}``, or to all gateways' at once.

    A motion (all but stops) with ``hold_ms`` or ``commander`` is *controlled motion*: the biobot is stopped when the hold is over, by its
    backpack and by the gateway, or when its commander is gone.
    """

    command_id: CommandId
    node: AnyNode
    action: StimulationAction
    operator: OperatorName
    issued_wall_ns: Nanoseconds
    ttl_ms: Annotated[int, msgspec.Meta(ge=1, le=60_000)] = 5_000
    hold_ms: Annotated[int, msgspec.Meta(ge=0, le=3_600_000)] = 0
    commander: _Name = ""
    """Whose liveliness token ``commanders/{name}`` must be there as long as the motion lasts, which then has a hold; empty: nobody's."""
    pulse: PulseRequest | None = None


class Stage(Enum):
    """How far a command has come; the last four are final."""

    ACCEPTED = "accepted"
    RADIO_CONFIRMED = "radio_confirmed"
    BIOBOT_CONFIRMED = "biobot_confirmed"
    REFUSED = "refused"
    FAILED = "failed"
    UNKNOWN = "unknown"


class Refusal(Enum):
    """Why a command was refused, for programs; its stage's ``reason`` says it to people, with value, limit and next step."""

    UNKNOWN_BIOBOT = "unknown_biobot"
    """The gateway has never heard of it."""
    UNFIT_BIOBOT = "unfit_biobot"
    """It cannot be stimulated, or was not heard since the gateway started."""
    STALE = "stale"
    """It is older than it may be (`ttl_ms`)."""
    FROM_THE_FUTURE = "from_the_future"
    """It was issued later than now, by a clock that is wrong."""
    ID_REUSED = "id_reused"
    """Another command had this id."""
    PULSE = "pulse"
    """A parameter of the train is beyond a limit."""
    GAP = "gap"
    """The pause after the last train is too short."""
    TRAINS = "trains"
    """Too many trains in the window."""
    ON_TIME = "on_time"
    """Too much stimulation in the window."""
    TOO_MANY = "too_many"
    """Too many commands are under way."""
    JOURNAL = "journal"
    """The disk takes or gives nothing."""
    RADIO = "radio"
    """No radio reaches it now."""
    OVERTAKEN = "overtaken"
    """A stop came before it was sent."""
    NO_COMMANDER = "no_commander"
    """The commander that it names is not there."""
    NO_HOLD = "no_hold"
    """It names a commander, and no hold: its biobot would walk on where nobody reaches it."""
    STOPPING = "stopping"
    """The gateway is about to end."""


class CommandStage(Struct, frozen=True, kw_only=True):
    """One answer to a command; several may follow each other, the last one is final. Published under ``stages/{gateway}`` too."""

    command_id: str
    gateway: str
    node: AnyNode
    action: StimulationAction
    stage: Stage
    wall_ns: Nanoseconds
    reason: str = ""
    mode: Mode | None = None
    operator: str = ""
    refusal: Refusal | None = None
    deadline_wall_ns: Nanoseconds | None = None
    """The next stage is told by then at the latest; None: this one is final, or the gateway is older than this field."""
    part_of: str = ""
    """The stop of all that this stop of one biobot is a part of."""

    @property
    def is_final(self) -> bool:
        """No further stage follows."""
        return self.stage not in {Stage.ACCEPTED, Stage.RADIO_CONFIRMED}


class CommanderBeat(Struct, frozen=True, kw_only=True):
    """A commander says that it is there; published under ``beat/{commander}`` several times a second while it has anybody under control.

    Its liveliness token goes at once when its process ends; a link that swallows all it is given takes longer to be noticed that way.
    """

    number: _Count
    """Grows with each beat."""


class StimulationAccount(Struct, frozen=True, kw_only=True):
    """How a biobot was stimulated; published under ``stimulation/{gateway}/{node}`` when it changes."""

    gateway: str
    node: AnyNode
    wall_ns: Nanoseconds
    n_trains: _Count
    """All that the audit log knows of."""
    on_ms: _Count
    """Length of all of them together [ms]."""
    n_trains_in_window: _Count
    on_ms_in_window: _Count
    window_s: float
    last_train_wall_ns: Nanoseconds | None
    ready_in_ms: _Count
    """No train is admitted for so long."""
    n_commands: _Count
    n_confirmed: _Count
    n_unknown: _Count
    n_refused: _Count
    n_answerable: _Count = 0
    """Starts and stops whose effect its reported mode could show."""
    n_obeyed: _Count = 0
    """Those of them after which it was in the mode asked for."""
    habituation: float = 0.0
    """How used to trains it is by the model of docs/stimulation.md: 0 fresh, 1 fully; an estimate."""
    controlled_by: str = ""
    """Operator who moves it now."""


prepare(StimulationRequest, CommandStage, CommanderBeat, StimulationAccount)
