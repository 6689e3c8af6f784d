"""A swarm that senses meetings by schedule: the simulator's backpacks, air and dongles as one machine. No I/O but the ledger, no clock.

Every message that a backpack numbers is in the ledger before it goes on the air. A backpack whose memory is nearly full senses nothing
new, so that whatever is lost was lost behind it.
"""

import heapq
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import TypeAlias

from firmware_protocol.envelope import RadioReceived
from firmware_protocol.messages import EncounterBatch, Status, Uplink, WireCause, WireMode
from firmware_protocol.units import NS_PER_S, BootId, NodeId, RssiDbm
from simulator import chance
from simulator.backpacks.backpack import Acknowledged, Backpack, Effect, Transmission
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.clock import DriftingClock
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from simulator.radios.air import Air, DownlinkArrival, SendingDone, UplinkArrival
from simulator.radios.radio import Radio, RadioConfig, lqi
from studies.campaign.ledger import Ledger
from studies.campaign.meetings import QUICK_PACE, MeetingSide, Pace
from studies.campaign.yard_config import YardConfig

_MODE, _DRIFT = 710, 711
_EUI64_BASE = 0x00124B0000000000
_AHEAD_S = 0.25
_RSSI_DBM = RssiDbm(-60)
_SPARE = 48
"""Places of a backpack's memory that are left free for encounters that are under way."""

_MOST_WAITING = 16
"""A backpack that holds so many senses nothing new: on a machine that is too slow, the site is kept busy and not drowned."""

_RESTS_MS = 8_000
"""A backpack is switched off no sooner after it told a mode: its next life begins in a mode too, and the two must not look like one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Begin:
    side: MeetingSide
    end_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    side: MeetingSide
    boot: BootId


@dataclass(frozen=True, slots=True, kw_only=True)
class _ChangeMode:
    node: NodeId
    number: int


_Happening: TypeAlias = _Begin | _End | _ChangeMode


@dataclass(slots=True, kw_only=True)
class _Life:
    """A backpack from one start to the next."""

    backpack: Backpack
    clock: DriftingClock
    due_ns: int | None = None
    told_mode_ms: int = 0


class Yard:
    """See the module. All instants are nanoseconds since the run began."""

    def __init__(self, config: YardConfig, *, dialects: Sequence[str], ledger: Ledger) -> None:
        pace = QUICK_PACE if config.is_quick else Pace()
        self.dongles: tuple[Dongle, ...] = tuple(
            make_dongle(dialect, index=config.dongles_before + at) for at, dialect in enumerate(dialects)
        )
        self.n_meetings = 0
        """Meetings of which one of ours was to tell first, and did begin to."""
        self.n_left_out = 0
        """Sides that were not sensed for want of memory, or because the backpack was about to be off."""
        self.acknowledged: list[tuple[int, int, NodeId]] = []
        """What the base station has confirmed since it was looked at last: dongle, when the message was sent first, and who sent it."""
        self._config = config
        self._ledger = ledger
        self._meetings = config.meetings(pace)
        self._next_meeting = 0
        self._begins_at_ns: int | None = None
        self._stops_at_ns: int | None = None
        self._backpack_config = BackpackConfig(provisional_ms=round(pace.provisional_s * 1000), status_period_ms=20_000)
        self._radio = Radio(seed=config.seed, config=RadioConfig(loss=config.loss))
        self._nodes = [NodeId(one) for one in range(1, config.n_biobots + 1) if 0 <= self._dongle_of(one) < len(dialects)]
        self._air = Air(self._nodes, radio=self._radio, seed=config.seed)
        self._lives: dict[NodeId, _Life] = {node: self._make_life(node, boot=BootId(1), at_ns=0) for node in self._nodes}
        self._leaving: set[NodeId] = set()
        self._happenings: list[tuple[int, int, _Happening]] = []
        self._order = count()
        self._dues: list[tuple[int, NodeId]] = []
        self._first_sent: dict[tuple[NodeId, int], int] = {}
        self._in_radio: list[Counter[int]] = [Counter() for _ in self.dongles]
        self._forgotten: list[Counter[int]] = [Counter() for _ in self.dongles]
        for node in self._nodes:
            self._join(node, self._dongle_of(node), now_ns=0)
            self._plan(node)
            self._happen(self._mode_change_ns(node, 0), _ChangeMode(node=node, number=0))
        for dongle in self.dongles:
            dongle.start(now_ns=0)

    @property
    def nodes(self) -> Sequence[NodeId]:
        """Biobots of this yard."""
        return self._nodes

    @property
    def is_settled(self) -> bool:
        """Whether everything has been told, and confirmed."""
        return self.has_stopped and not self._happenings and all(life.backpack.is_settled for life in self._lives.values())

    @property
    def has_stopped(self) -> bool:
        """Whether no meeting begins any more."""
        return self._stops_at_ns is not None

    @property
    def n_waiting(self) -> int:
        """Encounters that backpacks hold."""
        return sum(life.backpack.n_buffered for life in self._lives.values())

    @property
    def n_dropped(self) -> int:
        """Encounters that found no room in their backpack's memory, and so were never told."""
        return sum(life.backpack.n_dropped for life in self._lives.values())

    def home_of(self, node: NodeId) -> int:
        """Return the dongle that a biobot belongs to."""
        home = self._air.home_of(node)
        assert home is not None, "everybody has a home from the start"
        return home

    def begin(self, at_ns: int) -> None:
        """Let the first meeting begin at ``at_ns``, and the others in their order."""
        self._begins_at_ns = at_ns

    def stop(self, at_ns: int) -> None:
        """Let no meeting begin after ``at_ns``, and no mode change; meetings under way come to their end."""
        self._stops_at_ns = at_ns
        self._happenings = [one for one in self._happenings if one[0] <= at_ns or isinstance(one[2], _End)]
        heapq.heapify(self._happenings)

    def step(self, now_ns: int) -> None:
        """Do everything that is due by now."""
        self._schedule(now_ns)
        while self._happenings and self._happenings[0][0] <= now_ns:
            at_ns, _, happening = heapq.heappop(self._happenings)
            self._live_through(happening, at_ns=at_ns, now_ns=now_ns)
        self._deliver(now_ns)
        while self._dues and self._dues[0][0] <= now_ns:
            due_ns, node = heapq.heappop(self._dues)
            life = self._lives[node]
            if life.due_ns == due_ns:
                self._apply(node, life.backpack.poll(now_ms=life.clock.read_ms(now_ns)), now_ns=now_ns)
        for dongle in self.dongles:
            deadline_ns = dongle.next_deadline_ns()
            if deadline_ns is not None and deadline_ns <= now_ns:
                dongle.handle_deadline(now_ns=now_ns)
        self._ledger.flush()
        self._launch_requests(now_ns)

    def next_due_ns(self) -> int:
        """Return when ``step`` is to be called at the latest."""
        dues = []
        if self._begins_at_ns is not None and not self.has_stopped:
            dues.append(self._begins_at_ns + int(self._next_meeting / self._config.rate * NS_PER_S))
        dues += [self._dues[0][0]] if self._dues else []
        dues += [self._happenings[0][0]] if self._happenings else []
        others = [self._air.next_arrival_ns(), *(dongle.next_deadline_ns() for dongle in self.dongles)]
        return min([*dues, *(due for due in others if due is not None)], default=1 << 62)

    def feed(self, chunk: bytes, *, dongle: int, now_ns: int) -> None:
        """Take bytes from the gateway."""
        self.dongles[dongle].feed(chunk, now_ns=now_ns)
        self._launch_requests(now_ns)

    def reset(self, dongle: int, *, now_ns: int) -> None:
        """Let a dongle start anew, without anything that it held in memory; what its radio is about to confirm is of no use to it."""
        self._in_radio[dongle].subtract(request.handle for request in self.dongles[dongle].requests)
        self._forgotten[dongle] += +self._in_radio[dongle]
        self._in_radio[dongle].clear()
        self.dongles[dongle].requests.clear()
        self.dongles[dongle].start(now_ns=now_ns)

    def move(self, node: NodeId, dongle: int, *, now_ns: int) -> None:
        """Let a biobot walk out of reach of its dongle and join another one."""
        self._join(node, dongle, now_ns=now_ns)
        life = self._lives[node]
        life.backpack.rejoin(now_ms=life.clock.read_ms(now_ns))
        self._plan(node)

    def leave(self, node: NodeId) -> None:
        """Let a backpack sense nothing new, so that it comes to an end with what it has to tell."""
        self._leaving.add(node)

    def stay(self, node: NodeId) -> None:
        """Let a backpack sense again."""
        self._leaving.discard(node)

    def can_restart(self, node: NodeId, *, now_ns: int) -> bool:
        """Whether a backpack holds nothing that would be lost with its life."""
        life = self._lives[node]
        return life.backpack.is_settled and life.clock.read_ms(now_ns) - life.told_mode_ms > _RESTS_MS

    def restart(self, node: NodeId, *, now_ns: int) -> None:
        """Give a backpack a fresh battery: its clock, its numbers and its memory begin anew."""
        boot = BootId(self._lives[node].backpack.boot + 1)
        for key in [key for key in self._first_sent if key[0] == node]:
            del self._first_sent[key]
        self._lives[node] = self._make_life(node, boot=boot, at_ns=now_ns)
        self._leaving.discard(node)
        self._plan(node)

    def _dongle_of(self, node: int) -> int:
        return (node - 1) % self._config.n_dongles - self._config.dongles_before

    def _make_life(self, node: NodeId, *, boot: BootId, at_ns: int) -> _Life:
        drift = 2 * chance.uniform(seed=self._config.seed, biobot=node, stream=_DRIFT, index=0) - 1
        drift_ppb = round(drift * self._config.drift_ppm * 1000)
        clock = DriftingClock(start_ms=-DriftingClock(start_ms=0, drift_ppb=drift_ppb).read_ms(at_ns), drift_ppb=drift_ppb)  # shows 0 now
        backpack = Backpack(
            node=node, boot=boot, eui64=_EUI64_BASE + node, seed=self._config.seed + boot, config=self._backpack_config,
            now_ms=clock.read_ms(at_ns), sense_neighbours=tuple,
        )  # fmt: skip
        return _Life(backpack=backpack, clock=clock)

    def _join(self, node: NodeId, dongle: int, *, now_ns: int) -> None:
        self._air.join(node, dongle)
        self.dongles[dongle].node_joined(self._air.address_of(node), eui64=_EUI64_BASE + node, now_ns=now_ns)

    def _mode_change_ns(self, node: NodeId, number: int) -> int:
        draw = chance.uniform(seed=self._config.seed, biobot=node, stream=_MODE, index=number)
        return round((number + 0.2 + 0.6 * draw) * self._config.mode_period_s * NS_PER_S)

    def _happen(self, at_ns: int, happening: _Happening) -> None:
        heapq.heappush(self._happenings, (at_ns, next(self._order), happening))

    def _schedule(self, now_ns: int) -> None:
        zero_ns = self._begins_at_ns
        if zero_ns is None or self.has_stopped:
            return
        for following, sides in self._meetings.due(self._next_meeting, until_s=(now_ns - zero_ns) / NS_PER_S + _AHEAD_S):
            self._next_meeting = following
            for side in sides:
                if side.node in self._lives:
                    end_ns = zero_ns + round(side.end_s * NS_PER_S)
                    self._happen(zero_ns + round(side.start_s * NS_PER_S), _Begin(side=side, end_ns=end_ns))

    def _live_through(self, happening: _Happening, *, at_ns: int, now_ns: int) -> None:
        match happening:
            case _Begin(side=side, end_ns=end_ns):
                life = self._lives[side.node]
                backpack = life.backpack
                is_full = (
                    backpack.n_buffered > _MOST_WAITING or backpack.n_buffered + backpack.n_open > self._backpack_config.capacity - _SPARE
                )
                if side.node in self._leaving or is_full:
                    self.n_left_out += 1
                    return
                backpack.begin_encounter(side.peer, start_ms=life.clock.read_ms(at_ns), rssi_dbm=side.rssi_dbm)
                self.n_meetings += side.is_first
                self._happen(end_ns, _End(side=side, boot=backpack.boot))
                self._plan(side.node)
            case _End(side=side, boot=boot):
                life = self._lives[side.node]
                if life.backpack.boot == boot:
                    life.backpack.end_encounter(side.peer, end_ms=life.clock.read_ms(at_ns), now_ms=life.clock.read_ms(now_ns))
                    self._plan(side.node)
            case _ChangeMode(node=node, number=number):
                if self.has_stopped:
                    return
                life = self._lives[node]
                if node not in self._leaving:
                    mode = WireMode.S if life.backpack.mode is WireMode.CRW else WireMode.CRW
                    life.backpack.change_mode(mode, WireCause.NATURAL, at_ms=life.clock.read_ms(at_ns))
                    self._plan(node)
                self._happen(self._mode_change_ns(node, number + 1), _ChangeMode(node=node, number=number + 1))

    def _deliver(self, now_ns: int) -> None:
        for arrival in self._air.take_arrived(now_ns):
            match arrival:
                case UplinkArrival(coordinator=dongle, node=node, received=received):
                    self.dongles[dongle].take_from_radio(received, eui64=_EUI64_BASE + node, now_ns=now_ns)
                case DownlinkArrival(node=node, payload=payload, is_broadcast=is_broadcast):
                    life = self._lives[node]
                    effects = life.backpack.receive(payload, now_ms=life.clock.read_ms(now_ns), is_broadcast=is_broadcast)
                    self._apply(node, effects, now_ns=now_ns)
                case SendingDone(coordinator=dongle, handle=handle) if self._forgotten[dongle][handle] > 0:
                    self._forgotten[dongle][handle] -= 1
                case SendingDone(coordinator=dongle, handle=handle, status=status):
                    self._in_radio[dongle][handle] -= 1
                    self.dongles[dongle].confirm(handle, status, now_ns=now_ns)

    def _apply(self, node: NodeId, effects: Sequence[Effect], *, now_ns: int) -> None:
        for effect in effects:
            match effect:
                case Transmission():
                    self._transmit(node, effect, now_ns=now_ns)
                case Acknowledged(sequence=sequence):
                    sent_ns = self._first_sent.pop((node, sequence), None)
                    if sent_ns is not None:
                        self.acknowledged.append((self.home_of(node), sent_ns, node))
                case _:
                    pass  # nobody commands these biobots, and they send no beacons
        self._plan(node)

    def _transmit(self, node: NodeId, sent: Transmission, *, now_ns: int) -> None:
        if sent.is_first and sent.message.__class__ in _NUMBERED:
            self._first_sent[node, sent.sequence] = now_ns
            self._note(node, sent.sequence, sent.message)
        received = RadioReceived(source=self._air.address_of(node), rssi_dbm=_RSSI_DBM, lqi=lqi(_RSSI_DBM), payload=sent.payload)
        self._air.send_up(received, node=node, now_ns=now_ns)

    def _note(self, node: NodeId, sequence: int, message: Uplink) -> None:
        life = self._lives[node]
        boot, t0_ns = life.backpack.boot, self._config.t0_ns
        match message:
            case EncounterBatch(entries=entries):
                for one in entries:
                    start_ns = t0_ns + life.clock.elapsed_ns(one.start_ms)
                    end_ns = t0_ns + life.clock.elapsed_ns(one.start_ms + one.duration_ms)
                    row = (0, node, boot, sequence, one.peer, one.rssi_dbm, one.is_ongoing, one.start_ms, one.duration_ms, start_ns, end_ns)
                    self._ledger.add(row)
            case Status(mode=mode, cause=cause, mode_since_ms=since_ms):
                life.told_mode_ms = since_ms
                since_ns = t0_ns + life.clock.elapsed_ns(since_ms)
                self._ledger.add((1, node, boot, sequence, mode.value, 0, cause.value, since_ms, 0, since_ns, since_ns))

    def _launch_requests(self, now_ns: int) -> None:
        for at, dongle in enumerate(self.dongles):
            while dongle.requests:
                request = dongle.requests.popleft()
                self._in_radio[at][request.handle] += 1
                self._air.send_down(request, coordinator=at, now_ns=now_ns)

    def _plan(self, node: NodeId) -> None:
        life = self._lives[node]
        due_ms = life.backpack.next_due_ms()
        due_ns = None if due_ms is None else life.clock.elapsed_ns(due_ms)
        if life.due_ns != due_ns:
            life.due_ns = due_ns
            if due_ns is not None:
                heapq.heappush(self._dues, (due_ns, node))


_NUMBERED = (EncounterBatch, Status)
