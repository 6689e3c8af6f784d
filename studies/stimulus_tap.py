"""Between a simulated dongle and its gateway: passes all bytes on, and notes when stimuli go down and when biobots answer them.

What is noted is when the last octet of a frame passed here, on its way to the dongle or from it. The native dialect over TCP.
"""

import asyncio
import struct
import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Self

from firmware_protocol.envelope import RadioReceived, RadioSend, decode_envelope
from firmware_protocol.framing.cobs import CobsDecoder
from firmware_protocol.message_codec import decode_downlink, decode_uplink
from firmware_protocol.messages import Action, MessageFault, Stimulate, StimulateReply

# Kind, session, sequence number (WIRE_FORMAT.md §3.1).
_HEADER: Final = struct.Struct("<BHB")
_DATA: Final = 3
_CHUNK: Final = 65_536


@dataclass(frozen=True, slots=True)
class Passed:
    """A stimulus, or the answer to one. ``node`` is known of answers, ``action`` of stimuli."""

    at_s: float
    command: int
    node: int | None = None
    action: Action | None = None


class StimulusTap:
    """TCP ports for a gateway to open, one in front of each dongle; runs on a thread of its own while its context lasts."""

    def __init__(self, dongles: list[tuple[str, int]]) -> None:
        self.passed: list[Passed] = []
        """In order; appended to by the tap's thread alone."""
        self.ports: list[int] = []
        self._dongles = dongles
        self._loop = asyncio.new_event_loop()
        self._is_up = threading.Event()
        self._thread = threading.Thread(target=self._run, name="stimulus tap")

    def __enter__(self) -> Self:
        self._thread.start()
        self._is_up.wait()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        for dongle in self._dongles:

            async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, dongle: tuple[str, int] = dongle) -> None:
                await self._serve(reader, writer, dongle)

            server = self._loop.run_until_complete(asyncio.start_server(serve, "127.0.0.1", 0))
            self.ports.append(server.sockets[0].getsockname()[1])
        self._is_up.set()
        self._loop.run_forever()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, dongle: tuple[str, int]) -> None:
        from_dongle, to_dongle = await asyncio.open_connection(*dongle)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pass_on(from_dongle, writer))
                group.create_task(self._pass_on(reader, to_dongle))
        except* ConnectionError:
            pass  # one end is gone: the gateway opens the port again, and gets a new line
        finally:
            writer.close()
            to_dongle.close()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        decoder = CobsDecoder()
        while chunk := await reader.read(_CHUNK):
            now_s = time.monotonic()
            writer.write(chunk)
            for body in decoder.feed(chunk):
                if isinstance(body, bytes) and len(body) > _HEADER.size and _HEADER.unpack_from(body)[0] == _DATA:
                    self._note(body[_HEADER.size :], now_s)
            await writer.drain()
        raise ConnectionResetError

    def _note(self, payload: bytes, now_s: float) -> None:
        envelope = decode_envelope(payload)
        if isinstance(envelope, RadioSend):
            down = decode_downlink(envelope.payload)
            if not isinstance(down, MessageFault) and isinstance(down[1], Stimulate):
                self.passed.append(Passed(now_s, down[1].command, action=down[1].action))
        elif isinstance(envelope, RadioReceived):
            up = decode_uplink(envelope.payload)
            if not isinstance(up, MessageFault) and isinstance(up[1], StimulateReply):
                self.passed.append(Passed(now_s, up[1].command, node=up[0].node))
