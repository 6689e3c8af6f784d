"""How many sound frames are lost to the damage of others: ``python -m studies.resync``.

Of 4,000 frames of each dialect 2 % are damaged: in each a bit is turned, a byte is lost, a byte comes in, or its end is cut off, at a
random place. The stream goes through each framing in pieces of 64 bytes. Told is how many of the frames that nothing happened to do not
come out, and how many came out that nobody sent (checksums of eight bits let one damaged frame in 256 pass); other libraries get the very
same streams. Those that are not installed are left out (``make wire-peers``).
"""

import argparse
import random
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.framing.interface import FrameFault
from studies.errors import StudyError
from studies.wire_framings import FRAMINGS, WireFraming
from studies.wire_peers import DEFAULT_PYTHON, PEERS, PeerProgram, start_peers
from studies.wire_samples import BODY_OF, make_payloads

_CHUNK = 64
MOST_LOST = 4
"""Intact frames that one kind of damage may cost in one stream."""


def _turn_bit(frame: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    return frame[:at] + bytes([frame[at] ^ 1 << draw.randrange(8)]) + frame[at + 1 :]


def _drop_byte(frame: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    return frame[:at] + frame[at + 1 :]


def _insert_byte(frame: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    return frame[:at] + bytes([draw.randrange(256)]) + frame[at:]


def _cut_short(frame: bytes, draw: random.Random) -> bytes:
    return frame[: draw.randrange(1, len(frame))]


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "bit turned": _turn_bit, "byte lost": _drop_byte, "byte inserted": _insert_byte, "cut short": _cut_short
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """A stream with damage: what goes over the line, and the bodies of the frames that are intact."""

    chunks: tuple[bytes, ...]
    intact: frozenset[bytes]
    sent: frozenset[bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """What a decoder made of a stream: intact frames that it lost, and frames that it made up."""

    lost: int
    made_up: int


def make_stream(framing: WireFraming, damage: str, *, n_frames: int, share: float, seed: int) -> Stream:
    """Damage a share of ``n_frames`` frames; which ones and how depends on the arguments alone."""
    draw = random.Random(f"{seed} {framing.name} {damage}")
    body_of = BODY_OF[framing.name.split(",")[0]]
    bodies = [body_of(payload, count) for count, payload in enumerate(make_payloads(n_frames, seed=seed))]
    hit = set(draw.sample(range(n_frames), round(share * n_frames)))
    frames = [framing.encode(body) for body in bodies]
    line = b"".join(DAMAGES[damage](frame, draw) if count in hit else frame for count, frame in enumerate(frames))
    return Stream(
        chunks=tuple(line[at : at + _CHUNK] for at in range(0, len(line), _CHUNK)),
        intact=frozenset(body for count, body in enumerate(bodies) if count not in hit),
        sent=frozenset(bodies),
    )


def measure_ours(framing: WireFraming, stream: Stream) -> Loss:
    """Let our decoder take the stream."""
    decoder = framing.make_decoder()
    found = [body for chunk in stream.chunks for body in decoder.feed(chunk) if not isinstance(body, FrameFault)]
    return _compare(found, stream)


def measure_peer(peer: PeerProgram, stream: Stream) -> Loss:
    """Let another library take the stream."""
    return _compare(peer.decode(stream.chunks)[0], stream)


def _compare(found: Sequence[bytes], stream: Stream) -> Loss:
    got = set(found)
    return Loss(lost=len(stream.intact - got), made_up=len(got - stream.sent))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; return the exit status: 0 done, 1 ours lost more than it may, 2 bad usage."""
    parser = argparse.ArgumentParser(prog="python -m studies.resync", description="Sound frames lost to the damage of others.")
    parser.add_argument("--frames", type=int, default=4000, metavar="N", help="frames of each stream (default: %(default)s)")
    parser.add_argument("--share", type=float, default=0.02, metavar="P", help="share of them that is damaged (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="streams of each kind (default: %(default)s)")
    parser.add_argument("--peers", type=Path, default=DEFAULT_PYTHON, metavar="PYTHON", help="with zigpy in it (default: %(default)s)")
    options = parser.parse_args(arguments)
    if not 100 <= options.frames <= 1_000_000 or not 0 < options.share <= 0.5 or options.seeds < 1:
        given = f"--frames {options.frames} --share {options.share} --seeds {options.seeds}"
        parser.error(f"{given}; wanted 100 to 1000000 frames, a share above 0 up to 0.5, and at least one seed")
    peers = start_peers(options.peers)
    n_too_many = 0
    print(f"{options.frames} frames, {100 * options.share:g} % damaged, {options.seeds} streams of each kind:")
    print("intact frames lost in the best and the worst of them (frames made up in all)\n")
    print(f"| framing | {' | '.join(DAMAGES)} |\n|---|{'---|' * len(DAMAGES)}")
    try:
        for name in FRAMINGS:
            rows = _measure(name, peers, n_frames=options.frames, share=options.share, n_seeds=options.seeds)
            n_too_many += sum(loss.lost > MOST_LOST for losses in rows[name].values() for loss in losses)
            for row, by_damage in rows.items():
                print(f"| {row} | {' | '.join(map(_shown, by_damage.values()))} |", flush=True)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finally:
        for peer in peers.values():
            peer.close()
    if n_too_many:
        print(f"\nerror: {n_too_many} streams lost more than {MOST_LOST} intact frames to the damage of others", file=sys.stderr)
    return 1 if n_too_many else 0


def _measure(name: str, peers: Mapping[str, PeerProgram], *, n_frames: int, share: float, n_seeds: int) -> dict[str, dict[str, list[Loss]]]:
    """Return the losses of ours, under the framing's name, and of its peers, by damage."""
    beside = {peer: program for peer, program in peers.items() if PEERS[peer] == name}
    rows: dict[str, dict[str, list[Loss]]] = {row: {damage: [] for damage in DAMAGES} for row in (name, *beside)}
    for damage in DAMAGES:
        for seed in range(1, n_seeds + 1):
            stream = make_stream(FRAMINGS[name], damage, n_frames=n_frames, share=share, seed=seed)
            rows[name][damage].append(measure_ours(FRAMINGS[name], stream))
            for peer, program in beside.items():
                rows[peer][damage].append(measure_peer(program, stream))
    return rows


def _shown(losses: Sequence[Loss]) -> str:
    lost = [loss.lost for loss in losses]
    return f"{min(lost)}–{max(lost)} ({sum(loss.made_up for loss in losses)})"


if __name__ == "__main__":
    sys.exit(main())
