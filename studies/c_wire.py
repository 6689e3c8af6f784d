"""The C side of the wire, compiled for this machine and called through ctypes: what it decodes, as the plain integers Python decodes to.

Nothing here knows the wire format: where a struct keeps its fields follows from the table of layouts and the C compiler's own rules.
"""

import ctypes
import shlex
import struct
import subprocess
from pathlib import Path
from typing import TypeAlias

from firmware_protocol.envelope import EnvelopeFault
from firmware_protocol.framing.cobs import MAX_BODY_SIZE
from firmware_protocol.framing.interface import FrameFault
from firmware_protocol.layouts import (
    CARRIER_LAYOUTS,
    DOWNLINK_HEADER,
    DOWNLINK_LAYOUTS,
    ENVELOPE_LAYOUTS,
    UPLINK_HEADER,
    UPLINK_LAYOUTS,
    Field,
    Layout,
)
from firmware_protocol.messages import MessageFault
from studies.errors import StudyError

SOURCES = Path(__file__).resolve().parents[1] / "firmware_protocol" / "c"
FLAGS = ("-std=c11", "-O2", "-fPIC", "-shared", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-DBB_LINK_INITIATOR=1")

Values: TypeAlias = tuple[int, ...]
Decoded: TypeAlias = tuple[Values, Values, tuple[Values, ...] | bytes]
"""Header, fields, and entries or the octets of text or payload; an empty tuple where there is neither."""

_MESSAGE_FAULTS = (
    None,
    MessageFault.BAD_CRC,
    MessageFault.TOO_LONG,
    MessageFault.UNKNOWN_VERSION,
    MessageFault.UNKNOWN_TYPE,
    MessageFault.BAD_LENGTH,
    MessageFault.BAD_VALUE,
)
_ENVELOPE_FAULTS = (None, None, None, None, EnvelopeFault.UNKNOWN_TYPE, EnvelopeFault.BAD_LENGTH, EnvelopeFault.BAD_VALUE)
_FRAME_FAULTS = (None, None, FrameFault.BAD_CRC, FrameFault.BAD_STUFFING, FrameFault.TOO_SHORT, FrameFault.TOO_LONG)


class CompileError(StudyError):
    """The C sources do not compile here."""


def compile_wire(folder: Path, *, compiler: str) -> Path:
    """Compile everything portable and the port of tests into a shared library in a folder, and return its path.

    Raises
    ------
    CompileError
        The compiler is not there, or has something to say.
    """
    library = folder / "biobot_wire.so"
    sources = [str(path) for path in (*sorted(SOURCES.glob("*.c")), SOURCES / "ports" / "host" / "host_port.c")]
    command = [*shlex.split(compiler), *FLAGS, *sources, "-o", str(library)]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        reason = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        msg = f"the C wire does not compile ({shlex.join(command)}):\n{reason}"
        raise CompileError(msg) from error
    return library


class StructReader:
    """Reads the C struct of one layout out of memory."""

    def __init__(self, layout: Layout) -> None:
        tail = "B" if layout.entry else "PB" if _has_tail(layout) else ""
        self._fields = struct.Struct("@" + "".join(_native(field) for field in layout.fields) + tail)
        self._wide = tuple(index for index, field in enumerate(layout.fields) if field.code == "Q")
        self._n_fields = len(layout.fields)
        self._has_entries = bool(layout.entry)
        self._has_tail = _has_tail(layout)
        largest = max(("B" if code == "b" else code for code in (field.code for field in layout.entry)), key=struct.calcsize, default="B")
        codes = "".join(_native(field) for field in layout.entry)
        self._entry = struct.Struct(f"@{codes}0{largest}")
        step = struct.calcsize(largest)
        self._entries_at = -(-self._fields.size // step) * step

    def read(self, memory: bytes, *, at: int, source: bytes, source_address: int) -> tuple[Values, tuple[Values, ...] | bytes]:
        """Return fields, and entries or text; a text is looked up in what was decoded, into which the struct points."""
        found = list(self._fields.unpack_from(memory, at))
        for index in self._wide:
            found[index] = int.from_bytes(found[index], "little")
        values = tuple(found[: self._n_fields])
        if self._has_entries:
            begin = at + self._entries_at
            size = self._entry.size
            return values, tuple(self._entry.unpack_from(memory, begin + index * size) for index in range(found[-1]))
        if self._has_tail:
            start = found[-2] - source_address
            return values, source[start : start + found[-1]]
        return values, ()


def _has_tail(layout: Layout) -> bool:
    return layout.text_limit is not None or layout.has_payload


def _native(field: Field) -> str:
    return "8s" if field.code == "Q" else field.code


class Wire:
    """The library's functions as functions of bytes. Not for several threads: messages are decoded into memory of this object."""

    def __init__(self, library: Path) -> None:
        self.library = ctypes.CDLL(str(library))
        self.n_decoded = 0
        """Inputs so far that were messages or envelopes."""
        self._memory = ctypes.create_string_buffer(512)
        self._source = ctypes.create_string_buffer(512)
        self._address = ctypes.addressof(self._source)
        self._out = ctypes.create_string_buffer(512)
        self._decode = {name: getattr(self.library, f"bb_decode_{name}") for name in ("uplink", "downlink", "envelope")}
        self._encode = {name: getattr(self.library, f"bb_encode_{name}") for name in ("uplink", "downlink", "envelope")}
        for function in (*self._decode.values(), *self._encode.values()):
            function.restype = ctypes.c_uint8
        self._headers = {"uplink": StructReader(UPLINK_HEADER), "downlink": StructReader(DOWNLINK_HEADER)}
        self._bodies = {
            group: {layout.kind: StructReader(layout) for layout in layouts}
            for group, layouts in (
                ("uplink", UPLINK_LAYOUTS),
                ("downlink", DOWNLINK_LAYOUTS),
                ("envelope", (*ENVELOPE_LAYOUTS, *CARRIER_LAYOUTS)),
            )
        }
        pointer = struct.calcsize("P")  # what a union with a pointer is aligned to
        self._body_at = {"uplink": -(-UPLINK_HEADER.packing.size // pointer) * pointer, "downlink": 4, "envelope": pointer}

    def decode_uplink(self, payload: bytes) -> Decoded | MessageFault:
        """As ``message_codec.decode_uplink_fields``."""
        fault = _MESSAGE_FAULTS[self._run_decode("uplink", payload)]
        return fault or self._read("uplink", payload)

    def decode_downlink(self, payload: bytes) -> Decoded | MessageFault:
        """As ``message_codec.decode_downlink``, in plain integers."""
        fault = _MESSAGE_FAULTS[self._run_decode("downlink", payload)]
        return fault or self._read("downlink", payload)

    def decode_envelope(self, body: bytes) -> Decoded | EnvelopeFault:
        """As ``envelope.decode_envelope``, in plain integers; the header is the type."""
        fault = _ENVELOPE_FAULTS[self._run_decode("envelope", body)]
        return fault or self._read("envelope", body)

    def encode_again(self, group: str, *, size: int = 255) -> bytes:
        """Encode what was decoded last; empty where C refuses."""
        length = self._encode[group](self._memory, self._out, ctypes.c_uint8(size))
        return self._out.raw[:length]

    def encode_frame(self, body: bytes) -> bytes:
        """As ``framing.cobs.encode_frame``; empty where C refuses."""
        assert len(body) <= MAX_BODY_SIZE + 5, "C takes a length of 8 bits"
        self._source[2 : 2 + len(body)] = body  # type: ignore[call-overload]  # an array of characters takes bytes
        length = self.library.bb_frame_encode(self._source, ctypes.c_uint8(len(body)))
        return self._source.raw[:length]

    def frame_decoder(self) -> "FrameDecoder":
        """Return a decoder as ``framing.cobs.CobsDecoder``."""
        return FrameDecoder(self.library)

    def _run_decode(self, group: str, source: bytes) -> int:
        assert len(source) <= 255, "C takes a length of 8 bits"
        ctypes.memmove(self._source, source, len(source))
        return int(self._decode[group](self._source, ctypes.c_uint8(len(source)), self._memory))

    def _read(self, group: str, source: bytes) -> Decoded:
        self.n_decoded += 1
        memory = self._memory.raw
        head = self._headers.get(group)
        header = head.read(memory, at=0, source=source, source_address=self._address)[0] if head else (memory[0],)
        reader = self._bodies[group][header[0]]
        return header, *reader.read(memory, at=self._body_at[group], source=source, source_address=self._address)


class FrameDecoder:
    """``bb_frame_decode``, fed with chunks."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self._memory = ctypes.create_string_buffer(512)
        library.bb_host_decode_frames.restype = ctypes.c_uint32
        library.bb_frame_decoder_start(self._memory)

    def feed(self, chunk: bytes) -> list[bytes | FrameFault]:
        """Return the bodies and faults that the bytes complete, in order."""
        results: list[bytes | FrameFault] = []
        out = ctypes.create_string_buffer(3 * len(chunk) + MAX_BODY_SIZE)
        size = self._library.bb_host_decode_frames(self._memory, chunk, ctypes.c_uint32(len(chunk)), out)
        told, at = out.raw[:size], 0
        while at < size:
            result, length = told[at], told[at + 1]
            fault = _FRAME_FAULTS[result]
            results.append(told[at + 2 : at + 2 + length] if fault is None else fault)
            at += 2 + length
        return results
