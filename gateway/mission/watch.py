"""Whether landmarks stand: by what their biobots report of their mode, and by whom they meet. Pure; its memory is bounded.

Two landmarks that stand cannot begin to meet: where they do, one of the two has moved without saying so. Which one shows when it
contradicts a second landmark. A meeting that only comes and goes at the edge of what radios reach is none that began.
"""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field

from firmware_protocol.contract.records import Cause, EncounterRecord, Mode, ModeRecord, RecordIdentity
from firmware_protocol.messages import LEAVE_RSSI, ConfigurationReport
from firmware_protocol.units import NS_PER_S, NodeId, RssiDbm

SETTLING_NS = 30 * NS_PER_S
"""A landmark's meetings are not judged until it has stood for so long: they may have begun while it still walked."""

EDGE_DB = 6
"""A meeting no louder than this above the threshold at which encounters begin says nothing: fading alone brings it about. Own choice: the
shadowing of docs/radios.md is some decibels."""

UNKNOWN_RSSI = RssiDbm(127)
_CLEAR_NS = 900 * NS_PER_S
"""A contradiction that no second one has joined for so long is forgotten."""

_MAX_PAIRS = 16_384

_Pair = tuple[NodeId, NodeId]


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """A landmark does not stand, and why that is thought. ``is_told``: its own report says so."""

    node: NodeId
    reason: str
    is_told: bool


@dataclass(slots=True, kw_only=True)
class LandmarkWatch:
    """Judges records of landmarks; instants are monotonic ones of this process.

    Parameters
    ----------
    gap_ns
        Two landmarks that met within this do not begin to meet.
    armed_ns
        Nothing that began before is judged: with whom they met before this process began is not known.
    """

    gap_ns: int
    armed_ns: int
    _standing: dict[NodeId, int] = field(default_factory=dict)
    _met: OrderedDict[_Pair, int] = field(default_factory=OrderedDict)
    """When two landmarks last met."""
    _told: dict[NodeId, RecordIdentity] = field(default_factory=dict)
    """The last spell of each that it was doubted for: later revisions of one tell nothing new."""
    _contradictions: dict[_Pair, int] = field(default_factory=dict)
    """When they were found."""

    def set_landmarks(self, landmarks: frozenset[NodeId], *, now_ns: int) -> None:
        """Know who stands now; who is new stands since now."""
        if landmarks == self._standing.keys():
            return
        gone = self._standing.keys() - landmarks
        for node in gone:
            del self._standing[node]
            self._told.pop(node, None)
        for node in landmarks - self._standing.keys():
            self._standing[node] = now_ns
        if gone:  # with whoever moved, what it was in contradiction with is clear
            self._contradictions = {pair: at for pair, at in self._contradictions.items() if not gone & set(pair)}
            self._met = OrderedDict((pair, at) for pair, at in self._met.items() if not gone & set(pair))

    @property
    def watched(self) -> Mapping[NodeId, tuple[NodeId, ...]]:
        """Landmarks that contradict another one, and whom."""
        found: dict[NodeId, tuple[NodeId, ...]] = {}
        for one, other in self._contradictions:
            found[one] = (*found.get(one, ()), other)
            found[other] = (*found.get(other, ()), one)
        return found

    def take_mode(self, record: ModeRecord, *, t_start_ns: int) -> Suspicion | None:
        """Judge a mode: a landmark that stands by our command says so."""
        since_ns = self._standing.get(record.node)
        if since_ns is None or record.t_end_ns is not None or t_start_ns - record.error_ns < since_ns:
            return None
        if (record.mode is Mode.S and record.cause is Cause.COMMAND) or self._told.get(record.node) == record.identity:
            return None
        self._told[record.node] = record.identity
        says = "walks" if record.mode is Mode.CRW else "rests of its own accord"
        return Suspicion(node=record.node, reason=f"it says that it {says}, and nobody has told it to", is_told=True)

    def take_encounter(
        self, record: EncounterRecord, *, t_start_ns: int, t_end_ns: int, enter_dbm: RssiDbm | None, now_ns: int
    ) -> Suspicion | None:
        """Judge a meeting.

        Parameters
        ----------
        t_start_ns, t_end_ns
            Of the record, on this process' clock.
        enter_dbm
            At how much encounters begin, as the two told it; None: not known, and every meeting counts.
        """
        pair = (record.node_a, record.node_b)
        stood_ns = [self._standing.get(node) for node in pair]
        if record.is_void or None in stood_ns:
            return None
        last_ns = self._met.get(pair)
        self._met[pair] = max(t_end_ns, last_ns or t_end_ns)
        self._met.move_to_end(pair)
        while len(self._met) > _MAX_PAIRS:
            self._met.popitem(last=False)
        judged_from_ns = max(self.armed_ns, *(since_ns + SETTLING_NS for since_ns in stood_ns if since_ns is not None))
        has_met = last_ns is not None and t_start_ns - last_ns < self.gap_ns
        if has_met or t_start_ns - record.error_ns < judged_from_ns or self._is_at_the_edge(record, enter_dbm=enter_dbm):
            return None
        self._contradictions = {known: at for known, at in self._contradictions.items() if now_ns - at < _CLEAR_NS}
        self._contradictions[pair] = now_ns
        for node, others in self.watched.items():
            if node in pair and len(others) >= 2:
                met = ", ".join(str(other) for other in sorted(others))
                return Suspicion(node=node, reason=f"it began to meet landmarks {met}, which stand", is_told=False)
        return None

    def _is_at_the_edge(self, record: EncounterRecord, *, enter_dbm: RssiDbm | None) -> bool:
        heard = [side.rssi_dbm for side in record.sides if side.rssi_dbm != UNKNOWN_RSSI]
        return enter_dbm is not None and bool(heard) and max(heard) < enter_dbm + EDGE_DB


def stands_by_command(record: ModeRecord) -> bool:
    """Return whether a record says that its biobot stands now, by our command."""
    return record.mode is Mode.S and record.cause is Cause.COMMAND and record.t_end_ns is None


def threshold_of(*reports: ConfigurationReport | None) -> RssiDbm | None:
    """Return at how much encounters of biobots begin that told these configurations; None: none has told it."""
    found = [report.rssi_enter_dbm for report in reports if report is not None and report.rssi_enter_dbm != LEAVE_RSSI]
    return RssiDbm(min(found)) if found else None
