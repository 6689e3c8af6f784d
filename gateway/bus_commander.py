"""A commander's end on Zenoh: its liveliness token, its beats, its commands, and what it hears of the biobot it moves.

There is no thread of its own: beats come from whoever calls `CommanderSession.beat`, so that a program that hangs falls silent. Zenoh's
threads only append to a bounded queue.
"""

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Final, Self

import zenoh

from firmware_protocol.contract.commands import CommanderBeat, CommandStage, StimulationAccount, StimulationRequest
from firmware_protocol.contract.keys import Stream, build_key
from firmware_protocol.contract.presence import Kind, build_token_key
from firmware_protocol.contract.records import decode_record, encode_record
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.errors import RecordError
from firmware_protocol.units import NodeId
from gateway.bus_client import find_gateway
from gateway.bus_session import open_client
from gateway.errors import CommandError

BEAT_S: Final = 0.1
"""Pause between two beats; a gateway takes its commander for gone after ``stimulation.commander_silence_s``, 1.2 s by default."""

_HEARD_S: Final = 0.5
"""It is waited so long until somebody hears the beats: a first one that is lost leaves a gateway with the token alone."""

_HEARD_POLL_S: Final = 0.005

_MAX_WAITING: Final = 1024
_TAKEN_CHECK_S: Final = 0.2
_TIMEOUT_S: Final = 30.0

Heard = CommandStage | StimulationAccount | str
"""A stage of a command, how its biobot was stimulated, or in words why there will be no more of either."""


class CommanderSession:
    """A connection to one gateway, with a liveliness token for as long as it is open."""

    def __init__(self, session: zenoh.Session, *, site: str, gateway: str, name: str) -> None:
        self.gateway = gateway
        self.name = name
        self._session = session
        self._site = site
        self._heard: deque[Heard] = deque(maxlen=_MAX_WAITING)
        self._watched: NodeId | None = None
        self._sent: deque[str] = deque(maxlen=_MAX_WAITING)
        self._n_beats = 0
        self._beat_s = float("-inf")
        self._declared: list[Any] = [session.liveliness().declare_token(build_token_key(site=site, kind=Kind.COMMANDER, name=name))]
        self._beats = session.declare_publisher(
            build_key(site=site, stream=Stream.BEAT, gateway=name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    @classmethod
    def open(
        cls, *, name: str, site: str, gateway: str | None, connect: Sequence[str], tls: TlsTable, timing: ZenohTable | None = None
    ) -> Self:
        """Connect, and be there under this name.

        Raises
        ------
        CommandError
            No gateway, or more than one, is there; or a commander of this name is.
        BusError
            Nobody can be connected to.
        """
        session = open_client(connect=connect, tls=tls, timing=timing)
        try:
            found = find_gateway(session, site=site, gateway=gateway, connect=connect)
            _check_free(session, site=site, name=name)
            opened = cls(session, site=site, gateway=found, name=name)
            opened.wait_until_heard()
        except BaseException:
            session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type
            raise
        return opened

    def wait_until_heard(self) -> None:
        """Wait until somebody listens to the beats, or half a second: a gateway older than they are never does."""
        deadline_s = time.monotonic() + _HEARD_S
        while not self._beats.matching_status and time.monotonic() < deadline_s:
            time.sleep(_HEARD_POLL_S)

    def watch(self, node: NodeId) -> None:
        """Hear how a biobot was stimulated, the stages of whatever anybody commands it, and whether the gateway goes."""
        self._watched = node
        account = build_key(site=self._site, stream=Stream.STIMULATION, gateway=self.gateway, node=node)
        stages = build_key(site=self._site, stream=Stream.STAGES, gateway=self.gateway)
        alive = build_key(site=self._site, stream=Stream.ALIVE, gateway=self.gateway)
        self._declared.append(self._session.declare_subscriber(stages, self._take_stage))
        self._declared.append(self._session.declare_subscriber(account, self._take_account))
        self._declared.append(self._session.liveliness().declare_subscriber(alive, self._take_presence))

    def send(self, request: StimulationRequest) -> None:
        """Send a command; its stages are heard. It beats first, since the gateway counts silence from a command on."""
        self.beat(now_s=time.monotonic())
        self._sent.append(request.command_id)
        self._session.get(
            build_key(site=self._site, stream=Stream.COMMAND, gateway=self.gateway),
            self._take_reply,
            payload=encode_record(request),
            timeout=_TIMEOUT_S,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def beat(self, *, now_s: float) -> None:
        """Say that the commander is there, unless it has said so just now; call it more often than every ``BEAT_S`` while it moves any."""
        if now_s - self._beat_s >= BEAT_S:
            self._beat_s = now_s
            self._n_beats += 1
            self._beats.put(encode_record(CommanderBeat(number=self._n_beats)))

    def take(self) -> list[Heard]:
        """Return what was heard since the last call, in order."""
        heard = []
        while self._heard:
            heard.append(self._heard.popleft())
        return heard

    def close(self) -> None:
        """Be there no more."""
        self._session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def _take_reply(self, reply: zenoh.Reply) -> None:
        """Runs on a thread of Zenoh."""
        if reply.ok is not None:
            self._decode(reply.ok.payload.to_bytes(), CommandStage)
        elif reply.err is not None:
            self._heard.append(f"gateway {self.gateway} answers: {reply.err.payload.to_string()}")

    def _take_account(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh."""
        self._decode(sample.payload.to_bytes(), StimulationAccount)

    def _take_stage(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh; of one's own commands the replies tell already."""
        try:
            stage = decode_record(sample.payload.to_bytes(), CommandStage)
        except RecordError:
            return
        if stage.node == self._watched and stage.command_id not in self._sent:
            self._heard.append(stage)

    def _take_presence(self, sample: zenoh.Sample) -> None:
        """Runs on a thread of Zenoh."""
        if sample.kind == zenoh.SampleKind.DELETE:
            self._heard.append(f"gateway {self.gateway} is not there any more")

    def _decode(self, payload: bytes, kind: type[CommandStage] | type[StimulationAccount]) -> None:
        try:
            self._heard.append(decode_record(payload, kind))
        except RecordError as error:
            self._heard.append(f"gateway {self.gateway} says what cannot be read: {error}")


def _check_free(session: zenoh.Session, *, site: str, name: str) -> None:
    token = build_token_key(site=site, kind=Kind.COMMANDER, name=name)
    if any(reply.ok is not None for reply in session.liveliness().get(token, timeout=_TAKEN_CHECK_S)):
        raise CommandError(f"a commander named {name!r} is at site {site!r} already; end it, or take another name with --commander")
