"""Ask Python and C the same of millions of inputs, valid, mutated and random (docs/wire-fuzz.md).

    python -m studies.wire_differences --inputs 10000000

Stops at the first input of which they say different things, prints it, and exits 1. The same seed gives the same inputs.
"""

import argparse
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.crc import append_crc
from firmware_protocol.framing.cobs import encode_frame
from firmware_protocol.layouts import (
    CARRIER_LAYOUTS,
    CODE_SIZES,
    DOWNLINK_LAYOUTS,
    ENVELOPE_LAYOUTS,
    UPLINK_LAYOUTS,
    Field,
    Layout,
)
from hatch_build import find_compiler
from studies.c_wire import Wire, compile_wire
from studies.wire_agreement import (
    Confirm,
    Disagreement,
    Garbage,
    Hear,
    Open,
    Operation,
    Say,
    Wait,
    compare_downlink,
    compare_envelope,
    compare_links,
    compare_stream,
    compare_uplink,
)

_MAX_MUTATIONS = 3
_OPERATIONS_PER_LINK = 100
_FRAMES_PER_STREAM = 10
_ENVELOPES = (*ENVELOPE_LAYOUTS, *CARRIER_LAYOUTS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of one input: how many it counts for, and what is wrong."""

    n_inputs: int = 1
    disagreement: Disagreement | None = None


Trial = Callable[[Wire, random.Random], Outcome]


def draw_value(rng: random.Random, field: Field) -> int:
    """Draw a field's value: half of them at or just outside a limit, or all bits alike."""
    bits = 8 * CODE_SIZES[field.code]
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if field.code.islower() else (0, (1 << bits) - 1)
    if rng.random() < 0.5:
        return rng.randint(low, high)
    edges = [low, high, 0, 1]
    if field.limits is not None:
        edges += [field.limits[0], field.limits[1], field.limits[1]]
        edges.append(rng.choice((field.limits[0] - 1, field.limits[1] + 1)))
    return min(high, max(low, rng.choice(edges)))


def draw_fields(rng: random.Random, fields: tuple[Field, ...]) -> bytes:
    """Draw the octets of fields."""
    return b"".join(struct.pack("<" + field.code, draw_value(rng, field)) for field in fields)


def draw_body(rng: random.Random, layout: Layout) -> bytes:
    """Draw the octets of a message after its header, most of them valid."""
    body = draw_fields(rng, layout.fields)
    if layout.entry:
        least, most = layout.entry_counts
        for _ in range(rng.randint(least, most + (rng.random() < 0.1))):
            body += draw_fields(rng, layout.entry)
    if layout.text_limit is not None:
        body += rng.randbytes(rng.randint(0, layout.text_limit + (rng.random() < 0.1)))
    if layout.has_payload:
        body += rng.randbytes(rng.randint(0, 70))
    return body


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Flip, overwrite, insert, remove or cut a few octets; a third stays as it is."""
    if rng.random() < 1 / 3:
        return data
    out = bytearray(data)
    for _ in range(rng.randint(1, _MAX_MUTATIONS)):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(6):
            case 0 if at < len(out):
                out[at] ^= 1 << rng.randrange(8)
            case 1 if at < len(out):
                out[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
            case 2:
                out[at:at] = rng.randbytes(rng.randint(1, 12))
            case 3:
                del out[at : at + rng.randint(1, 4)]
            case 4:
                del out[at:]
            case _:
                out += rng.randbytes(rng.randint(1, 4))
    return bytes(out)


def draw_payload(rng: random.Random, layouts: tuple[Layout, ...], n_header: int) -> bytes:
    """Draw a radio payload: most have a good checksum, so that what is behind it is looked at."""
    layout = rng.choice(layouts)
    kind = layout.kind or 0
    version = 1 if rng.random() < 0.95 else rng.randrange(256)
    data = mutate(rng, bytes([kind, version]) + rng.randbytes(n_header - 2) + draw_body(rng, layout))
    if rng.random() < 0.03:
        data = rng.randbytes(rng.randint(0, 80))
    return (append_crc(data) if rng.random() < 0.95 else data)[:255]


def try_uplink(wire: Wire, rng: random.Random) -> Outcome:
    """Decode a payload from a backpack, write it again."""
    return Outcome(disagreement=compare_uplink(wire, draw_payload(rng, UPLINK_LAYOUTS, 12)))


def try_downlink(wire: Wire, rng: random.Random) -> Outcome:
    """Decode a payload to a backpack, write it again."""
    return Outcome(disagreement=compare_downlink(wire, draw_payload(rng, DOWNLINK_LAYOUTS, 4)))


def try_envelope(wire: Wire, rng: random.Random) -> Outcome:
    """Decode an envelope, write it again."""
    layout = rng.choice(_ENVELOPES)
    body = mutate(rng, bytes([layout.kind or 0]) + draw_body(rng, layout))
    return Outcome(disagreement=compare_envelope(wire, body[:255]))


def try_stream(wire: Wire, rng: random.Random) -> Outcome:
    """Cut a stream of frames, some damaged, in chunks of any size; every frame counts."""
    pieces = []
    for _ in range(_FRAMES_PER_STREAM):
        size = rng.choice((1, 2, rng.randint(1, 70), rng.randint(1, 70), rng.randint(200, 250), 250))
        body = rng.randbytes(size) if rng.random() < 0.8 else bytes(size)
        frame = encode_frame(body)
        pieces.append(mutate(rng, frame) if rng.random() < 0.5 else frame)
        if rng.random() < 0.05:
            pieces.append(bytes([rng.randint(1, 255)]) * rng.randint(240, 270))
    stream = b"".join(pieces)
    cuts = sorted(rng.randrange(len(stream) + 1) for _ in range(rng.randint(0, 6)))
    chunks = [stream[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    return Outcome(n_inputs=_FRAMES_PER_STREAM, disagreement=compare_stream(wire, chunks))


def draw_operation(rng: random.Random) -> Operation:
    """Draw one of the things that happen to a link; most are what a peer of the same session does."""
    match rng.randrange(12):
        case 0 | 1:
            return Wait(ms=rng.choice((0, 1, 50, 299, 300, 301, 600, 2000, 3000, 6000)))
        case 2 | 3 | 4 | 5:
            return Hear(
                kind=rng.choice((1, 2, 3, 3, 3, 3, 4, 4, 4, 5, 6, rng.randrange(256))),
                session=rng.choice((0, 0, 0, 0, 0, 0, 0, 0, 1, -1, 300)),
                sequence=rng.choice((0, 0, 0, 0, 1, 2, 3, 15, 16, 17, 255)),
                payload=rng.randbytes(rng.choice((0, 1, 1, 1, 5, 246))),
            )
        case 6:
            return Garbage(body=rng.randbytes(rng.randint(0, 12)))
        case 7 | 8 | 9:
            return Say(payload=rng.randbytes(rng.choice((0, 1, 4, 62, 240))), is_urgent=rng.random() < 0.2)
        case 10:
            return Confirm(but=rng.randrange(3))
        case _:
            return Open() if rng.random() < 0.1 else Confirm(but=0)


def try_link(wire: Wire, rng: random.Random) -> Outcome:
    """Do a hundred things to a link of either role; each counts."""
    is_initiator = rng.random() < 0.5
    first: list[Operation] = [
        *([Open()] if is_initiator else []),
        Hear(kind=2 if is_initiator else 1, session=0, sequence=0, payload=b"\x01"),
    ]
    operations = [*first, *(draw_operation(rng) for _ in range(_OPERATIONS_PER_LINK - len(first)))]
    start_ms = rng.choice((0, 2**31 - 3_000, 2**32 - 10_000))
    return Outcome(n_inputs=len(operations), disagreement=compare_links(wire, operations, is_initiator=is_initiator, start_ms=start_ms))


KINDS: dict[str, Trial] = {
    "uplink": try_uplink,
    "downlink": try_downlink,
    "envelope": try_envelope,
    "stream": try_stream,
    "link": try_link,
}


def run(wire: Wire, kind: str, *, n_inputs: int, seed: int) -> tuple[int, float, Disagreement | None]:
    """Try so many inputs of a kind; return how many, the seconds they took, and the first disagreement."""
    trial = KINDS[kind]
    rng = random.Random(f"{seed} {kind}")
    done = 0
    begin = time.perf_counter()
    while done < n_inputs:
        outcome = trial(wire, rng)
        done += outcome.n_inputs
        if outcome.disagreement is not None:
            return done, time.perf_counter() - begin, outcome.disagreement
    return done, time.perf_counter() - begin, None


def make_parser() -> argparse.ArgumentParser:
    """Return the command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.wire_differences", description="Ask Python and C the same of many inputs.")
    parser.add_argument("--inputs", type=int, default=100_000, help="of each kind (100,000)")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), help="which kinds (all)")
    parser.add_argument("--seed", type=int, default=1, help="of the inputs (1)")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign."""
    options = make_parser().parse_args(arguments)
    compiler = find_compiler()
    if compiler is None:
        print("wire_differences: no C compiler here; install gcc, or set CC", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        wire = Wire(compile_wire(Path(folder), compiler=compiler))
        print(f"{'kind':<10}{'inputs':>12}{'valid':>8}{'seconds':>10}{'inputs/s':>12}  result")
        for kind in options.kinds:
            before = wire.n_decoded
            done, seconds, disagreement = run(wire, kind, n_inputs=options.inputs, seed=options.seed)
            result = "agree" if disagreement is None else "DIFFER"
            valid = f"{(wire.n_decoded - before) / done:.0%}" if kind in {"uplink", "downlink", "envelope"} else ""
            print(f"{kind:<10}{done:>12,}{valid:>8}{seconds:>10.1f}{done / seconds:>12,.0f}  {result}", flush=True)
            if disagreement is not None:
                print(disagreement)
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
