"""Coordinators on CAN buses as transports: several units share one bus, and two threads a bus stand between python-can and the loop.

python-can blocks, so a bus has a thread that receives and one that sends. Each crosses to the event loop in one place. Both queues are
bounded: what comes in for a unit whose reader is ``_MAX_WAITING`` behind is dropped and counted, and its link has it repeated; what goes
out waits one write a unit, the most urgent first, and of a write that was cancelled nothing more goes out. The receiving thread is watched:
where it has died or hangs, reading ends, and with it the port, which is opened anew.
"""

import asyncio
import contextlib
import itertools
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Protocol

from firmware_protocol.framing.can_frame import CanFrame, Direction, RecordReader, encode_record
from firmware_protocol.units import NS_PER_S
from gateway.errors import TransportClosedError, TransportHangsError, TransportOpenError, TransportSilentError
from gateway.log import EventLog
from gateway.transports.can_spec import CanSpec
from gateway.transports.own_thread import OverdueError, call_in_own_thread

_log = EventLog(__name__)

_MAX_WAITING = 2048
"""Frames that wait for a unit's reader at most."""

_POLL_S = 0.1
_WATCH_S = 1.0
_PATIENCE_S = 5.0
_OPEN_TIMEOUT_S = 20.0
"""Of a bus: an slcan adapter may be given 10 s to settle."""
_FIRST_RETRY_S, _LAST_RETRY_S = 0.001, 0.05
_STOP = (-1, 0, (), None, None)
"""Goes before all that waits to be sent, and ends the thread."""

_Job = tuple[int, int, tuple[CanFrame, ...], "asyncio.Future[None] | None", "CanTransport | None"]


class BlockingBus(Protocol):
    """What is needed of a bus; see ``can_bus.CanBus``."""

    faults: Counter[str]

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Wait for a frame."""
        ...

    def send(self, frame: CanFrame) -> bool:
        """Hand a frame over; False: try again."""
        ...

    def close(self) -> None:
        """Close."""
        ...


class CanBuses:
    """The CAN buses that this process has open.

    Parameters
    ----------
    open_bus
        Opens one, in a thread.
    patience_s
        How long a bus may take nothing, or its receiving thread may hang, before the port is closed [s].
    open_timeout_s
        How long its opening is waited for [s].
    """

    def __init__(
        self,
        *,
        open_bus: Callable[[CanSpec], BlockingBus] | None = None,
        patience_s: float = _PATIENCE_S,
        open_timeout_s: float = _OPEN_TIMEOUT_S,
    ) -> None:
        self._open_timeout_s = open_timeout_s
        self._open_bus = open_bus or _open_python_can
        self._patience_s = patience_s
        self._buses: dict[str, _SharedBus] = {}
        self._opening: dict[str, asyncio.Lock] = {}
        """One for each bus, so that one which hangs keeps no other from being opened."""
        self._hanging: dict[str, TransportHangsError] = {}

    async def open(self, spec: CanSpec) -> "CanTransport":
        """Open a unit's port, and its bus where no other unit has it open.

        Raises
        ------
        TransportOpenError
            The bus cannot be opened now, is open with other options, or the unit's port is open.
        """
        async with self._opening.setdefault(spec.bus_name, asyncio.Lock()):
            shared = self._buses.get(spec.bus_name)
            if shared is None or shared.reason:
                bus = await self._open_in_thread(spec)
                shared = self._buses[spec.bus_name] = _SharedBus(bus, spec=spec, patience_s=self._patience_s, on_end=self._forget)
                shared.start()
            return shared.join(spec)

    async def _open_in_thread(self, spec: CanSpec) -> BlockingBus:
        hanging = self._hanging.pop(spec.bus_name, None)
        if hanging is not None and not hanging.is_over():  # begun for another unit of the bus
            self._hanging[spec.bus_name] = hanging
            raise hanging
        try:
            return await call_in_own_thread(
                lambda: self._open_bus(spec), name=f"open {spec.bus_name}", timeout_s=self._open_timeout_s, dispose=lambda bus: bus.close()
            )
        except OverdueError as error:
            hanging = self._hanging[spec.bus_name] = TransportHangsError(
                name=spec.bus_name, timeout_s=self._open_timeout_s, is_over=error.is_over
            )
            raise hanging from error

    def _forget(self, shared: "_SharedBus") -> None:
        if self._buses.get(shared.spec.bus_name) is shared:
            del self._buses[shared.spec.bus_name]


class CanTransport:
    """One unit's port: its records in, records out."""

    def __init__(self, *, name: str, shared: "_SharedBus") -> None:
        self._name = name
        self._shared = shared
        self._waiting: deque[CanFrame] = deque()
        self._arrived = asyncio.Event()
        self._is_waking = False
        self._records = RecordReader()
        self._is_closed = False
        self.n_dropped = 0
        """Frames for which there was no room."""

    @property
    def name(self) -> str:
        """What the port is called."""
        return self._name

    async def read(self) -> bytes:
        """Return the records of all frames that have come, at least one."""
        while not self._waiting:
            self._check()
            self._arrived.clear()
            self._is_waking = False
            if self._waiting:
                break
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(_WATCH_S, self._shared.patience_s)):
                    await self._arrived.wait()
        frames = [self._waiting.popleft() for _ in range(len(self._waiting))]
        return b"".join(map(encode_record, frames))

    async def write(self, data: bytes) -> None:
        """Send the frames whose records these are; return when the controller has them all."""
        self._check()
        frames = tuple(one for one in self._records.feed(data) if isinstance(one, CanFrame))
        if not frames:
            return
        future = self._shared.submit(frames, self)
        try:
            async with asyncio.timeout(2 * self._shared.patience_s):
                await future
        except TimeoutError as error:
            raise TransportSilentError(name=self._name, reason=f"took nothing for {2 * self._shared.patience_s:g} s") from error

    def write_at_once(self, data: bytes) -> bytes:
        """Send nothing: the controller belongs to another thread."""
        return data

    async def aclose(self) -> None:
        """Close; the last unit to go closes the bus."""
        if self._is_closed:
            return
        self._is_closed = True
        await self._shared.leave(self)

    @property
    def is_closed(self) -> bool:
        """Nothing more is to go out for this unit."""
        return self._is_closed

    def put(self, frame: CanFrame) -> bool:
        """Take a frame from the receiving thread; return whether the reader is to be woken."""
        if len(self._waiting) >= _MAX_WAITING:
            self.n_dropped += 1
            return False
        self._waiting.append(frame)
        was_waking, self._is_waking = self._is_waking, True
        return not was_waking

    def wake(self) -> None:
        """Have the reader look, on the loop."""
        self._arrived.set()

    def _check(self) -> None:
        if self._is_closed:
            raise TransportClosedError(name=self._name, reason="closed by this side")
        reason = self._shared.trouble()
        if reason:
            raise TransportClosedError(name=self._name, reason=reason)


class _SharedBus:
    """A bus, its two threads, and the units on it. The receiving thread closes the bus when it ends, for whatever reason."""

    def __init__(self, bus: BlockingBus, *, spec: CanSpec, patience_s: float, on_end: Callable[["_SharedBus"], None]) -> None:
        self.spec = spec
        self.patience_s = patience_s
        self.reason = ""
        """Why it has ended; empty while it runs."""
        self._bus = bus
        self._on_end = on_end
        self._loop = asyncio.get_running_loop()
        self._units: dict[int, CanTransport] = {}
        self._jobs: queue.PriorityQueue[_Job] = queue.PriorityQueue()  # bounded: a unit has one write under way
        self._numbers = itertools.count(1)
        self._stopping = threading.Event()
        self._is_over = asyncio.Event()
        self._last_words = "the receiving thread has died"
        self._beat_ns = time.monotonic_ns()
        self._receiver = threading.Thread(target=self._receive, name=f"{spec.bus_name} in", daemon=True)
        self._sender = threading.Thread(target=self._send, name=f"{spec.bus_name} out", daemon=True)

    def start(self) -> None:
        self._sender.start()
        self._receiver.start()

    def join(self, spec: CanSpec) -> CanTransport:
        ours = (self.spec.is_fd, self.spec.bitrate, self.spec.data_bitrate)
        if (spec.is_fd, spec.bitrate, spec.data_bitrate) != ours:
            reason = "another unit has the bus open with other options; fd, bitrate and dbitrate are the same for all units of a bus"
            raise TransportOpenError(name=spec.name, reason=reason)
        if spec.unit in self._units:
            raise TransportOpenError(name=spec.name, reason="this unit's port is open already")
        transport = self._units[spec.unit] = CanTransport(name=spec.name, shared=self)
        return transport

    async def leave(self, transport: CanTransport) -> None:
        self._units = {unit: one for unit, one in self._units.items() if one is not transport}
        if not self._units:
            self._stopping.set()
            self._end("closed by this side")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self.patience_s):
                    await self._is_over.wait()

    def submit(self, frames: tuple[CanFrame, ...], transport: CanTransport) -> "asyncio.Future[None]":
        future: asyncio.Future[None] = self._loop.create_future()
        self._jobs.put((frames[0].can_id >> 27, next(self._numbers), frames, future, transport))
        return future

    def trouble(self) -> str:
        """Return why nothing more will be received, or an empty string."""
        if not self.reason and not self._receiver.is_alive():
            return self._last_words  # its own call, which says so too, may be on its way
        if not self.reason and time.monotonic_ns() - self._beat_ns > self.patience_s * NS_PER_S:
            self._stopping.set()
            self._end(f"the receiving thread hangs for {self.patience_s:g} s")
            # Its port closed under it may wake the thread; and where closing hangs too, nobody waits for it.
            threading.Thread(target=self._bus.close, name=f"{self.spec.bus_name} close", daemon=True).start()
        return self.reason

    def _receive(self) -> None:
        try:
            while not self._stopping.is_set():
                self._beat_ns = time.monotonic_ns()
                frame = self._bus.receive(_POLL_S)
                if frame is not None and frame.fields.direction == Direction.FROM_COORDINATOR:
                    transport = self._units.get(frame.fields.unit)
                    if transport is not None and transport.put(frame):
                        self._call(transport.wake)
        except TransportClosedError as error:
            self._last_words = error.reason
        except Exception as error:  # noqa: BLE001  # whatever python-can or a driver raises: the port is closed and opened anew
            self._last_words = f"the receiving thread has died of {type(error).__name__}: {error}"
        finally:
            self._stopping.set()
            self._call(self._end, self._last_words)
            self._jobs.put(_STOP)
            self._sender.join(self.patience_s)
            self._bus.close()
            self._call(self._is_over.set)

    def _send(self) -> None:
        while True:
            _, _, frames, future, transport = self._jobs.get()
            if future is None or transport is None:
                return self._fail_rest()
            try:
                for frame in frames:
                    self._send_one(frame, future, transport)
            except TransportClosedError as error:
                self._call(_fail, future, error)
            except Exception as error:  # noqa: BLE001  # same as in receiving
                self._call(_fail, future, TransportClosedError(name=self.spec.bus_name, reason=f"cannot send: {error}"))
            else:
                self._call(_succeed, future)

    def _fail_rest(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                *_, future, _ = self._jobs.get_nowait()
                if future is not None:
                    self._call(_fail, future, TransportClosedError(name=self.spec.bus_name, reason=self.reason or "closed by this side"))

    def _send_one(self, frame: CanFrame, future: "asyncio.Future[None]", transport: CanTransport) -> None:
        """Send a frame of a write that is wanted still; where the controller's queue is full, try again for a while."""
        give_up_ns = time.monotonic_ns() + int(self.patience_s * NS_PER_S)
        pause_s = _FIRST_RETRY_S
        while True:
            if future.cancelled() or transport.is_closed:
                raise TransportClosedError(name=transport.name, reason="closed by this side")
            if self._bus.send(frame):
                return
            if self._stopping.wait(pause_s) or time.monotonic_ns() > give_up_ns:
                reason = f"its queue was full for {self.patience_s:g} s: no other node acknowledges, or the bus is overloaded"
                raise TransportClosedError(name=self.spec.bus_name, reason=self.reason or reason)
            pause_s = min(2 * pause_s, _LAST_RETRY_S)

    def _end(self, reason: str) -> None:
        if self.reason:
            return
        self.reason = reason
        self._jobs.put(_STOP)
        dropped = sum(one.n_dropped for one in self._units.values())
        if dropped or self._bus.faults:
            _log.info("can.closed", bus=self.spec.bus_name, reason=reason, dropped=dropped, faults=dict(self._bus.faults))
        self._on_end(self)
        for transport in self._units.values():
            transport.wake()

    def _call(self, function: Callable[..., None], *arguments: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, *arguments)


def _succeed(future: "asyncio.Future[None]") -> None:
    if not future.done():
        future.set_result(None)


def _fail(future: "asyncio.Future[None]", error: TransportClosedError) -> None:
    if not future.done():
        future.set_exception(error)


def _open_python_can(spec: CanSpec) -> BlockingBus:
    from gateway.transports.can_bus import open_bus  # noqa: PLC0415  # python-can takes a while to load, which only its users pay

    return open_bus(spec)
