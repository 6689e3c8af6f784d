"""What the gateway's configuration may say; ``config_loading`` builds it, once at start, and it is handed down."""

from typing import Annotated, Literal

import msgspec

from firmware_protocol.contract.commands import WaveformName
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.messages import OWN_CHANNEL

_Seconds = Annotated[float, msgspec.Meta(gt=0, le=86_400)]
_Count = Annotated[int, msgspec.Meta(ge=1)]
_Period = Annotated[int, msgspec.Meta(ge=1, le=65_535)]
_Strength = Annotated[int, msgspec.Meta(ge=-127, le=20)]


class LinkTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a radio's line is kept up.

    Keys
    ----
    first_backoff_s, max_backoff_s
        Pause before a lost port is opened again: the first one, and the longest it grows to by doubling; each is drawn at random from its
        upper half. A port is tried for ever, at least once a minute.
    idle_s
        A dongle that has said nothing for so long is asked whether it is there, and given up when it has not answered some times in a row.
    silences_before_reset
        A dongle that was given up, or did not answer, so many times in a row is reset by its line where its port says how (``reset=``);
        0: never.
    max_bytes_per_s
        What one radio may say, on average; one that says more is read more slowly, so that others do not wait. No serial line says so much.
    open_timeout_s
        A port that is open but does not answer for so long is closed and opened again.
    radio_timeout_s
        A payload whose RadioConfirm does not come for so long has an unknown outcome. ZigBee retries for up to 4.8 s.
    """

    first_backoff_s: _Seconds = 0.2
    max_backoff_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 10.0
    idle_s: Annotated[float, msgspec.Meta(ge=0.5, le=60)] = 3.0
    silences_before_reset: Annotated[int, msgspec.Meta(ge=0, le=100)] = 1
    max_bytes_per_s: Annotated[float, msgspec.Meta(ge=10_000, le=1e9)] = 500_000.0
    open_timeout_s: _Seconds = 5.0
    radio_timeout_s: _Seconds = 6.0


class EncounterTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the two sides' reports become one encounter.

    Keys
    ----
    window_s
        Records this recent are kept in memory to be corrected by a late report; of older ones the journal knows.
    max_in_memory
        So many encounters are kept in memory at most, some 0.8 kB each; of the oldest of more the journal knows.
    """

    window_s: _Seconds = 900.0
    max_in_memory: Annotated[int, msgspec.Meta(ge=1_000, le=100_000_000)] = 200_000


class ClockTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the backpacks' clocks are fitted.

    Keys
    ----
    sync_period_s
        Pause between two time sync requests to one biobot.
    window_s
        Traffic this recent counts.
    """

    sync_period_s: _Seconds = 20.0
    window_s: _Seconds = 300.0


class StimulationTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What may be done to an animal, and how long an answer is waited for.

    Keys
    ----
    min_gap_s, window_s, max_trains, max_on_s
        Limits for each biobot: pause between two trains; and in any window, how many trains and how much stimulation.
        A stop is a train too: it is never refused, and counts for what follows.
        They may be made stricter than the defaults, never looser.
    min_frequency_hz, max_frequency_hz, max_amplitude_mv, max_pulse_width_us, max_duration_ms, allows_unbalanced
        Limits of every train, whoever asks for it. Published for cockroaches: 50 to 55 Hz, 2 V and half a second (Erickson et al., PLoS ONE
        2015, e0134348; RoboRoach), 1 to 9 ms a phase (RoboRoach). allows_unbalanced: waveform monophasic may be asked for.
    frequency_hz, amplitude_mv, pulse_width_us, duration_ms
        The pulse train of a command that names none of its own, within these limits. 50 Hz, 2 V bipolar and 0.5 s: best of those that
        Erickson et al. tried on hissing cockroaches. Pulse width, of one phase: the middle of the RoboRoach firmware's; they give none.
    channel
        Electrode channel, 0 to 7; 255: the one that the backpack itself uses for each action.
    waveform
        symmetric or asymmetric: biphasic, balanced in charge. monophasic: one phase, for electrodes that are known to bear it.
    reply_timeout_s
        A biobot that does not answer for so long has an unknown outcome.
    flight_s
        A frame that was given to a dongle may reach the biobot this much later, not more: without an answer, its train counts as given
        at the worst moment of that time. ZigBee tries for up to 4.8 s.
    stop_attempts, stop_retry_s
        How often a stop is sent until the biobot confirms it, and the pause between.
    max_clock_ahead_s
        A command issued later than this from now comes from a wrong clock and is refused.
    commander_silence_s
        A commander whose beat is not heard for so long is gone, whatever its liveliness token says: whom it moves is stopped.
    on_shutdown
        Whom the gateway stops before it ends: those under controlled motion, all, or none.
    """

    min_gap_s: Annotated[float, msgspec.Meta(ge=2.0, le=3600)] = 2.0
    window_s: Annotated[float, msgspec.Meta(ge=60.0, le=3600)] = 60.0
    max_trains: Annotated[int, msgspec.Meta(ge=1, le=30)] = 30
    max_on_s: Annotated[float, msgspec.Meta(gt=0, le=9.0)] = 9.0
    min_frequency_hz: Annotated[int, msgspec.Meta(ge=1, le=150)] = 50
    max_frequency_hz: Annotated[int, msgspec.Meta(ge=1, le=150)] = 55
    max_amplitude_mv: Annotated[int, msgspec.Meta(ge=0, le=4000)] = 2000
    max_pulse_width_us: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 9000
    max_duration_ms: Annotated[int, msgspec.Meta(ge=0, le=500)] = 500
    allows_unbalanced: bool = False
    frequency_hz: Annotated[int, msgspec.Meta(ge=1, le=150)] = 50
    amplitude_mv: Annotated[int, msgspec.Meta(ge=0, le=4000)] = 2000
    pulse_width_us: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 5000
    duration_ms: Annotated[int, msgspec.Meta(ge=0, le=500)] = 500
    channel: Annotated[int, msgspec.Meta(ge=0, le=255)] = OWN_CHANNEL
    waveform: WaveformName = WaveformName.SYMMETRIC
    reply_timeout_s: _Seconds = 5.0
    flight_s: Annotated[float, msgspec.Meta(ge=0.1, le=60)] = 6.0
    stop_attempts: Annotated[int, msgspec.Meta(ge=1, le=20)] = 5
    stop_retry_s: _Seconds = 1.0
    max_clock_ahead_s: _Seconds = 2.0
    commander_silence_s: Annotated[float, msgspec.Meta(ge=0.5, le=60)] = 1.2
    on_shutdown: Literal["controlled", "all", "none"] = "controlled"


class BackpackTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How backpacks sense and report encounters; a value that is not given is left as each backpack has it.

    Keys
    ----
    beacon_period_ms
        Pause between two beacons.
    rssi_enter_dbm, rssi_exit_dbm
        An encounter begins at a beacon at least as strong as the first, and is kept open by those at least as strong as the second.
    gap_tolerance_ms
        An encounter ends when no beacon has kept it open for longer.
    report_period_ms
        An encounter waits at most this long for others to share its message.
    """

    beacon_period_ms: _Period | None = None
    rssi_enter_dbm: _Strength | None = None
    rssi_exit_dbm: _Strength | None = None
    gap_tolerance_ms: _Period | None = None
    report_period_ms: _Period | None = None


class MissionTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The exploration protocol of [Dir16] IV (docs/mission.md).

    Keys
    ----
    is_enabled
        Begin the mission when the first biobot is heard; else it waits until it is ordered to start.
    dispersion_s
        How long all walk before landmarks are chosen.
    n_landmarks
        How many landmarks; 0: a share of the biobots.
    landmark_share
        That share; [Dir16] takes 0.1 to 0.2.
    selection_timeout_s
        How long neighbour reports of the biobots are waited for after dispersion.
    exploration_s
        How long exploration lasts, over all rounds; 0: until it is ended.
    redisperse_every_s
        After so much exploration all walk again, and other landmarks are chosen; 0: never.
    candidate_silence_s, neighbours_age_s
        A biobot that was not heard for so long is no candidate, nor one whose neighbour report is older than this.
    min_battery_mv
        A biobot whose battery is below is no candidate, and a landmark whose is gets replaced; 0: whatever its battery.
    landmark_silence_s
        A landmark that was not heard for so long is replaced.
    contradiction_gap_s
        Two landmarks that begin to meet although they stand, and had not met for so long, contradict each other: one has moved.
    wall_following_every_s
        Each time an exploration has run for so much longer, the walking biobots whose backpacks can are told to follow walls; 0: never.
    wall_following_s
        How long they do; then they are told to walk as before.
    """

    is_enabled: bool = False
    dispersion_s: Annotated[float, msgspec.Meta(ge=0, le=86_400)] = 60.0
    n_landmarks: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0
    landmark_share: Annotated[float, msgspec.Meta(gt=0, le=0.5)] = 0.15
    selection_timeout_s: _Seconds = 30.0
    exploration_s: Annotated[float, msgspec.Meta(ge=0, le=604_800)] = 0.0
    redisperse_every_s: Annotated[float, msgspec.Meta(ge=0, le=604_800)] = 0.0
    candidate_silence_s: _Seconds = 120.0
    neighbours_age_s: _Seconds = 120.0
    min_battery_mv: Annotated[int, msgspec.Meta(ge=0, le=20_000)] = 0
    landmark_silence_s: _Seconds = 180.0
    contradiction_gap_s: _Seconds = 300.0
    wall_following_every_s: Annotated[float, msgspec.Meta(ge=0, le=604_800)] = 0.0
    wall_following_s: _Seconds = 60.0


class RecordingTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Whether the bytes on every radio's line are recorded (docs/recordings.md).

    Keys
    ----
    directory
        Where the files go; without it nothing is recorded.
    max_mb
        The files of one radio take no more than this [MB]: the oldest go. A busy line of 115,200 baud carries 1.0 GB a day, to which
        each read and each frame written add 26 bytes.
    """

    directory: str | None = None
    max_mb: Annotated[float, msgspec.Meta(ge=1, le=1_000_000)] = 256.0


class RetentionTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How much of the journal is kept (docs/journal.md). What is younger than encounters.window_s stays in any case.

    Keys
    ----
    max_age_days
        Records and raw messages older than this go, but for those that a known mapper does not have yet. Not given: however old.
    max_mb
        The journal holds no more than this [MB]: the oldest go, those that a mapper lacks too, which is told. Not given: all the disk.
    audit_days
        Rows of the audit log are kept so long (docs/audit.md).
    node_days
        What is known of a biobot is kept so long after it was last heard.
    mapper_days
        A mapper that has not been heard of for so long is not waited for any more.
    """

    max_age_days: Annotated[float, msgspec.Meta(gt=0, le=36_500)] | None = None
    max_mb: Annotated[float, msgspec.Meta(ge=1, le=100_000_000)] | None = None
    audit_days: Annotated[float, msgspec.Meta(gt=0, le=36_500)] = 365.0
    node_days: Annotated[float, msgspec.Meta(gt=0, le=36_500)] = 90.0
    mapper_days: Annotated[float, msgspec.Meta(gt=0, le=36_500)] = 30.0


class MonitorTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the gateway says of itself over HTTP: /metrics, /healthz and /readyz (docs/operation.md).

    Keys
    ----
    listen
        HOST:PORT to answer at, such as ``127.0.0.1:9466``; empty: nowhere. There are no passwords: keep it on loopback, or in a network
        whose machines you trust.
    """

    listen: str = ""


class GatewayConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All of the gateway's configuration.

    Keys
    ----
    site, name
        Where the gateway stands and what it is called, in every key expression on Zenoh.
    ports
        The radios: ``serial:/dev/ttyACM0?baud=115200``, ``tcp:HOST:PORT``. `biobot-gateway run` needs one at least.
    journal
        The journal's file; made when it is not there.
    listen, connect
        Zenoh endpoints, such as ``tcp/127.0.0.1:7447``.
    roster
        Whom the gateway heeds where it listens itself: the ``roster.txt`` of `biobot-gateway certs`. None: whoever connects.
    log_level
        DEBUG, INFO, WARNING or ERROR.
    log_format
        text, json, or auto: text on a terminal, else one JSON object a line.
    link, encounters, clocks, stimulation, backpacks, mission, recording, retention, monitor, tls, zenoh
        Tables of their own.
    """

    site: str = "local"
    name: str = "gateway1"
    ports: tuple[str, ...] = ()
    journal: str = "biobot-gateway.sqlite"
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    roster: str | None = None
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"
    log_format: Literal["auto", "text", "json"] = "auto"
    link: LinkTable = LinkTable()
    encounters: EncounterTable = EncounterTable()
    clocks: ClockTable = ClockTable()
    stimulation: StimulationTable = StimulationTable()
    backpacks: BackpackTable = BackpackTable()
    mission: MissionTable = MissionTable()
    recording: RecordingTable = RecordingTable()
    retention: RetentionTable = RetentionTable()
    monitor: MonitorTable = MonitorTable()
    tls: TlsTable = TlsTable()
    zenoh: ZenohTable = ZenohTable()
