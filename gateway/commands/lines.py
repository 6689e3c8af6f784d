"""``biobot-gateway sniff``, ``record`` and ``replay``: lines to dongles, heard live or once more."""

import argparse
import asyncio
import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from firmware_protocol.dialects.choice import DIALECTS
from gateway.commands.outcome import DONE, FAILED, complain
from gateway.errors import RecordingError, TransportError
from gateway.recordings.dialects import make_line_dissector
from gateway.recordings.line_offer import parse_offer
from gateway.recordings.listening import Listening, listen
from gateway.recordings.printing import LinePrinter, as_json, as_text, summary
from gateway.recordings.recorder import Recorder, record_to_file
from gateway.recordings.replaying import Recording, offer_recording, open_recording, paced
from gateway.transports.recording import LineRecord
from gateway.transports.spec import PortSpec, parse_port_spec


def add_listening_arguments(parser: argparse.ArgumentParser, *, is_required: bool = True) -> None:
    """Add the flags that say which port is listened to, and how."""
    parser.add_argument("--port", required=is_required, metavar="SPEC", help="a radio, as for run")
    parser.add_argument("--duration-s", type=float, metavar="S", help="end after this (default: on Ctrl-C)")
    parser.add_argument("--passive", action="store_true", help="only listen; a dongle that waits to be opened says nothing then")
    parser.add_argument(
        "--confirm", action="store_true", help="let the dongle forget what was shown, so that it goes on; backpacks still keep it"
    )


def how_to_listen(options: argparse.Namespace) -> Listening:
    """Return what those flags ask for."""
    return Listening(is_passive=options.passive, confirms=options.confirm, duration_s=options.duration_s)


def add_sniff_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``sniff``."""
    add_listening_arguments(parser)
    parser.add_argument("--record", type=Path, metavar="FILE", help="record what is shown, too")
    parser.add_argument("--json", action="store_true", help="one JSON object for each frame")


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``record``."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a new file")
    add_listening_arguments(parser)


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``replay``."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a recording")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument("--speed", type=_speed, metavar="X", help="X times as fast as life")
    pace.add_argument("--full-speed", action="store_true", help="as fast as it can be read (default, except with --link: life speed)")
    parser.add_argument("--link", metavar="LINE", help="offer what the dongle said on pty:PATH or tcp:HOST:PORT instead of printing it")
    parser.add_argument("--dialect", choices=DIALECTS, help="read it as this dialect (default: the recording's)")
    parser.add_argument("--json", action="store_true", help="one JSON object for each frame, as `sniff --json` prints them")


def sniff(options: argparse.Namespace) -> int:
    """Print what passes on a port; failed where its dongle never answered in its dialect."""
    spec = parse_port_spec(options.port)
    printer = LinePrinter(make_line_dissector(spec.dialect, path=options.port))

    def on_fault(fault: str) -> None:
        _tell_fault(options.record, fault)

    recorder = None
    if options.record is not None:
        recorder = record_to_file(options.record, port=options.port, dialect=spec.dialect, on_fault=on_fault)

    def take(record: LineRecord) -> None:
        if recorder is not None:
            recorder.take(record)
        _print(printer, record, is_json=options.json)

    try:
        has_answered = asyncio.run(listen(spec, how=how_to_listen(options), take=take))
    except TransportError:
        if recorder is not None:
            recorder.close()
            _remove_if_empty(options.record)
        raise
    finally:
        if recorder is not None:
            recorder.close()
        complain(summary(printer.counts))
    status = DONE if has_answered else tell_no_answer(spec.dialect, options.port)
    return FAILED if recorder is not None and recorder.fault is not None else status


def record(options: argparse.Namespace) -> int:
    """Record what passes on a port, until told to end or the disk is full."""
    spec = parse_port_spec(options.port)
    try:
        recorder, has_answered = asyncio.run(_record(spec, options))
    except TransportError:
        _remove_if_empty(options.file)
        raise
    if recorder.fault is not None:
        return _tell_fault(options.file, recorder.fault)
    complain(f"{options.file}: {options.file.stat().st_size} bytes")
    return DONE if has_answered else tell_no_answer(spec.dialect, options.port)


async def _record(spec: PortSpec, options: argparse.Namespace) -> tuple[Recorder, bool]:
    loop, is_ended = asyncio.get_running_loop(), asyncio.Event()

    def on_fault(_fault: str) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: it comes out at the end all the same
            loop.call_soon_threadsafe(is_ended.set)

    recorder = record_to_file(options.file, port=options.port, dialect=spec.dialect, on_fault=on_fault)
    listening = asyncio.ensure_future(listen(spec, how=how_to_listen(options), take=recorder.take))
    ending = asyncio.ensure_future(is_ended.wait())
    try:
        await asyncio.wait({listening, ending}, return_when=asyncio.FIRST_COMPLETED)
        return recorder, listening.done() and listening.result()
    finally:
        for task in (listening, ending):
            task.cancel()
        await asyncio.gather(listening, ending, return_exceptions=True)
        await asyncio.to_thread(recorder.close)


def tell_no_answer(dialect: str, port: str) -> int:
    """Say that the dongle did not answer in its dialect; returns the exit status."""
    place = port.split("?", maxsplit=1)[0].removeprefix("serial:")
    return complain(f"the dongle did not answer as {dialect}; `biobot-gateway probe {place}` tells what it is", status=FAILED)


def _remove_if_empty(path: Path) -> None:
    """Take away a recording of nothing, as of a port that was spelled wrong: the same name is free for the next attempt."""
    with contextlib.suppress(RecordingError, OSError):
        with open_recording(path) as recording:
            is_empty = next(iter(recording.records), None) is None
        if is_empty:
            path.unlink()


def _tell_fault(path: Path, fault: str) -> int:
    return complain(f"recording {path} has ended early: {fault}; make room, and begin anew", status=FAILED)


def replay(options: argparse.Namespace) -> int:
    """Print what a recording says, or offer it on a line."""
    with open_recording(options.file) as recording:
        if options.dialect is not None:
            recording.header = replace(recording.header, dialect=options.dialect)
        if options.link is not None:
            _offer(recording, options)
        else:
            _replay_text(recording, options)
        for damage in recording.damages:
            what = "ends in a record that was not written to its end" if damage.is_torn else "is damaged"
            complain(f"{options.file}: {what}: {damage.n_bytes} bytes from byte {damage.offset} on are left out")
        if recording.n_damages > len(recording.damages):
            complain(f"{options.file}: {recording.n_damages} such places in all")
    return DONE


def _replay_text(recording: Recording, options: argparse.Namespace) -> None:
    printer = LinePrinter(make_line_dissector(recording.header.dialect, path=str(options.file)))
    for one in recording.records if options.speed is None else paced(recording.records, speed=options.speed):
        _print(printer, one, is_json=options.json)
    complain(summary(printer.counts))


def _offer(recording: Recording, options: argparse.Namespace) -> None:
    speed = float("inf") if options.full_speed else options.speed or 1.0

    def on_ready(address: str) -> None:
        complain(f"open {address} (dialect {recording.header.dialect}) to hear {options.file}; it ends when you close it")

    n_bytes = asyncio.run(offer_recording(recording, parse_offer(options.link), speed=speed, on_ready=on_ready))
    complain(f"{n_bytes} bytes were heard")


def _print(printer: LinePrinter, one: LineRecord, *, is_json: bool) -> None:
    form: Callable[[dict[str, object]], str] = as_json if is_json else as_text
    for event in printer.take(one):
        sys.stdout.write(form(event) + "\n")
    sys.stdout.flush()


def _speed(text: str) -> float:
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is no speed; wanted a number above 0, up to 1000000")
    return speed
