"""How fast frames are decoded, beside other programs: ``python -m studies.bench_wire``.

Streams of encounter batches with one encounter each (24 bytes of radio payload) are decoded from memory, in chunks. Told is processor time
on one core; programs take turns, and the least time of several rounds counts, so that a busy machine harms all alike and ratios hold. Ours
goes down to the fields of the encounter; of the others only the framing is asked. *The record* is the frame with its checksum, and the
fields of the dialect's header, the payload's header and the encounter, unpacked as they stand; *tuples* are what the codec makes of them,
with the payload's own CRC-16, version, type, length and limits checked. What is not installed is left out (``make wire-peers``).
"""

import argparse
import struct
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from firmware_protocol.dialects.choice import make_host
from firmware_protocol.dialects.interface import PayloadHeard
from firmware_protocol.dialects.xbee_frames import unpack_receive
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.layouts import UPLINK_HEADER, UPLINK_LAYOUTS
from firmware_protocol.message_codec import decode_uplink, decode_uplink_fields
from firmware_protocol.znp.codec import unpack_incoming
from gateway.bulk.columns import UPLINK
from gateway.bulk.decoder import make_decoder, why_plain
from studies.errors import StudyError
from studies.wire_framings import FRAMINGS, WireFraming
from studies.wire_peers import DEFAULT_PYTHON, PeerProgram, start_peers
from studies.wire_samples import BODY_OF, make_payloads

_BULK_CHUNK = 1 << 20
_BULK_FRAMES = 50_000
"""Frames of a bulk row at least: a recording is long."""
_LINK_AND_ENVELOPE = 4 + 5
"""Octets before the payload in a native DATA frame with a RadioReceived (WIRE_FORMAT.md §3.1, §4.5)."""

_ENTRY = next(layout for layout in UPLINK_LAYOUTS if layout.name == "EncounterBatch").entry_packing.format.lstrip("<")
_RECORD = struct.Struct(UPLINK_HEADER.packing.format + _ENTRY)
_XBEE_HEADER, _XBEE_HEADER_SIZE = struct.Struct(">BQHB"), 12  # 0x90: type, source (64 and 16 bits), options (WIRE_FORMAT.md §8.2)
_ZNP_RECORD = struct.Struct("<BBHHHBBBBBIBB" + _RECORD.format.lstrip("<"))  # AF_INCOMING_MSG, in front of the record (§9.2)

Work = Callable[[Sequence[bytes]], int]
"""Decodes a stream in chunks; returns how many records came out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What is timed: one way of decoding a stream of a framing, and the peers that take the same stream."""

    name: str
    framing: str
    work: Work
    is_bare: bool = False
    """Frames carry the radio payload alone."""
    is_bulk: bool = False
    least: float = 0.0
    """Records a second that are wanted; 0: none are said."""
    ratios: Mapping[str, float] = field(default_factory=dict)
    """By peer: how many times as fast ours is wanted to be; 0: nothing is said."""

    def misses(self, ours: float, theirs: Mapping[str, float]) -> list[str]:
        """Return what was wanted and is not reached, given records a second of ours and frames a second of peers."""
        under = [f"{ours / 1e3:.0f} of {self.least / 1e3:.0f} k/s"] if ours < self.least else []
        return under + [
            f"{ours / rate:.1f} of {self.ratios[name]:g} x {name}" for name, rate in theirs.items() if ours < self.ratios[name] * rate
        ]


def _framing_only(framing: WireFraming) -> Work:
    def work(chunks: Sequence[bytes]) -> int:
        feed = framing.make_decoder().feed
        return sum(len(feed(chunk)) for chunk in chunks)

    return work


def _each_body(framing: WireFraming, read: Callable[[bytes], object]) -> Work:
    def work(chunks: Sequence[bytes]) -> int:
        feed, n_records = framing.make_decoder().feed, 0
        for chunk in chunks:
            for body in feed(chunk):
                if not isinstance(body, FrameFault):
                    n_records += type(read(body)) is tuple
        return n_records

    return work


def _unpack_xbee(body: bytes) -> object:
    return _XBEE_HEADER.unpack_from(body) + _RECORD.unpack_from(body, _XBEE_HEADER_SIZE)


def _read_xbee(body: bytes) -> object:
    received = unpack_receive(body)
    return None if received is None else decode_uplink_fields(received[3])


def _read_znp(body: bytes) -> object:
    incoming = unpack_incoming(body)
    return None if incoming is None else decode_uplink_fields(incoming[3])


def _read_link(body: bytes) -> object:
    return decode_uplink_fields(body[_LINK_AND_ENVELOPE:])


def _bulk(*, is_bare: bool) -> Work:
    def work(chunks: Sequence[bytes]) -> int:
        feed = make_decoder(is_bare=is_bare).feed
        return sum(feed(chunk).status.count(UPLINK) for chunk in chunks)

    return work


def _whole_host(chunks: Sequence[bytes]) -> int:
    """Let the native host open a session with bytes of its own making, and take the stream within it, acknowledging."""
    host, n_records = make_host("native"), 0
    host.open(session=0x1234, now_ns=0)
    host.feed(FRAMINGS["native"].encode(bytes((2, 0x34, 0x12, 0))), now_ns=0)  # RESET_ACK (WIRE_FORMAT.md §3.1)
    for chunk in chunks:
        for event in host.feed(chunk, now_ns=0):
            if isinstance(event, PayloadHeard):
                n_records += isinstance(decode_uplink(event.received.payload), tuple)
                host.confirm(event.receipt)
        host.take_frames()
    return n_records


def make_rows() -> list[Row]:
    """Return all rows, in the order of the table."""
    native, xbee_1, xbee_2, znp = (FRAMINGS[name] for name in ("native", "xbee, AP=1", "xbee, AP=2", "znp"))
    return [
        Row(name="framing alone", framing="native", work=_framing_only(native)),
        Row(name="to tuples", framing="native", work=_each_body(native, decode_uplink_fields), is_bare=True, least=800e3),
        Row(name="to message objects", framing="native", work=_each_body(native, decode_uplink), is_bare=True, least=400e3),
        Row(name="in bulk, to columns", framing="native", work=_bulk(is_bare=True), is_bare=True, is_bulk=True, least=3e6),
        Row(name="in bulk, with link and envelope", framing="native", work=_bulk(is_bare=False), is_bulk=True),
        Row(name="with link and envelope, to tuples", framing="native", work=_each_body(native, _read_link)),
        Row(name="the whole host, to message objects", framing="native", work=_whole_host),
        Row(name="framing alone", framing="xbee, AP=1", work=_framing_only(xbee_1)),
        Row(name="down to the record", framing="xbee, AP=1", work=_each_body(xbee_1, _unpack_xbee), ratios={"digi-xbee-1": 25}),
        Row(name="to tuples", framing="xbee, AP=1", work=_each_body(xbee_1, _read_xbee), ratios={"digi-xbee-1": 0}),
        Row(name="framing alone", framing="xbee, AP=2", work=_framing_only(xbee_2)),
        Row(
            name="down to the record", framing="xbee, AP=2", work=_each_body(xbee_2, _unpack_xbee), least=300e3,
            ratios={"zigpy-xbee": 5, "digi-xbee-2": 25},
        ),
        Row(name="to tuples", framing="xbee, AP=2", work=_each_body(xbee_2, _read_xbee), ratios={"zigpy-xbee": 0, "digi-xbee-2": 0}),
        Row(name="framing alone", framing="znp", work=_framing_only(znp), ratios={"zigpy-znp": 0}),
        Row(
            name="down to the record", framing="znp", work=_each_body(znp, _ZNP_RECORD.unpack_from), least=300e3, ratios={"zigpy-znp": 15}
        ),
        Row(name="to tuples", framing="znp", work=_each_body(znp, _read_znp), ratios={"zigpy-znp": 0}),
        *(Row(name="to tuples", framing=name, work=_each_body(FRAMINGS[name], _read_link)) for name in ("can", "canfd")),
    ]  # fmt: skip


def time_row(row: Row, peers: Mapping[str, PeerProgram], *, n_frames: int, chunk: int, rounds: int) -> tuple[float, dict[str, float]]:
    """Return records a second of ours, and frames a second of each peer, by the least processor time of several rounds in turns.

    Raises
    ------
    StudyError
        Somebody did not find every frame, or a peer ended.
    """
    framing, body_of = FRAMINGS[row.framing], BODY_OF[row.framing.split(",")[0]]
    n_frames = max(n_frames, _BULK_FRAMES) if row.is_bulk else n_frames
    payloads = make_payloads(n_frames)
    line = b"".join(framing.encode(payload if row.is_bare else body_of(payload, count)) for count, payload in enumerate(payloads))
    size = _BULK_CHUNK if row.is_bulk else chunk
    chunks = [line[at : at + size] for at in range(0, len(line), size)]
    ours, theirs = float("inf"), {name: float("inf") for name in row.ratios if name in peers}
    for _ in range(rounds):
        begin = time.process_time()
        n_found = row.work(chunks)
        ours = min(ours, time.process_time() - begin)
        _check(f"ours, {row.framing}, {row.name}", n_found, n_frames)
        for name, least in theirs.items():
            found, seconds = peers[name].decode(chunks)
            theirs[name] = min(least, seconds)
            _check(name, len(found), n_frames)
    return n_frames / ours, {name: n_frames / seconds for name, seconds in theirs.items()}


def _check(name: str, n_found: int, n_frames: int) -> None:
    if n_found != n_frames:
        raise StudyError(f"{name} found {n_found} of {n_frames} frames; their speeds cannot be compared")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; return the exit status: 0 done, 1 somebody failed, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.bench_wire", description="How fast frames are decoded, beside other programs.")
    parser.add_argument("--rounds", type=int, default=9, metavar="N", help="rounds, of which the best counts (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=4000, metavar="N", help="frames of each stream (default: %(default)s)")
    parser.add_argument("--chunk", type=int, default=4096, metavar="B", help="bytes that come at once, but in bulk (default: %(default)s)")
    parser.add_argument("--peers", type=Path, default=DEFAULT_PYTHON, metavar="PYTHON", help="with zigpy in it (default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or not 1 <= options.frames <= 65_536 or options.chunk < 1:
        given = f"--rounds {options.rounds} --frames {options.frames} --chunk {options.chunk}"
        parser.error(f"{given}; wanted at least 1 round, 1 to 65536 frames, and chunks of at least 1 byte")
    if (reason := why_plain()) is not None:
        print(f"bulk decoding is slow: {reason}", file=sys.stderr)
    peers = start_peers(options.peers)
    print(f"{options.frames} frames, chunks of {options.chunk} bytes ({_BULK_CHUNK} in bulk), best of {options.rounds}, one core\n")
    print("| framing | decoded | k frames/s | wanted | beside |\n|---|---|---|---|---|")
    all_missed: list[str] = []
    try:
        for row in make_rows():
            ours, theirs = time_row(row, peers, n_frames=options.frames, chunk=options.chunk, rounds=options.rounds)
            beside = "; ".join(
                f"{name} {theirs[name] / 1e3:.0f} k/s: {ours / theirs[name]:.1f} x" + (f" (wanted {wanted:g} x)" if wanted else "")
                for name, wanted in row.ratios.items()
                if name in theirs
            )
            missed = row.misses(ours, theirs)
            all_missed += [f"{row.framing}, {row.name}: {one}" for one in missed]
            wanted = (f"{row.least / 1e3:.0f}" if row.least else "") + (" missed" if missed else "")
            print(f"| {row.framing} | {row.name} | {ours / 1e3:.0f} | {wanted} | {beside} |", flush=True)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finally:
        for peer in peers.values():
            peer.close()
    print("\n" + ("missed: " + "; ".join(all_missed) if all_missed else "all that is wanted is reached"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
