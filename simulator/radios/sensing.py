"""A whole run sensed by beacons: who heard whom, what loggers made of it, what a gateway would put together, and how true that is.

The world's unit of length counts as a metre. Times are the world's: as if every backpack's clock had been fitted without error.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from simulator import draws
from simulator.arenas.arena import Arena
from simulator.draws import Floats
from simulator.errors import ParameterError
from simulator.legs import Indices
from simulator.radios.beacons import BEACON_OCTETS, BeaconSchedule
from simulator.radios.bursts import BurstLoss
from simulator.radios.carrier_sense import CarrierSense
from simulator.radios.channel import Channel
from simulator.radios.medium import Medium, airtime_ns
from simulator.radios.paths import Paths
from simulator.radios.proximity import BRIDGED_PERIODS, EXIT_PER_ENTER, Closed, ProximityConfig, ProximityLogger, unite
from simulator.radios.radio import RadioConfig
from simulator.radios.reception import Fate, Packets, Receiver

_DRIFT_STREAM = 246
_PPB = 1_000_000_000
_NS_PER_S = 1_000_000_000

# Pairs of packet and possible receiver looked at in one block: bounds memory to some hundred megabytes.
_BLOCK = 1_000_000
_MAX_LOOKS = 5_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SensingConfig:
    """How backpacks sense each other.

    Parameters
    ----------
    detection, communication
        r_d, what is near, and r_c, who is a neighbour; losses are counted among neighbours [m].
    period_s
        Time between beacons [s].
    enter_dbm, exit_dbm
        Thresholds [dBm]; None: the median strength at r_d and at 1.15 r_d.
    gap_periods, min_beacons
        As in ProximityConfig, the gap in beacon periods.
    drift_ppm
        Clocks, and so beacon periods, are wrong by up to this, drawn uniformly.
    """

    seed: int
    detection: float
    communication: float
    period_s: float = 1.0
    enter_dbm: float | None = None
    exit_dbm: float | None = None
    gap_periods: float = 1.15
    min_beacons: int = 1
    drift_ppm: float = 20.0
    radio: RadioConfig = field(default_factory=RadioConfig)

    def proximity(self, *, per_s: int) -> ProximityConfig:
        """Make the logger's configuration; ``per_s``: how many of its units of time a second has."""
        enter_dbm, exit_dbm = thresholds(self.radio, detection=self.detection, enter_dbm=self.enter_dbm, exit_dbm=self.exit_dbm)
        gap = round(self.gap_periods * self.period_s * per_s)
        return ProximityConfig(enter_dbm=enter_dbm, exit_dbm=exit_dbm, gap=gap, min_beacons=self.min_beacons)


def thresholds(radio: RadioConfig, *, detection: float, enter_dbm: float | None, exit_dbm: float | None) -> tuple[float, float]:
    """Complete thresholds [dBm] from the median path loss: enter at the detection radius [m], exit at 1.15 of it, but not above enter.

    Enter is at most what is said of a sender so near that power grows no more, else a radius of 1 cm would never be entered.

    Notes
    -----
    A radio that says whole dBm rounds: the radii at which half of all beacons pass move by up to 0.5 dB, 5 % at an exponent of 2.4.
    """
    step = radio.rssi_step_db
    loudest_dbm = radio.median_dbm(0.0)
    said_dbm = step * round(loudest_dbm / step) if step else loudest_dbm
    enter = min(radio.median_dbm(detection), said_dbm) if enter_dbm is None else enter_dbm
    derived_dbm = min(enter, radio.median_dbm(EXIT_PER_ENTER * detection))
    return enter, derived_dbm if exit_dbm is None else exit_dbm


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What ``node`` logged of ``peer`` [ns of the run]."""

    node: int
    peer: int
    start_ns: int
    end_ns: int
    mean_rssi_dbm: float
    n_beacons: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AirReport:
    """What the air did to the beacons.

    Parameters
    ----------
    sent, not_sent
        Beacons that went on the air, and those whose sender never found the channel free.
    load
        Time on the air of all beacons over the time of the run.
    fates
        Of every beacon at every neighbour within the communication radius: counts by lower-case ``Fate``, and ``csma_failure``.
    """

    sent: int
    not_sent: int
    load: float
    fates: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensed:
    """Observations by node, peer and time; encounters ``(start_s, end_s, id1, id2)``, ``id1 < id2``, by start, end and ids; the air."""

    observations: tuple[Observation, ...]
    encounters: tuple[tuple[float, float, int, int], ...]
    air: AirReport


def sense(
    paths: Paths,
    *,
    ids: Sequence[int],
    arena: Arena,
    until_s: float,
    config: SensingConfig,
    off_s: Mapping[int, float] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Sensed:
    """Let everybody send beacons from 0 to ``until_s`` [s] and log those of the others.

    Parameters
    ----------
    ids
        Identities, ascending, below 2^32: those of the rows of ``paths``.
    arena
        Whose walls attenuate, for the whole run.
    off_s
        When backpacks were switched off or lost [s]: from then on they neither send nor hear. By identity; None: never.
    progress
        Called now and then with the instant up to which beacons were looked at [s].

    Raises
    ------
    ParameterError
        The parameters contradict each other, or there would be too many beacons to look at.
    """
    channel = Channel(config.radio, seed=config.seed, ids=ids, arena=arena)
    proximity = config.proximity(per_s=_NS_PER_S)
    off_ns = np.array([round((off_s or {}).get(one, until_s) * _NS_PER_S) for one in ids], dtype=np.int64)
    due_ns, sender = _requests(config, ids=ids, until_s=until_s)
    due_ns, sender = due_ns[due_ns < off_ns[sender]], sender[due_ns < off_ns[sender]]
    if due_ns.size * len(ids) > _MAX_LOOKS:
        most = _MAX_LOOKS // len(ids)
        raise ParameterError(
            name="number of beacons", got=due_ns.size, wanted=f"at most {most} among {len(ids)} biobots; a shorter run or a longer period"
        )
    packets, failed = _send(due_ns, sender, channel=channel, paths=paths, ids=ids, config=config)
    burst = config.radio
    receiver = Receiver(
        seed=config.seed,
        channel=channel,
        n_octets=BEACON_OCTETS,
        bursts=BurstLoss(seed=config.seed, good_s=burst.burst_good_s, bad_s=burst.burst_bad_s) if burst.burst_bad_s else None,
    )
    reach = max(config.communication, channel.reach(proximity.exit_dbm))
    counts = np.zeros(len(Fate), dtype=np.int64)
    heard: list[tuple[Indices, Indices, Indices, Floats]] = []
    block = max(1, _BLOCK // len(ids))
    for first in range(0, packets.sender.size, block):
        subject = np.arange(first, min(first + block, packets.sender.size))
        place = paths.places(packets.start_ns[subject] / _NS_PER_S)
        distance = _distances(place, packets.sender[subject])
        packet, listener = np.nonzero((distance <= reach) & (packets.start_ns[subject, None] < off_ns))
        fate, rssi_dbm, _ = receiver.decide(packets, subject=subject, place=place, packet=packet, receiver=listener)
        counts += np.bincount(fate[distance[packet, listener] <= config.communication], minlength=len(Fate))
        kept = (fate == Fate.HEARD) & (rssi_dbm >= proximity.exit_dbm)
        row = subject[packet[kept]]
        heard.append((listener[kept], packets.sender[row], packets.start_ns[row], rssi_dbm[kept]))
        if progress is not None:
            progress(int(packets.start_ns[subject[-1]]) / _NS_PER_S)
    fates = {fate.name.lower(): int(counts[fate]) for fate in Fate}
    fates["csma_failure"] = sum(
        int((_distances(paths.places(at_ns[k : k + block] / _NS_PER_S), who[k : k + block]) <= config.communication).sum())
        for at_ns, who in [failed]
        for k in range(0, who.size, block)
    )
    load = int((packets.end_ns - packets.start_ns).sum()) / _NS_PER_S / until_s
    observations = _log(heard, ids=ids, proximity=proximity)
    return Sensed(
        observations=tuple(observations),
        encounters=tuple(_merge(observations, bridge_ns=round(BRIDGED_PERIODS * config.period_s * _NS_PER_S))),
        air=AirReport(sent=packets.sender.size, not_sent=failed[1].size, load=load, fates=fates),
    )


def _requests(config: SensingConfig, *, ids: Sequence[int], until_s: float) -> tuple[Indices, Indices]:
    """List when beacons are due [ns], in order, and the row of the sender."""
    schedule = BeaconSchedule(seed=config.seed, period_ns=round(config.period_s * _NS_PER_S))
    node, clock_ns = schedule.all_until(round(until_s * _NS_PER_S), ids=ids)
    rate = 2.0 * draws.uniform(draws.words(seed=config.seed, biobot=node, stream=_DRIFT_STREAM, index=np.zeros_like(node))) - 1.0
    due_ns = clock_ns - (clock_ns * (rate * config.drift_ppm * 1e-6)).astype(np.int64)
    order = np.lexsort((node, due_ns))
    return due_ns[order], np.searchsorted(np.array(ids, dtype=np.uint64), node[order]).astype(np.int64)


def _send(
    due_ns: Indices, sender: Indices, *, channel: Channel, paths: Paths, ids: Sequence[int], config: SensingConfig
) -> tuple[Packets, tuple[Indices, Indices]]:
    """Put beacons on the air; return them, and when and whose could not be sent."""
    if not config.radio.csma:
        order = np.lexsort((due_ns, sender))
        counts = np.bincount(sender, minlength=len(ids))
        number = np.empty(sender.size, dtype=np.int64)
        number[order] = np.arange(sender.size) - np.repeat(np.cumsum(counts) - counts, counts)
        packets = Packets(sender=sender, number=number, start_ns=due_ns, end_ns=due_ns + airtime_ns(BEACON_OCTETS))
        return packets, (np.empty(0, np.int64), np.empty(0, np.int64))
    hears = None
    if config.radio.hidden_nodes:
        hears = CarrierSense(channel, ids=ids, place=lambda row, at_ns: paths.place(row, at_ns / _NS_PER_S))
    medium = Medium(seed=config.seed, hears=hears)
    for at_ns, row in zip(due_ns.tolist(), sender.tolist(), strict=True):
        medium.request(ids[row], at_ns=at_ns, n_octets=BEACON_OCTETS)
    sendings = medium.run_until(1 << 62)
    columns = np.array([(one.start_ns, one.end_ns, one.sender, one.number, one.is_sent) for one in sendings], dtype=np.int64).reshape(-1, 5)
    start_ns, end_ns, who, number, is_sent = columns[np.argsort(columns[:, 0], kind="stable")].T
    row = np.searchsorted(np.array(ids), who)
    sent = is_sent == 1
    packets = Packets(sender=row[sent], number=number[sent], start_ns=start_ns[sent], end_ns=end_ns[sent])
    return packets, (start_ns[~sent], row[~sent])


def _distances(place: Floats, sender: Indices) -> Floats:
    """Return how far all are from the sender of each packet, shape (k, n) [length]; the sender itself is at infinity."""
    every = np.arange(sender.size)
    offset = place - place[every, sender][:, None, :]
    distance: Floats = np.sqrt(offset[:, :, 0] ** 2 + offset[:, :, 1] ** 2)
    distance[every, sender] = np.inf
    return distance


def _log(heard: list[tuple[Indices, Indices, Indices, Floats]], *, ids: Sequence[int], proximity: ProximityConfig) -> list[Observation]:
    """Run every listener's logger over what it heard."""
    empty = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    listener, sender, at_ns, rssi_dbm = (np.concatenate(parts) for parts in zip(empty, *heard, strict=True))
    order = np.lexsort((sender, at_ns, listener))
    columns = [values[order] for values in (sender, at_ns, rssi_dbm)]
    closed: list[tuple[int, Closed]] = []
    ends = np.cumsum(np.bincount(listener, minlength=len(ids))).tolist()
    for to, (first, end) in enumerate(pairwise([0, *ends])):  # one listener at a time: numbers of Python take more memory than arrays
        logger = ProximityLogger(config=proximity)
        for by, at, strength in zip(*(values[first:end].tolist() for values in columns), strict=True):
            closed += [(to, one) for one in logger.hear(ids[by], at=at, rssi_dbm=strength) if isinstance(one, Closed)]
        closed += [(to, one) for one in logger.close_all()]
    return sorted(
        (
            Observation(
                node=ids[to], peer=one.peer, start_ns=one.start, end_ns=one.end, mean_rssi_dbm=one.mean_rssi_dbm, n_beacons=one.n_beacons
            )
            for to, one in closed
        ),
        key=lambda one: (one.node, one.peer, one.start_ns),
    )


def _merge(observations: Sequence[Observation], *, bridge_ns: int) -> list[tuple[float, float, int, int]]:
    """Put both sides' observations of every pair together."""
    of_pair: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for one in observations:
        of_pair.setdefault((min(one.node, one.peer), max(one.node, one.peer)), []).append((one.start_ns, one.end_ns))
    return sorted(
        (start / _NS_PER_S, end / _NS_PER_S, *pair) for pair, spells in of_pair.items() for start, end in unite(spells, bridge=bridge_ns)
    )
