"""One backpack's firmware: senses encounters, buffers and reports them, tells its mode, obeys commands. No I/O.

All instants are readings of the backpack's own clock [ms since its boot], handed in by the caller. Everything a real backpack
would say goes through ``poll``, everything it hears through ``receive``.

The buffer holds a bounded number of encounters, those not yet acknowledged included. When it is full the newest encounter is
lost and counted: a sequence number once given is owed to the base station, so the oldest cannot make room.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from firmware_protocol.message_codec import decode_downlink, encode_uplink
from firmware_protocol.messages import (
    MAX_ENCOUNTER_MS,
    MAX_ENCOUNTERS_PER_BATCH,
    MAX_ENCOUNTERS_WITH_PATHS_PER_BATCH,
    MAX_NEIGHBOURS_PER_PART,
    Acknowledge,
    Action,
    ConfigurationRequest,
    ConfigurationResult,
    Configure,
    Downlink,
    EncounterBatch,
    EncounterBatchWithPaths,
    EncounterEntry,
    HelloRequest,
    MessageFault,
    Neighbour,
    Neighbours,
    Status,
    Stimulate,
    StimulateReply,
    TimeSyncReply,
    TimeSyncRequest,
    Uplink,
    UplinkHeader,
    WireCause,
    WireMode,
)
from firmware_protocol.units import BootId, NodeId, RssiDbm
from simulator import chance
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.backpacks.contacts import Contact, PathMeter, tick, whole_dbm
from simulator.backpacks.outbox import Outbox
from simulator.backpacks.self_description import SelfDescription
from simulator.backpacks.settings import Settings
from simulator.backpacks.stimulator import Actuation, Outcome, Stimulator
from simulator.errors import ParameterError
from simulator.radios.proximity import Closed, Opened, ProximityLogger

MAX_NODE = 0xFFFE

_SPREAD_STREAM = 202
_MAX_NEIGHBOURS = 250  # the table's size in this model: the strongest are told
_MODULUS = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Transmission:
    """A payload for the radio, and what it says."""

    payload: bytes
    sequence: int
    message: Uplink
    is_first: bool
    """False where this is a repetition."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledged:
    """The base station has this message on disk."""

    sequence: int
    message: Uplink


@dataclass(frozen=True, slots=True, kw_only=True)
class BeaconsChanged:
    """The backpack now sends a beacon every ``period_ms`` of its clock, and makes use of beacons at least as strong as ``exit_dbm``."""

    period_ms: int
    exit_dbm: float


Effect: TypeAlias = Transmission | Acknowledged | Actuation | BeaconsChanged
"""What a call brings about outside the backpack."""


class Backpack:
    """See the module.

    Parameters
    ----------
    node, boot, eui64
        Node number, count of starts, and hardware address.
    seed, now_ms
        For its draws, which are keyed by (seed, node, index); what its clock shows at first.
    sense_neighbours
        Asked when a report is due: who is heard within communication range now.
    read_path_mm
        What its inertial unit had measured by an instant of its clock: the path since boot [mm]; None where it has no such unit.
    """

    def __init__(
        self, *, node: NodeId, boot: BootId, eui64: int, seed: int, config: BackpackConfig, now_ms: int,
        sense_neighbours: Callable[[], Sequence[Neighbour]], read_path_mm: Callable[[int], float] | None = None,
    ) -> None:  # fmt: skip
        if not 0 <= node <= MAX_NODE:
            raise ParameterError(name="node", got=node, wanted=f"0 to {MAX_NODE}")
        self.node = node
        self.boot = boot
        self.n_dropped = 0
        self.n_ignored = 0
        self.mode = WireMode.CRW
        self.cause = WireCause.NATURAL
        self._description = SelfDescription(eui64=eui64, boot=boot, booted_ms=now_ms, config=config, has_imu=read_path_mm is not None)
        self._seed = seed
        self._config = config
        self._sense_neighbours = sense_neighbours
        self._path_meter = None if read_path_mm is None else PathMeter(read_mm=read_path_mm)
        self._batch_size = MAX_ENCOUNTERS_PER_BATCH if read_path_mm is None else MAX_ENCOUNTERS_WITH_PATHS_PER_BATCH
        self._settings = Settings.at_boot(config)
        self._answer_at_ms: int | None = None
        self._answer = self._settings.report(0, ConfigurationResult.DONE)
        self._has_told_start = False
        self._outbox = Outbox(biobot=node, seed=seed, config=config.outbox)
        self._stimulator = Stimulator(can_follow_walls=config.can_follow_walls)
        self._logger = None if config.proximity is None else ProximityLogger(config=config.proximity)
        self._contacts: dict[NodeId, Contact] = {}
        self._buffer: deque[EncounterEntry] = deque()
        self._n_unacknowledged = 0
        self._flush_at_ms: int | None = None
        self._since_ms = now_ms
        self._n_spread = 0
        self._hello_at_ms: int | None = self._spread(now_ms)
        self._status_at_ms: int | None = self._hello_at_ms
        self._neighbours_at_ms: int | None = self._hello_at_ms

    @property
    def n_buffered(self) -> int:
        """Encounters reported or to be reported, and not yet acknowledged."""
        return len(self._buffer) + self._n_unacknowledged

    @property
    def n_open(self) -> int:
        """Encounters that go on."""
        return len(self._contacts)

    @property
    def is_settled(self) -> bool:
        """Nothing is left to say: no contact is open, and the base station has everything."""
        has_told = self._hello_at_ms is None and self._answer_at_ms is None
        return has_told and not self._contacts and not self._buffer and self._outbox.is_empty

    def begin_encounter(self, peer: NodeId, *, start_ms: int, rssi_dbm: RssiDbm) -> None:
        """Sense that ``peer`` came within detection range."""
        path_mm = None if self._path_meter is None else self._path_meter.mark(start_ms)
        next_report_ms = start_ms + self._config.provisional_ms
        self._contacts[peer] = Contact(start_ms=start_ms, rssi_dbm=rssi_dbm, next_report_ms=next_report_ms, path_mm=path_mm)

    def end_encounter(self, peer: NodeId, *, end_ms: int, now_ms: int) -> None:
        """Sense that ``peer`` went; nothing happens where no encounter with it had begun."""
        self._cut_long_contacts(end_ms, now_ms=now_ms)
        contact = self._contacts.pop(peer, None)
        if contact is not None:
            self._store(peer, contact, end_ms=max(end_ms, contact.start_ms), now_ms=now_ms)

    def hear_beacon(self, peer: NodeId, *, at_ms: int, rssi_dbm: float, now_ms: int) -> None:
        """Sense ``peer``'s beacon, which came at ``at_ms``; nothing happens where encounters are not formed from beacons."""
        if self._logger is not None:
            self._follow(self._logger.hear(peer, at=at_ms, rssi_dbm=rssi_dbm), now_ms=now_ms)
            contact = self._contacts.get(peer)
            if contact is not None:
                contact.last_ms = max(at_ms, contact.start_ms)

    def sense_until(self, until_ms: int, *, now_ms: int) -> bool:
        """Know that every beacon up to ``until_ms`` has been given: what none has kept for too long ends; tell whether anything did."""
        changes = [] if self._logger is None else self._logger.poll(now=until_ms)
        self._follow(changes, now_ms=now_ms)
        return bool(changes)

    def stop_sensing(self, *, now_ms: int) -> None:
        """End every encounter that beacons keep open, with its last beacon."""
        if self._logger is not None:
            self._follow(self._logger.close_all(), now_ms=now_ms)

    def change_mode(self, mode: WireMode, cause: WireCause, *, at_ms: int) -> None:
        """Sense that the insect walks or stands still; told at once if it is news."""
        if (mode, cause) != (self.mode, self.cause):
            self.mode, self.cause, self._since_ms = mode, cause, at_ms
            self._tell_status()

    def receive(self, payload: bytes, *, now_ms: int, is_broadcast: bool = False) -> list[Effect]:
        """Take a radio payload; one that is no message for a backpack is counted and ignored."""
        decoded = decode_downlink(payload)
        if isinstance(decoded, MessageFault):
            self.n_ignored += 1
            return []
        return self._obey(decoded[1], now_ms=now_ms, is_broadcast=is_broadcast)

    def poll(self, *, now_ms: int) -> list[Effect]:
        """Do what is due by now; return what goes on the air and what the insect is made to do."""
        effects: list[Effect] = list(self._settle(self._stimulator.poll(now_ms=now_ms), now_ms=now_ms))
        self._cut_long_contacts(now_ms, now_ms=now_ms)
        self._report_ongoing(now_ms)
        self._tell_what_is_due(now_ms)
        self._fill_batches(now_ms)
        for copy in self._outbox.take_due(now_ms):
            payload = self._encode(copy.sequence, copy.message, now_ms=now_ms)
            effects.append(Transmission(payload=payload, sequence=copy.sequence, message=copy.message, is_first=copy.is_first))
        return effects

    def next_due_ms(self) -> int | None:
        """Return when ``poll`` is to be called at the latest; a time already past means now, None never."""
        dues = [contact.next_report_ms for contact in self._contacts.values()]
        own = (self._answer_at_ms, self._hello_at_ms, self._status_at_ms, self._neighbours_at_ms)
        dues += [due for due in (*own, self._stimulator.next_due_ms(), self._outbox.next_due_ms()) if due is not None]
        if self._flush_at_ms is not None and self._outbox.n_free:
            dues.append(self._flush_at_ms)
        return min(dues, default=None)

    def quieten(self) -> None:
        """Tell state and neighbours no more by the clock, so that what is under way comes to an end."""
        self._status_at_ms = self._neighbours_at_ms = None

    def rejoin(self, *, now_ms: int) -> None:
        """Have joined another coordinator, or the old one again: say hello to it, and repeat now what nobody has confirmed."""
        self._outbox.hurry(at_ms=now_ms)
        if self._hello_at_ms is None:
            self._hello_at_ms = now_ms

    def _follow(self, changes: Sequence[Opened | Closed], *, now_ms: int) -> None:
        for change in changes:
            peer = NodeId(change.peer)
            match change:
                case Opened(start=start_ms, rssi_dbm=rssi_dbm):
                    self.begin_encounter(peer, start_ms=start_ms, rssi_dbm=whole_dbm(rssi_dbm))
                    self._contacts[peer].last_ms = start_ms
                case Closed(end=end_ms, mean_rssi_dbm=rssi_dbm):
                    self._contacts[peer].rssi_dbm = whole_dbm(rssi_dbm)
                    self.end_encounter(peer, end_ms=end_ms, now_ms=now_ms)

    def _obey(self, message: Downlink, *, now_ms: int, is_broadcast: bool) -> list[Effect]:
        match message:
            case HelloRequest():
                at_ms = self._spread(now_ms) if is_broadcast else now_ms
                self._outbox.hurry(at_ms=at_ms)
                self._hello_at_ms = at_ms if self._hello_at_ms is None else min(at_ms, self._hello_at_ms)
                return []
            case Acknowledge():
                return self._acknowledge(message, now_ms=now_ms)
            case TimeSyncRequest():
                reply = TimeSyncReply(token=message.token, received_ms=tick(now_ms))
                return [Transmission(payload=self._encode(0, reply, now_ms=now_ms), sequence=0, message=reply, is_first=True)]
            case Stimulate(action=action):
                if is_broadcast and action is not Action.STOP:  # a train for everybody is nobody's wish
                    self.n_ignored += 1
                    return []
                at_ms = self._spread(now_ms) if is_broadcast else now_ms
                return list(self._settle(self._stimulator.submit(message, now_ms=now_ms), now_ms=now_ms, answer_at_ms=at_ms))
            case Configure():
                return self._configure(message, now_ms=now_ms, is_broadcast=is_broadcast)
            case ConfigurationRequest(token=token):
                self._tell_settings(token, ConfigurationResult.DONE, now_ms=now_ms, is_broadcast=is_broadcast)
                return []

    def _configure(self, wanted: Configure, *, now_ms: int, is_broadcast: bool) -> list[Effect]:
        before_ms = self._settings.beacon_period_ms
        self._tell_settings(wanted.token, self._settings.apply(wanted), now_ms=now_ms, is_broadcast=is_broadcast)
        period_ms, proximity = self._settings.beacon_period_ms, self._settings.proximity
        if period_ms != before_ms:
            self._hello_at_ms = now_ms
        if self._logger is None or proximity is None:
            return []
        self._logger.config = proximity
        return [BeaconsChanged(period_ms=period_ms, exit_dbm=proximity.exit_dbm)]

    def _tell_settings(self, token: int, result: ConfigurationResult, *, now_ms: int, is_broadcast: bool) -> None:
        self._answer = self._settings.report(token, result)  # of two requests at a time, the later one is answered
        self._answer_at_ms = self._spread(now_ms) if is_broadcast else now_ms

    def _acknowledge(self, message: Acknowledge, *, now_ms: int) -> list[Effect]:
        acknowledged: list[Effect] = []
        if message.boot != self.boot or not self._outbox.is_of_given_numbers(message):
            self.n_ignored += 1
            return acknowledged
        for sequence, done in self._outbox.acknowledge(message, now_ms=now_ms):
            if isinstance(done, EncounterBatch | EncounterBatchWithPaths):
                self._n_unacknowledged -= len(done.entries)
            acknowledged.append(Acknowledged(sequence=sequence, message=done))
        return acknowledged

    def _settle(self, outcomes: Sequence[Outcome], *, now_ms: int, answer_at_ms: int | None = None) -> list[Actuation]:
        actuations = []
        for outcome in outcomes:
            if outcome.actuation is not None:
                actuations.append(outcome.actuation)
                self._expect(outcome.actuation, now_ms=now_ms)
            if outcome.command is not None:
                # A full outbox costs a reply, never the execution: the base station then reports the outcome as unknown.
                reply = StimulateReply(
                    command=outcome.command, result=outcome.result, executed_ms=tick(outcome.decided_ms), mode=self.mode
                )  # fmt: skip
                self._outbox.put_once(reply, now_ms=now_ms, at_ms=answer_at_ms)
        return actuations

    def _expect(self, actuation: Actuation, *, now_ms: int) -> None:
        """Take for done what an insect always does; whether it responds to more than that will be sensed."""
        if not self._config.insect_obeys:
            return
        if actuation.mode is not None:
            self.change_mode(actuation.mode, actuation.cause, at_ms=now_ms)
        elif self.mode is WireMode.CRW:
            self.change_mode(WireMode.CRW, actuation.cause, at_ms=now_ms)

    def _tell_what_is_due(self, now_ms: int) -> None:
        if self._hello_at_ms is not None and now_ms >= self._hello_at_ms:
            hello = self._description.hello(beacon_period_ms=self._settings.beacon_period_ms)
            limits = self._description.limits(now_ms=now_ms)
            is_told = self._outbox.put_once(hello, now_ms=now_ms) and self._outbox.put_once(limits, now_ms=now_ms)
            self._hello_at_ms = None if is_told else now_ms + self._config.outbox.first_retry_ms
            if is_told and not self._has_told_start:
                self._has_told_start = self._outbox.put(self._description.started())
        if self._answer_at_ms is not None and now_ms >= self._answer_at_ms:
            self._answer_at_ms = None if self._outbox.put(self._answer) else now_ms + self._config.outbox.first_retry_ms
        if self._status_at_ms is not None and now_ms >= self._status_at_ms:
            self._status_at_ms = now_ms + self._config.status_period_ms
            if not self._outbox.holds(Status):
                self._tell_status(now_ms=now_ms)
        if self._neighbours_at_ms is not None and now_ms >= self._neighbours_at_ms:
            self._neighbours_at_ms = now_ms + self._config.neighbours_period_ms
            if not self._outbox.holds(Neighbours):
                self._tell_neighbours()

    def _tell_status(self, *, now_ms: int | None = None) -> None:
        battery_mv = self._description.battery_mv(self._since_ms if now_ms is None else now_ms)
        self._outbox.put(
            Status(
                mode=self.mode, cause=self.cause, mode_since_ms=tick(self._since_ms), battery_mv=battery_mv,
                buffered=min(self.n_buffered, _MODULUS - 1), dropped=self.n_dropped % _MODULUS,
            )
        )  # fmt: skip

    def _tell_neighbours(self) -> None:
        heard = sorted(self._sense_neighbours(), key=lambda one: (-one.rssi_dbm, one.node))[:_MAX_NEIGHBOURS]
        parts = [tuple(heard[at : at + MAX_NEIGHBOURS_PER_PART]) for at in range(0, len(heard), MAX_NEIGHBOURS_PER_PART)] or [()]
        for part, neighbours in enumerate(parts):
            self._outbox.put(Neighbours(part=part, n_parts=len(parts), neighbours=neighbours))

    def _report_ongoing(self, now_ms: int) -> None:
        for peer, contact in self._contacts.items():
            if now_ms >= contact.next_report_ms:
                contact.next_report_ms = now_ms + self._config.provisional_ms
                if self.n_buffered < self._config.capacity:  # where there is no room, the final report is worth more
                    self._keep(contact.entry(peer, end_ms=contact.known_until_ms(now_ms), is_ongoing=True), now_ms=now_ms)

    def _cut_long_contacts(self, until_ms: int, *, now_ms: int) -> None:
        for peer, contact in self._contacts.items():
            while contact.known_until_ms(until_ms) - contact.start_ms > MAX_ENCOUNTER_MS:
                cut_ms = contact.start_ms + MAX_ENCOUNTER_MS
                self._store(peer, contact, end_ms=cut_ms, now_ms=now_ms)
                contact.start_ms = cut_ms
                contact.path_mm = None if self._path_meter is None else self._path_meter.mark(cut_ms)

    def _store(self, peer: NodeId, contact: Contact, *, end_ms: int, now_ms: int) -> None:
        if self.n_buffered >= self._config.capacity:
            self.n_dropped += 1
        else:
            self._keep(contact.entry(peer, end_ms=end_ms, is_ongoing=False), now_ms=now_ms)

    def _keep(self, entry: EncounterEntry, *, now_ms: int) -> None:
        self._buffer.append(entry)
        if len(self._buffer) >= self._batch_size:
            self._flush_at_ms = now_ms
        elif self._flush_at_ms is None:
            self._flush_at_ms = now_ms + self._settings.report_period_ms

    def _fill_batches(self, now_ms: int) -> None:
        while self._buffer and self._outbox.n_free:
            is_due = self._flush_at_ms is not None and now_ms >= self._flush_at_ms
            if len(self._buffer) < self._batch_size and not is_due:
                return
            entries = tuple(self._buffer.popleft() for _ in range(min(len(self._buffer), self._batch_size)))
            self._n_unacknowledged += len(entries)
            self._outbox.put(EncounterBatch(entries=entries) if self._path_meter is None else EncounterBatchWithPaths(entries=entries))
            if not self._buffer:
                self._flush_at_ms = None

    def _spread(self, now_ms: int) -> int:
        self._n_spread += 1
        return now_ms + int(
            self._config.spread_ms * chance.uniform(seed=self._seed, biobot=self.node, stream=_SPREAD_STREAM, index=self._n_spread)
        )

    def _encode(self, sequence: int, message: Uplink, *, now_ms: int) -> bytes:
        return encode_uplink(UplinkHeader(node=self.node, boot=self.boot, sequence=sequence, sent_ms=tick(now_ms)), message)
