"""A gateway as the mapper sees it: real Zenoh on loopback, a journal in memory, and commands answered by a rule of the test."""

import json
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Self

import zenoh
import zenoh.ext

from firmware_protocol.contract.commands import CommanderBeat, CommandStage, Refusal, Stage, StimulationAccount, StimulationRequest
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.mission_orders import MissionAnswer, MissionOrder
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.recordings import RecordingList
from firmware_protocol.contract.records import (
    Cause,
    EncounterRecord,
    GatewayStatus,
    HistoryRequest,
    JournalRecord,
    MissionPhase,
    MissionRecord,
    Mode,
    ModeRecord,
    NodeStatus,
    RecordBatch,
    Watermark,
    decode_record,
    encode_record,
)
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm

SITE = "local"
BOOT = BootId(1_900_000_000)
ANCHOR_NS = Nanoseconds(1_700_000_000_000_000_000)
S = 1_000_000_000

DEADLINE_NS = 2_000_000_000_000_000_000
Answer = Callable[[StimulationRequest], Iterable[Stage]]


def encounter(
    offset: int,
    *,
    sequence: int | None = None,
    revision: int = 0,
    nodes: tuple[int, int] = (1, 2),
    t_ns: tuple[int, int] = (0, S),
    gateway: str = "gateway1",
    journal: str = "journal1",
    is_void: bool = False,
) -> EncounterRecord:
    return EncounterRecord(
        gateway=gateway,
        journal=journal,
        offset=offset,
        boot=BOOT,
        sequence=offset if sequence is None else sequence,
        revision=revision,
        wall_anchor_ns=ANCHOR_NS,
        node_a=NodeId(nodes[0]),
        node_b=NodeId(nodes[1]),
        t_start_ns=Nanoseconds(t_ns[0]),
        t_end_ns=Nanoseconds(t_ns[1]),
        error_ns=Nanoseconds(1000),
        is_reciprocal=False,
        is_void=is_void,
    )


def mode(
    offset: int,
    *,
    node: int,
    t_ns: tuple[int, int | None],
    mode: Mode = Mode.S,
    cause: Cause = Cause.COMMAND,
    sequence: int | None = None,
    revision: int = 0,
    gateway: str = "gateway1",
    journal: str = "journal1",
    is_halted: bool = False,
) -> ModeRecord:
    return ModeRecord(
        gateway=gateway,
        journal=journal,
        offset=offset,
        boot=BOOT,
        sequence=offset if sequence is None else sequence,
        revision=revision,
        wall_anchor_ns=ANCHOR_NS,
        node=NodeId(node),
        mode=mode,
        cause=cause,
        t_start_ns=Nanoseconds(t_ns[0]),
        t_end_ns=None if t_ns[1] is None else Nanoseconds(t_ns[1]),
        error_ns=Nanoseconds(1000),
        is_halted=is_halted,
    )


def mission(offset: int, *, phase: MissionPhase, t_ns: int, landmarks: tuple[int, ...] = ()) -> MissionRecord:
    return MissionRecord(
        gateway="gateway1",
        journal="journal1",
        offset=offset,
        boot=BOOT,
        sequence=offset,
        revision=0,
        wall_anchor_ns=ANCHOR_NS,
        phase=phase,
        t_start_ns=Nanoseconds(t_ns),
        landmarks=tuple(NodeId(node) for node in landmarks),
    )


def account(node: int, *, gateway: str = "gateway1", n_trains: int = 3, ready_in_ms: int = 0) -> StimulationAccount:
    return StimulationAccount(
        gateway=gateway,
        node=NodeId(node),
        wall_ns=ANCHOR_NS,
        n_trains=n_trains,
        on_ms=300 * n_trains,
        n_trains_in_window=1,
        on_ms_in_window=300,
        window_s=60.0,
        last_train_wall_ns=ANCHOR_NS,
        ready_in_ms=ready_in_ms,
        n_commands=4,
        n_confirmed=3,
        n_unknown=0,
        n_refused=1,
        habituation=0.25,
    )


def batch(
    records: Sequence[JournalRecord], *, gateway: str = "gateway1", journal: str = "journal1", head: int | None = None
) -> RecordBatch:
    newest = max((record.offset for record in records), default=0)
    return RecordBatch(gateway=gateway, journal=journal, head_offset=newest if head is None else head, records=tuple(records))


class FakeGateway:
    """Publishes records, keeps them for history queries, and answers commands."""

    def __init__(self, *, port: int, name: str = "gateway1", journal: str = "journal1", page: int = 500) -> None:
        self.name = name
        self.journal = journal
        self.records: list[JournalRecord] = []
        self.oldest_offset = 1
        self.watermarks: list[Watermark] = []
        self.asked: list[StimulationRequest] = []
        """Each question for a command; a stop is asked again and again where its answer takes long, as on a busy machine."""
        self._n_past = 0
        self.history_requests: list[HistoryRequest] = []
        self.answer: Answer = lambda _request: (Stage.ACCEPTED, Stage.RADIO_CONFIRMED, Stage.BIOBOT_CONFIRMED)
        self.orders: list[MissionOrder] = []
        self.recordings = RecordingList(gateway=name, is_recording=False)
        self.order_answer: Callable[[MissionOrder], tuple[bool, str]] = lambda _order: (True, "")
        self.beats: list[CommanderBeat] = []
        self.commanders: set[str] = set()
        self.refusal = Refusal.GAP
        self.clock: Callable[[], int] = lambda: 0
        self._page = page
        self._lock = threading.Lock()
        config = zenoh.Config()
        settings: dict[str, object] = {
            "mode": "peer",
            "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
            "timestamping/enabled": True,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self._session = zenoh.open(config)
        self._publishers = {
            stream: zenoh.ext.declare_advanced_publisher(
                self._session,
                self._key(stream),
                cache=zenoh.ext.CacheConfig(100),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=0.2, sporadic_heartbeat=None),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for stream in (Stream.ENCOUNTERS, Stream.MODES, Stream.MISSION)
        }
        self._kept: list[Any] = [
            self._session.declare_queryable(self._key(Stream.HISTORY), self._on_history),
            self._session.declare_queryable(self._key(Stream.COMMAND), self._on_command),
            self._session.declare_queryable(self._key(Stream.RECORDINGS), self._on_recordings),
            self._session.declare_subscriber(
                build_key(site=SITE, stream=Stream.WATERMARK, gateway=name, mapper=ANY),
                lambda sample: self.watermarks.append(decode_record(sample.payload.to_bytes(), Watermark)),
            ),
            self._session.declare_queryable(self._key(Stream.ORDERS), self._on_order),
            self._session.declare_subscriber(
                build_key(site=SITE, stream=Stream.BEAT, gateway=ANY),
                lambda sample: self.beats.append(decode_record(sample.payload.to_bytes(), CommanderBeat)),
            ),
            self._session.liveliness().declare_subscriber(
                build_token_key(site=SITE, kind=Kind.COMMANDER, name=ANY), self._on_commander, history=True
            ),
            self._session.liveliness().declare_token(self._key(Stream.ALIVE)),
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_details: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]  # the stub of eclipse-zenoh lacks its return type

    @property
    def commands(self) -> list[StimulationRequest]:
        """The commands that came, in the order in which they first did; a gateway knows one that it has by its id."""
        first: dict[str, StimulationRequest] = {}
        for request in list(self.asked):
            first.setdefault(request.command_id, request)
        return list(first.values())[self._n_past :]

    def forget_commands(self) -> None:
        """Begin anew: what came until now is not among `commands` any more, even if it is asked once more."""
        self._n_past += len(self.commands)

    def journal_records(self, records: Iterable[JournalRecord]) -> None:
        """Write records without publishing them."""
        with self._lock:
            self.records += records

    def drop_before(self, offset: int) -> None:
        """Let the oldest records go, as retention does."""
        with self._lock:
            self.records = [record for record in self.records if record.offset >= offset]
        self.oldest_offset = offset

    def publish(self, records: Sequence[JournalRecord]) -> None:
        """Publish records, each on its stream, without writing them."""
        for stream, kind in ((Stream.ENCOUNTERS, EncounterRecord), (Stream.MODES, ModeRecord), (Stream.MISSION, MissionRecord)):
            chosen = [record for record in records if isinstance(record, kind)]
            if chosen:
                self._publishers[stream].put(encode_record(self._batch(chosen)))

    def has_listener(self, stream: Stream) -> bool:
        """Somebody's subscription to a stream has reached this session; a plain put before that goes nowhere."""
        publisher = self._session.declare_publisher(self._key(stream))
        status: Any = publisher.matching_status  # the stub says bool; it is an object with a bool in it
        is_matched = bool(status.matching)
        publisher.undeclare()  # type: ignore[no-untyped-call]  # as in __exit__
        return is_matched

    @property
    def is_heard(self) -> bool:
        """Somebody listens to everything that is put plainly."""
        return all(self.has_listener(stream) for stream in (Stream.ENCOUNTERS, Stream.STATUS, Stream.EVENTS, Stream.STAGES))

    def publish_bytes(self, stream: Stream, payload: bytes) -> None:
        self._session.put(self._key(stream), payload)

    def publish_status(self, *, head_offset: int | None = None) -> None:
        head = self._head() if head_offset is None else head_offset
        status = GatewayStatus(
            gateway=self.name,
            journal=self.journal,
            boot=BOOT,
            head_offset=head,
            wall_ns=Nanoseconds(self.clock()),
            radios={"pty": "up"},
            counters={"frames": 12},
            oldest_offset=self.oldest_offset,
        )
        self._session.put(self._key(Stream.STATUS), encode_record(status))

    def publish_node(
        self, node: int, *, mode: Mode = Mode.CRW, cause: Cause = Cause.NATURAL, battery_mv: int = 3900, heard_ns: int = 0
    ) -> None:
        status = NodeStatus(
            gateway=self.name,
            radio="pty",
            node=NodeId(node),
            eui64=node,
            boot=BootId(1),
            mode=mode,
            cause=cause,
            battery_mv=battery_mv,
            rssi_dbm=RssiDbm(-61),
            lqi=200,
            last_heard_wall_ns=Nanoseconds(heard_ns),
            buffered=0,
            dropped=0,
        )
        key = build_key(site=SITE, stream=Stream.STATUS, gateway=self.name, node=NodeId(node))
        self._session.put(key, encode_record(status))

    def publish_stage(self, stage: CommandStage) -> None:
        self._session.put(self._key(Stream.STAGES), encode_record(stage), congestion_control=zenoh.CongestionControl.BLOCK)

    def publish_account(self, account: StimulationAccount) -> None:
        key = build_key(site=SITE, stream=Stream.STIMULATION, gateway=self.name, node=account.node)
        self._session.put(key, encode_record(account))

    def be_alive_at(self, site: str) -> None:
        """Be alive at another site, too, as another gateway on the same router is."""
        key = build_key(site=site, stream=Stream.ALIVE, gateway=self.name)
        self._kept.append(self._session.liveliness().declare_token(key))

    def _key(self, stream: Stream) -> str:
        return build_key(site=SITE, stream=stream, gateway=self.name)

    def _head(self) -> int:
        with self._lock:
            return max((record.offset for record in self.records), default=0)

    def _batch(self, records: Sequence[JournalRecord]) -> RecordBatch:
        head = max(self._head(), *(record.offset for record in records)) if records else self._head()
        return RecordBatch(
            gateway=self.name, journal=self.journal, head_offset=head, records=tuple(records), oldest_offset=self.oldest_offset
        )

    def _on_history(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            request = decode_record(query.payload.to_bytes(), HistoryRequest)
            with self._lock:
                self.history_requests.append(request)
                found = sorted(
                    (record for record in self.records if record.offset >= request.from_offset), key=lambda record: record.offset
                )
            found = found[: request.limit]
            for first in range(0, max(1, len(found)), self._page):
                query.reply(self._key(Stream.HISTORY), encode_record(self._batch(found[first : first + self._page])))

    def _on_command(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        request = decode_record(query.payload.to_bytes(), StimulationRequest)
        self.asked.append(request)
        # Answers take their time: Zenoh's own thread must not wait for them.
        threading.Thread(target=self._reply, args=(query, request)).start()

    def _on_recordings(self, query: zenoh.Query) -> None:
        with query:
            query.reply(self._key(Stream.RECORDINGS), encode_record(self.recordings))

    def _on_order(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            order = decode_record(query.payload.to_bytes(), MissionOrder)
            self.orders.append(order)
            is_taken, reason = self.order_answer(order)
            answer = MissionAnswer(
                order_id=order.order_id, gateway=self.name, is_taken=is_taken, phase=MissionPhase.DISPERSION, reason=reason
            )
            query.reply(self._key(Stream.ORDERS), encode_record(answer))

    def _on_commander(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rpartition("/")[2]
        (self.commanders.add if sample.kind == zenoh.SampleKind.PUT else self.commanders.discard)(name)

    def stage_of(self, request: StimulationRequest, stage: Stage, *, part_of: str = "") -> CommandStage:
        """Tell a stage as a gateway does."""
        is_under_way = stage in {Stage.ACCEPTED, Stage.RADIO_CONFIRMED}
        return CommandStage(
            command_id=request.command_id,
            gateway=self.name,
            node=request.node,
            action=request.action,
            stage=stage,
            wall_ns=Nanoseconds(0),
            reason="too soon after the train before" if stage is Stage.REFUSED else "",
            mode=Mode.S if stage is Stage.BIOBOT_CONFIRMED else None,
            operator=request.operator,
            refusal=self.refusal if stage is Stage.REFUSED else None,
            deadline_wall_ns=Nanoseconds(DEADLINE_NS) if is_under_way else None,
            part_of=part_of,
        )

    def _reply(self, query: zenoh.Query, request: StimulationRequest) -> None:
        with suppress(zenoh.ZError), query:  # the story is over, and the session is closed
            for stage in self.answer(request):
                told = self.stage_of(request, stage)
                query.reply(self._key(Stream.COMMAND), encode_record(told))
                self.publish_stage(told)  # a link that takes nothing for a millisecond drops the answer, but not this
