"""How much slower is a healthy radio beside sick ones? ``python -m studies.sick_radios``: one well dongle, alone and in company.

The well dongle hears a payload every 20 ms; what is measured is the time until the gateway, with its journal on disk, has confirmed it
over the line. Then the same with seven sick radios beside it: one floods with noise as fast as TCP takes it, one with questions, an XBee
with payloads; one takes nothing and says nothing, one hangs up at once, one restarts for ever, and one is not there. Absolute times are
this machine's; the ratio is what counts.
"""

import argparse
import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_protocol.dialects.xbee_frames import Receive, encode_xbee
from firmware_protocol.envelope import RadioReceived, encode_envelope
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.framing.xbee import encode_frame as encode_xbee_frame
from firmware_protocol.link import Link, LinkConfig, LinkOpened, LinkState, PayloadConfirmed, Role
from firmware_protocol.message_codec import encode_uplink
from firmware_protocol.messages import Status, UplinkHeader, WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, BootId, Milliseconds, NodeId, RssiDbm, ShortAddress
from simulator.dongles.choice import make_dongle
from studies.ports import free_port

_EVERY_S: Final = 0.02
_NOISE: Final = random.Random(7).randbytes(65_536)
_CONNECT_S: Final = 30.0
_XBEE_OPENS_S: Final = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Latencies:
    """Times from a payload's reception to its confirmation [s], sorted; ``n_unconfirmed``: those that were never confirmed."""

    seconds: tuple[float, ...]
    n_unconfirmed: int

    def percentile_ms(self, share: float) -> float:
        """Return the latency that this share of the payloads does not exceed [ms]."""
        return 1e3 * self.seconds[min(len(self.seconds) - 1, int(share * len(self.seconds)))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 0 where the well radio lost nothing."""
    parser = argparse.ArgumentParser(prog="python -m studies.sick_radios", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement (default: %(default)s)")
    options = parser.parse_args(arguments)
    alone, _ = measure(seconds=options.seconds, sick={})
    beside, log = measure(seconds=options.seconds, sick=SICK)
    print(f"{'well radio':28} {'p50':>8} {'p99':>8} {'max':>8}   payloads")
    for name, one in (("alone", alone), (f"beside {len(SICK) + 1} sick ones", beside)):
        values = " ".join(f"{one.percentile_ms(share):6.1f} ms" for share in (0.5, 0.99, 1.0))
        print(f"{name:28} {values}   {len(one.seconds)}, {one.n_unconfirmed} lost")
    print(f"{'ratio':28} {' '.join(f'{beside.percentile_ms(share) / alone.percentile_ms(share):6.1f}   ' for share in (0.5, 0.99, 1.0))}")
    print(f"lines of the log in {options.seconds:g} s: {len(log)}; of each event: {_events(log)}")
    return int(bool(alone.n_unconfirmed or beside.n_unconfirmed))


def measure(*, seconds: float, sick: "Mapping[str, Sickness]") -> tuple[Latencies, list[str]]:
    """Run a gateway with the well dongle and some sick ones; return what the well one saw, and the gateway's log."""
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        well = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        ports = [f"tcp:127.0.0.1:{well.getsockname()[1]}", *(_serve(stack, one) for one in sick.values())]
        if sick:
            ports.append(f"serial:{directory}/not-there")
        log = directory / "log"
        command = [sys.executable, "-m", "gateway", "run", "--listen", f"tcp/127.0.0.1:{free_port()}", "--journal", f"{directory}/journal"]
        with log.open("w") as stderr:
            process = subprocess.Popen([*command, *(f"--port={port}" for port in ports)], stderr=stderr, cwd=directory, env=_environment())
            try:
                latencies = asyncio.run(_be_well(well, seconds=seconds))
            finally:
                process.send_signal(signal.SIGTERM)
                process.wait(timeout=30)
        return latencies, log.read_text().splitlines()


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}


async def _be_well(server: socket.socket, *, seconds: float) -> Latencies:
    """Be the well dongle: hand a payload over every 20 ms, and note when its confirmation comes."""
    server.settimeout(0)
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(_CONNECT_S):
        connection, _ = await loop.sock_accept(server)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link, decoder = Link(role=Role.RESPONDER, config=LinkConfig(retransmit_ns=60_000 * NS_PER_MS)), CobsDecoder()
    started_s, sent_s, taken, n_sent = time.monotonic(), dict[int, float](), list[float](), 0
    reading = asyncio.ensure_future(loop.sock_recv(connection, 65_536))
    due_s, end_s = started_s, started_s + _CONNECT_S
    try:
        while time.monotonic() < end_s or sent_s:
            now_s = time.monotonic()
            if now_s > end_s + 10:
                break
            if link.state is LinkState.OPEN and due_s <= now_s < end_s:
                sent_s[link.send(_payload(n_sent), now_ns=time.monotonic_ns())] = now_s
                n_sent += 1
                due_s = max(due_s + _EVERY_S, now_s)
            frames = b"".join(map(encode_frame, link.take_frames()))
            if frames:
                await loop.sock_sendall(connection, frames)
            await asyncio.wait({reading}, timeout=max(0.0, min(due_s - time.monotonic(), 0.05)))
            if not reading.done():
                continue
            for body in decoder.feed(reading.result()):
                for event in link.receive(body, now_ns=time.monotonic_ns()) if isinstance(body, bytes) else ():
                    if isinstance(event, LinkOpened):
                        due_s = time.monotonic() + 1.0  # the others have their first troubles then
                        end_s = due_s + seconds
                    elif isinstance(event, PayloadConfirmed) and event.ticket in sent_s:
                        taken.append(time.monotonic() - sent_s.pop(event.ticket))
            reading = asyncio.ensure_future(loop.sock_recv(connection, 65_536))
    finally:
        reading.cancel()
        connection.close()
    return Latencies(seconds=tuple(sorted(taken)), n_unconfirmed=len(sent_s))


def _payload(sequence: int) -> bytes:
    received = RadioReceived(source=ShortAddress(0x1007), rssi_dbm=RssiDbm(-60), lqi=200, payload=_uplink(sequence))
    return encode_envelope(received)


def _uplink(sequence: int) -> bytes:
    header = UplinkHeader(node=NodeId(7), boot=BootId(3), sequence=sequence % 65_536, sent_ms=Milliseconds(1_000 + 20 * sequence))
    status = Status(
        mode=WireMode(sequence % 2),
        cause=WireCause.NATURAL,
        mode_since_ms=Milliseconds(20 * sequence),
        battery_mv=3000,
        buffered=0,
        dropped=0,
    )
    return encode_uplink(header, status)


def _serve(stack: ExitStack, sickness: "Sickness") -> str:
    server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

    def serve() -> None:
        while True:
            try:
                connection, _ = server.accept()
                with connection:
                    sickness.behave(connection)
            except OSError:
                if server.fileno() < 0:
                    return

    threading.Thread(target=serve, daemon=True).start()
    return f"tcp:127.0.0.1:{server.getsockname()[1]}?dialect={sickness.dialect}"


def _flood_with_noise(connection: socket.socket) -> None:
    while True:
        connection.sendall(_NOISE)


def _flood_with_questions(connection: socket.socket) -> None:
    """Open the session that the gateway asks for, and say PING in it for ever."""
    session = b""
    while not session:
        for body in CobsDecoder().feed(connection.recv(4096)):
            if isinstance(body, bytes) and body[0] == 1:
                session = body[1:3]
    connection.sendall(encode_frame(b"\x02" + session + b"\x00\x01"))
    pings = encode_frame(b"\x05" + session + b"\x00") * 4096
    connection.settimeout(None)
    threading.Thread(target=_drain, args=(connection,), daemon=True).start()
    while True:
        connection.sendall(pings)


def _flood_with_payloads(connection: socket.socket) -> None:
    """Be an XBee until it is open, and then hear a biobot without end."""
    dongle = make_dongle("xbee", index=0)
    dongle.start(now_ns=time.monotonic_ns())
    connection.settimeout(0.01)
    opened_s = time.monotonic() + _XBEE_OPENS_S
    while time.monotonic() < opened_s:
        with contextlib.suppress(TimeoutError):
            dongle.feed(connection.recv(4096), now_ns=time.monotonic_ns())
        dongle.handle_deadline(now_ns=time.monotonic_ns())
        connection.sendall(dongle.take_bytes())
    connection.settimeout(None)
    threading.Thread(target=_drain, args=(connection,), daemon=True).start()
    heard = (
        Receive(source64=0x0013A20000001007, source16=0x1007, options=1, payload=_uplink(sequence), endpoints=None)
        for sequence in range(2000)
    )
    flood = b"".join(encode_xbee_frame(encode_xbee(one), is_escaped=True) for one in heard)
    while True:
        connection.sendall(flood)


def _drain(connection: socket.socket) -> None:
    try:
        while connection.recv(65_536):
            pass
    except OSError:
        return


def _stall(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    time.sleep(3_600)


def _hang_up(_connection: socket.socket) -> None:
    return


def _restart_for_ever(connection: socket.socket) -> None:
    decoder = CobsDecoder()
    while data := connection.recv(4096):
        for body in decoder.feed(data):
            if isinstance(body, bytes) and body[0] == 1:
                connection.sendall(encode_frame(b"\x02" + body[1:3] + b"\x00\x01") + encode_frame(b"\x06\x00\x00\x00"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sickness:
    """What a radio does with a connection, and the dialect that the gateway takes it for."""

    behave: Callable[[socket.socket], None]
    dialect: str = "native"


SICK: Final = {
    "noise": Sickness(behave=_flood_with_noise),
    "questions": Sickness(behave=_flood_with_questions),
    "payloads": Sickness(behave=_flood_with_payloads, dialect="xbee"),
    "stalled": Sickness(behave=_stall),
    "hangs up": Sickness(behave=_hang_up),
    "restarts": Sickness(behave=_restart_for_ever),
}
"""And one that is not there."""


def _events(log: Sequence[str]) -> str:
    counts: dict[str, int] = {}
    for line in log:
        try:
            event = str(json.loads(line)["event"])
        except (ValueError, KeyError):
            event = line[:60]
        counts[event] = counts.get(event, 0) + 1
    return ", ".join(f"{event} {count}" for event, count in sorted(counts.items()))


if __name__ == "__main__":
    sys.exit(main())
