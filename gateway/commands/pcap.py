"""``biobot-gateway pcap``: a recording, or a live port, as a capture for Wireshark."""

import argparse
import asyncio
import contextlib
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO

from firmware_protocol.errors import ConfigurationError
from gateway.commands.lines import add_listening_arguments, how_to_listen
from gateway.commands.outcome import DONE, complain
from gateway.errors import RecordingError
from gateway.recordings.capture import SECTION_COMMENT, Capture
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.listening import listen
from gateway.recordings.pcapng import PcapngWriter
from gateway.recordings.replaying import open_recording
from gateway.recordings.wireshark import make_lua_dissector
from gateway.transports.recording import LineRecord
from gateway.transports.spec import parse_port_spec

_STANDARD = "-"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``pcap``."""
    parser.add_argument("paths", nargs="*", metavar="FILE", help="[RECORDING] OUT.pcapng; - is standard input or output")
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
        _write_text(options.dissector, make_lua_dissector())
    if not options.paths:
        return DONE
    with _open_out(options.paths[-1]) as stream:
        comment = SECTION_COMMENT
        writer = PcapngWriter(stream, comment=comment, software=f"biobot-gateway {version('biobot-gateway')}")
        if options.port is None:
            _convert(Path("/dev/stdin") if options.paths[0] == _STANDARD else Path(options.paths[0]), writer)
        else:
            _capture_live(options, writer)
    return DONE


def _convert(path: Path, writer: PcapngWriter) -> None:
    with open_recording(path) as recording:
        header = recording.header
        capture = Capture(make_line_dissector(header.dialect, path=str(path)), writer, port=header.port, dialect=header.dialect)
        for record in recording.records:
            capture.take(record)
        complain(f"{capture.n_packets} packets")
        if recording.n_damages:
            complain(f"{path}: {recording.n_damages} damaged places are left out")


def _capture_live(options: argparse.Namespace, writer: PcapngWriter) -> None:
    spec = parse_port_spec(options.port)
    capture = Capture(make_line_dissector(spec.dialect, path=options.port), writer, port=options.port, dialect=spec.dialect)

    def take(record: LineRecord) -> None:
        capture.take(record)
        writer.flush()

    try:
        asyncio.run(listen(spec, how=how_to_listen(options), take=take))
    finally:
        complain(f"{capture.n_packets} packets")


@contextlib.contextmanager
def _open_out(path: str) -> Iterator[BinaryIO]:
    if path == _STANDARD:
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    try:
        stream = Path(path).open("wb")  # noqa: SIM115  # closed below, with the errors of opening told apart
    except OSError as error:
        raise RecordingError(path=path, reason=f"cannot be made: {error.strerror}") from error
    with stream:
        yield stream


def _write_text(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordingError(path=str(path), reason=f"cannot be made: {error.strerror}") from error
