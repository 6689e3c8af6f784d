"""The recordings of a running gateway: one for each radio, over all the times that its port is opened."""

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from gateway.config import RecordingTable
from gateway.recordings.recorder import Recorder, record_to_directory
from gateway.transports.can_port import CanBuses
from gateway.transports.interface import Transport
from gateway.transports.recording import RecordingTransport
from gateway.transports.spec import PortSpec, open_transport, parse_port_spec

_BYTES_PER_MB = 1_000_000


@asynccontextmanager
async def recording_radios(config: RecordingTable, ports: Sequence[str]) -> AsyncIterator[Mapping[str, Recorder]]:
    """Yield a recorder for each radio by its name, or nothing where nothing is recorded; they are closed at the end.

    Raises
    ------
    RecordingError
        The directory cannot be made.
    """
    recorders: dict[str, Recorder] = {}
    async with AsyncExitStack() as stack:
        if config.directory is not None:
            for text in ports:
                spec = parse_port_spec(text)
                recorder = record_to_directory(
                    Path(config.directory), radio=spec.name, port=text, dialect=spec.dialect, max_bytes=int(config.max_mb * _BYTES_PER_MB)
                )
                stack.push_async_callback(asyncio.to_thread, recorder.close)
                recorders[spec.name] = recorder
        yield recorders


async def open_recorded(
    spec: PortSpec, recorder: Recorder | None, *, can_buses: CanBuses | None = None, is_reset: bool = False
) -> Transport:
    """Open a port, and record it where there is a recorder; see ``open_transport``."""
    transport = await open_transport(spec, can_buses=can_buses, is_reset=is_reset)
    return transport if recorder is None else RecordingTransport(transport, take=recorder.take)
