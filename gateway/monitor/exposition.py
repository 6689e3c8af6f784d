"""The gateway's numbers in Prometheus' text format (https://prometheus.io/docs/instrumenting/exposition_formats/).

Names follow Prometheus' rules: base units, counters end in ``_total``. What has no name of its own here is a sample of
``biobot_gateway_events_total`` with its dotted name as the label ``event``, so nothing that is counted is left out.
"""

from collections.abc import Iterable, Iterator
from importlib.metadata import version

from prometheus_client import CollectorRegistry, GCCollector, PlatformCollector, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from gateway.health import DURATION_BOUNDS_S, RadioState
from gateway.vitals import Vitals

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_PREFIX = "biobot_gateway_"

_COUNTERS = {
    "encounter.new": ("encounters", "Encounters that were journaled and published."),
    "encounter.revised": ("encounter_corrections", "Corrections of encounters that were journaled and published."),
    "encounter.reports": ("encounter_reports", "Reports of encounters that biobots sent, each by one side."),
    "mode.new": ("mode_changes", "Mode changes that were journaled and published, with their corrections."),
    "message.repeated": ("repeated_messages", "Messages of biobots that were on disk already, and were acknowledged again."),
    "acknowledge.sent": ("acknowledgements", "Acknowledgements sent to biobots."),
    "acknowledge.not_sent": ("unsent_acknowledgements", "Acknowledgements that no radio took; the biobot repeats."),
    "journal.commits": ("journal_commits", "Groups of writes that the disk has taken."),
    "journal.writes": ("journal_writes", "Writes that the disk has taken."),
    "journal.refused_commits": ("journal_refused_commits", "Attempts to commit that the disk refused."),
    "bus.dropped_puts": ("bus_dropped_publications", "Publications left out because a subscriber is stuck; the history has the records."),
    "bus.failed_puts": ("bus_failed_publications", "Publications that Zenoh refused."),
}
_RADIO_COUNTERS = {
    "radio.bytes_in": ("radio_received_bytes", "Bytes that came from the dongle."),
    "radio.messages_in": ("radio_received_messages", "Radio payloads that came from the dongle."),
    "radio.sessions": ("radio_sessions", "How often the dongle was brought up."),
    "radio.faults": ("radio_faults", "How often the dongle was lost, or could not be opened."),
}
_QUEUES = {
    "journal.waiting": "journal",
    "bus.waiting_puts": "publications",
    "encounters.in_memory": "encounters_in_memory",
}
DURATIONS = {
    "journal.commit": ("journal_commit_seconds", "Time that the disk took for a group of writes, with all attempts."),
    "acknowledge": ("acknowledgement_seconds", "Time from a message's being on disk until its acknowledgement went to a radio."),
    "encounter.error": ("encounter_error_bound_seconds", "Widest error bound of the encounters of one commit."),
    "loop.late": ("event_loop_late_seconds", "How late the event loop came to what was due."),
}


class _Numbers(Collector):
    def __init__(self, vitals: Vitals) -> None:
        self._vitals = vitals

    def collect(self) -> Iterable[Metric]:
        yield from _counters(self._vitals)
        yield from _radios(self._vitals)
        yield from _state(self._vitals)
        yield from _durations(self._vitals)


def make_registry(vitals: Vitals) -> CollectorRegistry:
    """Return what ``expose`` takes its numbers from: the gateway's, the process's and the interpreter's."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Numbers(vitals))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    GCCollector(registry=registry)
    return registry


def expose(registry: CollectorRegistry) -> bytes:
    """Return all numbers as text of ``CONTENT_TYPE``."""
    return generate_latest(registry)


def _counters(vitals: Vitals) -> Iterator[Metric]:
    own, of_radios = vitals.health.own_counters(), vitals.health.radio_counters()
    for name, (metric, about) in _COUNTERS.items():
        yield CounterMetricFamily(_PREFIX + metric, about, value=own.get(name, 0))
    for name, (metric, about) in _RADIO_COUNTERS.items():
        family = CounterMetricFamily(_PREFIX + metric, about, labels=["radio"])
        for radio, counters in of_radios.items():
            family.add_metric([radio], counters.get(name, 0))
        yield family
    about = "All else that is counted, by its name; radio is empty where it is of none."
    family = CounterMetricFamily(f"{_PREFIX}events", about, labels=["event", "radio"])
    for radio, counters in {"": own, **of_radios}.items():
        named = _RADIO_COUNTERS if radio else _COUNTERS
        for event, n in sorted(counters.items()):
            if event not in named:
                family.add_metric([event, radio], n)
    yield family


def _radios(vitals: Vitals) -> Iterator[Metric]:
    up = GaugeMetricFamily(f"{_PREFIX}radio_up", "1 where the radio is up, else 0.", labels=["radio"])
    since = GaugeMetricFamily(f"{_PREFIX}radio_state_since_seconds", "Unix time at which the radio came to its state.", labels=["radio"])
    for radio, condition in vitals.health.radio_conditions().items():
        up.add_metric([radio], float(condition.state is RadioState.UP))
        since.add_metric([radio], condition.since_wall_ns / 1e9)
    yield up
    yield since


def _state(vitals: Vitals) -> Iterator[Metric]:
    disk = vitals.disk
    gauges: list[tuple[str, str, float | None]] = [
        ("start_time_seconds", "Unix time at which the gateway was started.", vitals.started_wall_ns / 1e9),
        ("biobots", "Biobots that are known.", vitals.n_biobots),
        ("journal_head_offset", "Newest offset of the journal.", vitals.head_offset),
        ("journal_fault", "1 while the journal takes nothing, else 0.", float(vitals.journal_fault is not None)),
        ("journal_bytes", "Bytes that the journal's files take.", None if disk is None else disk.journal_bytes),
        ("disk_free_bytes", "Bytes that are free where the journal lies.", None if disk is None else disk.free_bytes),
        ("bus_links", "Zenoh sessions that are connected.", vitals.n_links),
        ("faults", "How much is wrong, as /healthz tells.", len(vitals.faults())),
        ("missing", "How much is missing, as /readyz tells.", len(vitals.missing())),
        ("event_loop_still_seconds", "How long the event loop has not moved.", vitals.still_s),
    ]
    for name, about, value in gauges:
        if value is not None:
            yield GaugeMetricFamily(_PREFIX + name, about, value=value)
    lag = GaugeMetricFamily(f"{_PREFIX}mapper_lag_records", "Records that a mapper has not said to have on its disk.", labels=["mapper"])
    for mapper, offset in sorted(vitals.watermarks.items()):
        lag.add_metric([mapper], max(0, (vitals.head_offset or 0) - offset))
    yield lag
    levels = vitals.health.levels()
    queues = GaugeMetricFamily(f"{_PREFIX}queue_length", "How much waits, or is kept in memory.", labels=["queue"])
    others = GaugeMetricFamily(f"{_PREFIX}level", "All else that goes up and down, by its name.", labels=["name"])
    for name, value in sorted(levels.items()):
        if name in _QUEUES:
            queues.add_metric([_QUEUES[name]], value)
        else:
            others.add_metric([name], value)
    yield queues
    yield others
    build = GaugeMetricFamily(f"{_PREFIX}build_info", "1; the version is in its label.", labels=["version"])
    build.add_metric([version("biobot-gateway")], 1)
    yield build


def _durations(vitals: Vitals) -> Iterator[Metric]:
    observed = vitals.health.durations()
    for name, (metric, about) in DURATIONS.items():
        if name not in observed:
            continue
        n, buckets = 0, []
        for bound, count in zip((*map(str, DURATION_BOUNDS_S), "+Inf"), observed[name].classes, strict=True):
            n += count
            buckets.append((bound, float(n)))
        yield HistogramMetricFamily(_PREFIX + metric, about, buckets=buckets, sum_value=observed[name].sum_s)
