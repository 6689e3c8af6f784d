"""Eight dongles under load: ``python -m studies.line_load DIRECTORY``, a process of its own that costs little.

The dongles are the simulator's, with their real link layers, on pseudo-terminals and TCP ports; behind each are backpacks that keep every
message until it is acknowledged and repeat it as WIRE_FORMAT.md §5.12 says. Who meets whom is a timetable, not a walk: in each round
every biobot meets the one that stands so many places after it, so what the mapper's store must hold in the end is known without a list.

It speaks in JSON lines: the ports, then ``settled`` when the gateway knows all biobots and their clocks, then (after a line on stdin) the
result. DIRECTORY gets ``timetable.npz``.
"""

import argparse
import json
import os
import selectors
import socket
import sys
import time
import tty
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_protocol.envelope import BROADCAST_ADDRESS, RadioReceived, RadioSend, RadioStatus
from firmware_protocol.message_codec import decode_downlink
from firmware_protocol.messages import Stimulate
from firmware_protocol.units import NS_PER_MS, NS_PER_S, RssiDbm, ShortAddress
from simulator.dongles.choice import make_dongle
from simulator.dongles.interface import Dongle
from studies.loaded_backpack import OUTSTANDING, LoadedBackpack, Timetable
from studies.paced_line import PacedLine

LINES: Final = ("native/pty", "native/tcp", "xbee/pty", "znp/pty", "canfd/tcp", "native/pty", "xbee/tcp", "znp/tcp")
"""Dialect and kind of line of each dongle."""

FIRST_ADDRESS: Final = 0x1000
_EUI64: Final = 0x00124B0000100000
_READ: Final = 65_536
_IDLE_S: Final = 0.001
_ANY_BAUD: Final = 4_000_000
"""What a gateway is told of a line that is as fast as this process reads, so that it does not wait for it."""
_BITS: Final = 10
_CAN_RATES: Final = {"can": 16 / 0.27e-3, "canfd": 72 / 0.43e-3}
"""Octets of records (WIRE_FORMAT.md §10.2) that a bus carries in a second: a classic frame with 8 octets has some 130 bits at 500 kbit/s;
one of CAN FD with 64 takes 0.43 ms at 500 kbit/s and 2 Mbit/s."""
_PACED_PASS_S: Final = 0.0004
_TURN: Final = 8
"""Messages that a dongle takes from the air before the next one has its turn."""


@dataclass(slots=True, kw_only=True)
class LoadedDongle:
    """A dongle, its line, and the backpacks behind it."""

    dongle: Dongle
    port: str
    backpacks: dict[int, LoadedBackpack]
    """By short address."""
    fd: int = -1
    listener: socket.socket | None = None
    connection: socket.socket | None = None
    unwritten: bytes = b""
    turn: list[LoadedBackpack] = field(default_factory=list)
    line: PacedLine | None = None
    """None: as fast as this process reads."""
    air_ns: int = 0
    """How long a payload downwards takes on the air; the next one waits in the dongle."""
    stimuli: list[dict[str, Any]] = field(default_factory=list)
    """Stimulate messages that came down a paced line, not yet told."""
    _air_free_ns: int = 0

    def read(self, now_ns: int) -> None:
        """Take what the gateway has written, and let the backpacks hear it."""
        try:
            if self.line is None:
                self.dongle.feed(os.read(self.fd, _READ), now_ns=now_ns)
            else:
                self._read_paced(self.line, now_ns)
        except (BlockingIOError, OSError):
            return
        while self.dongle.requests and self._air_free_ns <= now_ns:
            self._air_free_ns = max(self._air_free_ns, now_ns - self.air_ns) + self.air_ns
            self._carry_out(self.dongle.requests.popleft(), now_ns)

    def _read_paced(self, line: PacedLine, now_ns: int) -> None:
        for piece in line.read(self.fd, now_ns):
            n_before = len(self.dongle.requests)
            self.dongle.feed(piece.octets, now_ns=now_ns)
            for request in list(self.dongle.requests)[n_before:]:
                decoded = decode_downlink(request.payload)
                if isinstance(decoded, tuple) and isinstance(decoded[1], Stimulate):
                    facts = {"destination": request.destination, "command": decoded[1].command, "action": decoded[1].action.name.lower()}
                    self.stimuli.append(facts | {"written_ns": piece.written_ns, "left_ns": piece.left_ns})

    def _carry_out(self, request: RadioSend, now_ns: int) -> None:
        if request.destination == BROADCAST_ADDRESS:
            for backpack in self.backpacks.values():
                backpack.hear(request.payload, now_ns=now_ns, is_broadcast=True)
            self.dongle.confirm(request.handle, RadioStatus.SENT, now_ns=now_ns)
            return
        addressee = self.backpacks.get(request.destination)
        if addressee is not None:
            addressee.hear(request.payload, now_ns=now_ns)
        self.dongle.confirm(request.handle, RadioStatus.SENT if addressee is not None else RadioStatus.NO_ACK, now_ns=now_ns)

    def say(self, now_ns: int, *, limit: int = _TURN) -> None:
        """Have the backpacks send what is due, one after the other, as far as the dongle has room."""
        for _ in range(limit if self.dongle.is_open and not self.unwritten else 0):
            for at, backpack in enumerate(self.turn):
                payload = backpack.next_payload(now_ns)
                if payload is None:
                    continue
                received = RadioReceived(
                    source=ShortAddress(FIRST_ADDRESS + backpack.node), rssi_dbm=RssiDbm(-61), lqi=190, payload=payload
                )
                if not self.dongle.take_from_radio(received, eui64=backpack.eui64, now_ns=now_ns):
                    backpack.was_refused(now_ns)
                    self.turn = self.turn[at:] + self.turn[:at]
                    return
                backpack.was_taken(now_ns)
                self.turn = self.turn[at + 1 :] + self.turn[: at + 1]
                break
            else:
                return

    def write(self, now_ns: int) -> None:
        """Write what the dongle has to say, as much as the line takes."""
        due_ns = self.dongle.next_deadline_ns()
        if due_ns is not None and now_ns >= due_ns:
            self.dongle.handle_deadline(now_ns=now_ns)
        if self.fd < 0:
            return
        self.unwritten += self.dongle.take_bytes()
        n_room = len(self.unwritten) if self.line is None else self.line.room_up(now_ns)
        if self.unwritten and n_room:
            try:
                n_written = os.write(self.fd, self.unwritten[:n_room])
                self.unwritten = self.unwritten[n_written:]
                if self.line is not None:
                    self.line.note_up(n_written, now_ns)
            except BlockingIOError:
                pass
            except OSError:  # nobody has the line open
                self.unwritten = b""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the load; 0 when all of it was acknowledged."""
    parser = argparse.ArgumentParser(prog="python -m studies.line_load", description=__doc__)
    parser.add_argument("directory", type=Path, help="where pseudo-terminals are linked and the timetable is written")
    parser.add_argument("--encounters", type=float, default=1e5, help="entries that backpacks report, at least (default: %(default)g)")
    parser.add_argument("--rate", type=float, default=0.0, help="entries a second; 0: as fast as they are taken (default: %(default)g)")
    parser.add_argument("--entries", type=int, default=4, choices=(1, 2, 4), help="in each message (default: %(default)s)")
    parser.add_argument("--sides", type=int, default=2, choices=(1, 2), help="how many of the two report a meeting (default: %(default)s)")
    parser.add_argument("--biobots", type=int, default=256, help="behind all dongles together (default: %(default)s)")
    parser.add_argument(
        "--outstanding",
        type=int,
        default=OUTSTANDING,
        help="messages of a biobot that wait for acknowledgement, at most (default: %(default)s)",
    )
    parser.add_argument("--lines", nargs="+", default=LINES, metavar="DIALECT/KIND", help="of the dongles (default: %(default)s)")
    parser.add_argument("--baud", type=int, default=0, help="of serial lines, and what a CAN bus carries likewise; 0: any speed")
    parser.add_argument("--air-ms", type=float, default=0.0, help="that a payload downwards takes on the air (default: %(default)g)")
    options = parser.parse_args(arguments)
    n_sides = min(options.sides, options.entries)  # a message of one entry has room for one side's
    timetable = Timetable(
        n_biobots=options.biobots, n_entries=options.entries, n_sides=n_sides, n_encounters=int(options.encounters), rate=options.rate
    )
    load = _Load(
        directory=options.directory, timetable=timetable, n_outstanding=options.outstanding, lines=options.lines, baud=options.baud,
        air_ms=options.air_ms,
    )  # fmt: skip
    say({"ports": load.ports})
    load.run_until_settled()
    say({"settled": True})
    sys.stdin.readline()
    facts = load.run_to_the_end()
    save_timetable(options.directory / "timetable.npz", timetable)
    say(facts)
    sys.stdin.readline()
    return 0


def save_timetable(path: Path, timetable: Timetable) -> None:
    """Write what a check needs."""
    arrays = timetable.arrays()
    np.savez(path, shape=arrays["shape"], round_ns=arrays["round_ns"], sent_ns=arrays["sent_ns"])


def say(facts: dict[str, Any]) -> None:
    """Print one line for whoever started this process."""
    print(json.dumps(facts), flush=True)


class _Load:
    """All dongles, on one selector."""

    def __init__(
        self, *, directory: Path, timetable: Timetable, n_outstanding: int, lines: Sequence[str], baud: int, air_ms: float
    ) -> None:
        self._selector = selectors.DefaultSelector()
        self._timetable = timetable
        self._is_paced = bool(baud)
        members: list[dict[int, LoadedBackpack]] = [{} for _ in lines]
        for node in range(1, timetable.n_biobots + 1):
            backpack = LoadedBackpack(node=node, eui64=_EUI64 + node, timetable=timetable, n_outstanding=n_outstanding)
            members[node % len(lines)][FIRST_ADDRESS + node] = backpack
        self.dongles = [
            _open_line(line, index=index, directory=directory, backpacks=backpacks, baud=baud)
            for index, (line, backpacks) in enumerate(zip(lines, members, strict=True))
        ]
        for one, name in zip(self.dongles, lines, strict=True):
            one.air_ns = int(air_ms * NS_PER_MS)
            one.line = PacedLine(bytes_per_s=_CAN_RATES.get(name.split("/")[0], baud / _BITS)) if baud else None
        for one in self.dongles:
            one.dongle.start(now_ns=time.monotonic_ns())
            if one.listener is not None:
                self._selector.register(one.listener, selectors.EVENT_READ, one)
            else:
                self._selector.register(one.fd, selectors.EVENT_READ, one)
        self._backpacks = [backpack for one in self.dongles for backpack in one.backpacks.values()]

    @property
    def ports(self) -> list[str]:
        """What a gateway calls the lines."""
        return [one.port for one in self.dongles]

    def run_until_settled(self) -> None:
        """Serve until the gateway knows every biobot and has asked for its clock."""
        while not all(backpack.is_settled for backpack in self._backpacks):
            self._pass()

    def run_to_the_end(self) -> dict[str, Any]:
        """Go through the timetable; return what it took."""
        timetable = self._timetable
        begun_ns = time.monotonic_ns()
        timetable.begin(begun_ns)
        cpu_s = time.process_time()
        while not all(backpack.is_done for backpack in self._backpacks):
            timetable.slowest = min(backpack.n_begun for backpack in self._backpacks)
            self._pass()
        elapsed_s = (time.monotonic_ns() - begun_ns) / NS_PER_S
        return {
            "entries": timetable.n_messages * timetable.n_biobots * timetable.n_entries,
            "messages": timetable.n_messages * timetable.n_biobots,
            "seconds": elapsed_s,
            "cpu_s": time.process_time() - cpu_s,
            "repeats": sum(backpack.n_repeats for backpack in self._backpacks),
            "acknowledgements": sum(backpack.n_acknowledgements for backpack in self._backpacks),
            "begun_ns": begun_ns,
        }

    def _pass(self) -> None:
        if self._is_paced:  # a line that has no room is ready to be read all the time: nobody waits for that
            time.sleep(_PACED_PASS_S)
            for one in self.dongles:
                if one.listener is not None and one.connection is None:
                    self._accept_waiting(one)
                elif one.fd >= 0:
                    one.read(time.monotonic_ns())
                for facts in one.stimuli:
                    say(facts | {"line": one.port, "now_ns": time.monotonic_ns()})
                one.stimuli.clear()
        else:
            self._pass_unpaced()
        for one in self.dongles:
            now_ns = time.monotonic_ns()
            one.say(now_ns)
            one.write(now_ns)

    def _accept_waiting(self, one: LoadedDongle) -> None:
        for key, _ in self._selector.select(0):
            if key.fileobj is one.listener:
                self._accept(one)

    def _pass_unpaced(self) -> None:
        is_idle = all(not one.unwritten for one in self.dongles)
        for key, _ in self._selector.select(_IDLE_S if is_idle else _IDLE_S / 2):
            one: LoadedDongle = key.data
            if one.listener is not None and key.fileobj is one.listener:
                self._accept(one)
            elif key.fd == one.fd:
                one.read(time.monotonic_ns())

    def _accept(self, one: LoadedDongle) -> None:
        assert one.listener is not None
        if one.connection is not None:
            self._selector.unregister(one.fd)
            one.connection.close()
        one.connection, _ = one.listener.accept()
        one.connection.settimeout(0)
        one.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        one.fd, one.unwritten = one.connection.fileno(), b""
        self._selector.register(one.fd, selectors.EVENT_READ, one)


def _open_line(line: str, *, index: int, directory: Path, backpacks: dict[int, LoadedBackpack], baud: int) -> LoadedDongle:
    dialect, kind = line.split("/")
    dongle = make_dongle(dialect, index=index)
    turn = list(backpacks.values())
    if kind == "tcp":
        listener = socket.create_server(("127.0.0.1", 0))
        port = f"tcp:127.0.0.1:{listener.getsockname()[1]}?dialect={dialect}&baud={baud or _ANY_BAUD}"
        return LoadedDongle(dongle=dongle, port=port, backpacks=backpacks, listener=listener, turn=turn)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    link = directory / f"dongle{index}"
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(slave))
    # The slave stays open here too: without a reader a pseudo-terminal reports a hang-up all the time.
    return LoadedDongle(
        dongle=dongle, port=f"serial:{link}?dialect={dialect}&baud={baud or _ANY_BAUD}", backpacks=backpacks, fd=master, turn=turn
    )


if __name__ == "__main__":
    raise SystemExit(main())
