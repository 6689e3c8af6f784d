"""``biobot-gateway pcap``: a recording, or a live port, as a capture for Wireshark."""

import argparse
import asyncio
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO

from firmware_protocol.errors import ConfigurationError
from gateway.commands.lines import add_listening_arguments, how_to_listen, tell_no_answer
from gateway.commands.outcome import DONE, complain
from gateway.errors import RecordingError
from gateway.recordings.capture import SECTION_COMMENT, Capture
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.listening import listen
from gateway.recordings.pcapng import PcapngWriter
from gateway.recordings.replaying import open_recording
from gateway.recordings.wireshark import DISSECTOR_MARK, make_lua_dissector
from gateway.transports.recording import LineRecord
from gateway.transports.spec import parse_port_spec

_STANDARD = "-"
_IS_THERE = "is there already; name another file, or remove it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``pcap``."""
    parser.add_argument("paths", nargs="*", metavar="FILE", help="[RECORDING] OUT.pcapng, a new file; - is standard input or output")
    parser.add_argument("--dissector", type=Path, metavar="LUA", help="write the Wireshark dissector of biobot messages, too or alone")
    add_listening_arguments(parser, is_required=False)


def pcap(options: argparse.Namespace) -> int:
    """Write a capture, the dissector, or both."""
    n_paths = 1 if options.port is not None else 2
    if len(options.paths) != n_paths and (options.paths or options.port is not None or options.dissector is None):
        wanted = (
            "--port SPEC OUT.pcapng" if options.port is not None else "RECORDING OUT.pcapng, --port SPEC OUT.pcapng, or --dissector LUA"
        )
        raise ConfigurationError([f"pcap: {len(options.paths)} files are named; give {wanted}"])
    if options.dissector is not None:
        _write_dissector(options.dissector)
    if not options.paths:
        return DONE
    if options.port is None:
        _convert(Path("/dev/stdin") if options.paths[0] == _STANDARD else Path(options.paths[0]), options.paths[1])
        return DONE
    return _capture_live(options)


def _convert(path: Path, out: str) -> None:
    # The recording is read first: what is none leaves no capture behind.
    with open_recording(path) as recording, _open_out(out, is_kept=lambda: False) as stream:
        header = recording.header
        capture = Capture(make_line_dissector(header.dialect, path=str(path)), _writer(stream), port=header.port, dialect=header.dialect)
        for record in recording.records:
            capture.take(record)
    complain(f"{capture.n_packets} packets")
    if recording.n_damages:
        complain(f"{path}: {recording.n_damages} damaged places are left out")


def _capture_live(options: argparse.Namespace) -> int:
    spec = parse_port_spec(options.port)
    dissector = make_line_dissector(spec.dialect, path=options.port)
    n_packets = 0
    with _open_out(options.paths[0], is_kept=lambda: n_packets > 0) as stream:
        writer = _writer(stream)
        capture = Capture(dissector, writer, port=options.port, dialect=spec.dialect)

        def take(record: LineRecord) -> None:
            nonlocal n_packets
            capture.take(record)
            writer.flush()
            n_packets = capture.n_packets

        try:
            has_answered = asyncio.run(listen(spec, how=how_to_listen(options), take=take))
        finally:
            complain(f"{n_packets} packets")
    return DONE if has_answered else tell_no_answer(spec.dialect, options.port)


def _writer(stream: BinaryIO) -> PcapngWriter:
    return PcapngWriter(stream, comment=SECTION_COMMENT, software=f"biobot-gateway {version('biobot-gateway')}")


@contextlib.contextmanager
def _open_out(path: str, *, is_kept: Callable[[], bool]) -> Iterator[BinaryIO]:
    """Make the capture; what is there already is never written over. Where writing fails, it stays only if ``is_kept`` then.

    Raises
    ------
    RecordingError
        A file is there already, cannot be made, or its disk is full.
    """
    stream, is_ours = _make(path)
    try:
        with stream:
            yield stream
    except BaseException as error:
        stays = not is_ours or is_kept()
        if not stays:
            Path(path).unlink(missing_ok=True)
        if not isinstance(error, OSError) or isinstance(error, BrokenPipeError):  # who read standard output may go
            raise
        what = "is cut short" if stays else "could not be written to its end, and was removed"
        raise RecordingError(path=path, reason=f"{what}: {error.strerror}; make room, and begin anew", what="capture") from error


def _make(path: str) -> tuple[BinaryIO, bool]:
    """Open where the capture goes; the second is whether that is a file that was not there before."""
    if path == _STANDARD:
        return os.fdopen(os.dup(sys.stdout.fileno()), "wb"), False
    out = Path(path)
    try:
        if out.exists() and not out.is_file():  # a named pipe into Wireshark
            return out.open("wb"), False
        return out.open("xb"), True
    except FileExistsError as error:
        raise RecordingError(path=path, reason=_IS_THERE, what="capture") from error
    except OSError as error:
        raise RecordingError(path=path, reason=f"cannot be made: {error.strerror}", what="capture") from error


def _write_dissector(path: Path) -> None:
    """Write the dissector, over an earlier one but over nothing else."""
    text = make_lua_dissector()
    try:
        if path.is_file():
            with path.open("rb") as earlier:
                if earlier.read(len(DISSECTOR_MARK)) != DISSECTOR_MARK.encode():
                    raise RecordingError(path=str(path), reason=_IS_THERE, what="dissector")
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordingError(path=str(path), reason=f"cannot be made: {error.strerror}", what="dissector") from error
