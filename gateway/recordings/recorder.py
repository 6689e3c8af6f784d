"""Writes recordings beside a running radio: on a thread of its own, so that neither a slow nor a full disk ever holds up the line."""

import threading
import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO

from gateway.errors import RecordingError
from gateway.log import EventLog
from gateway.recordings.recording_file import RecordingHeader, encode_header, encode_record
from gateway.transports.recording import LineRecord, RecordKind

_log = EventLog(__name__)

SUFFIX = ".biorec"
_MAX_WAITING = 4 << 20
"""Bytes that wait for a slow disk; what comes beyond is left out, and the file says how much."""

_MAX_RECORDS_WAITING = 65_536
_KEPT_FILES = 4
"""A recording is cut into files of this share of its limit; the oldest goes when a new one would not fit."""

_CLOSE_TIMEOUT_S = 5.0
_FLUSH_S = 0.5


class Recorder:
    """Takes records of one line and writes them; ``close`` waits for the disk, but not for ever.

    Parameters
    ----------
    open_next
        Opens the next file; raises ``OSError``.
    port, dialect
        For the header.
    max_file_bytes
        After so much the next file begins; None: all in one.
    on_fault
        Is told, on the recorder's thread, why recording has ended before its time.
    """

    def __init__(
        self,
        *,
        open_next: Callable[[], BinaryIO],
        port: str,
        dialect: str,
        on_fault: Callable[[str], None],
        max_file_bytes: int | None = None,
    ) -> None:
        self.fault: str | None = None
        """Why recording has ended before its time, if it has."""
        self._open_next = open_next
        self._port = port
        self._dialect = dialect
        self._on_fault = on_fault
        self._max_file_bytes = max_file_bytes
        self._waiting: deque[LineRecord] = deque()
        self._n_waiting = 0
        self._n_left_out = 0
        self._changed = threading.Condition()
        self._is_closing = False
        # A daemon: a disk that never answers must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=f"recorder {port}", daemon=True)
        self._thread.start()

    def take(self, record: LineRecord) -> None:
        """Take a record; returns at once, and never raises."""
        with self._changed:
            if self.fault is not None or self._is_closing:
                return
            if self._n_waiting + len(record.data) > _MAX_WAITING or len(self._waiting) >= _MAX_RECORDS_WAITING:
                self._n_left_out += len(record.data)
                return
            self._tell_gap()
            self._waiting.append(record)
            self._n_waiting += len(record.data)
            self._changed.notify()

    def close(self) -> None:
        """Write what waits and close the file; gives up on a disk that takes nothing for 5 s."""
        with self._changed:
            self._tell_gap()
            self._is_closing = True
            self._changed.notify()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _tell_gap(self) -> None:
        if self._n_left_out:
            data = str(self._n_left_out).encode()
            self._waiting.append(LineRecord(kind=RecordKind.GAP, monotonic_ns=time.monotonic_ns(), wall_ns=time.time_ns(), data=data))
            self._n_left_out = 0

    def _run(self) -> None:
        try:
            self._write_files()
        except OSError as error:
            with self._changed:
                self.fault = error.strerror or str(error)
                self._waiting.clear()
            self._on_fault(self.fault)

    def _write_files(self) -> None:
        batch: deque[bytes] = deque()
        while True:
            with self._open_next() as file:
                size = file.write(encode_header(self._header()))
                is_fresh = True
                while True:
                    batch = batch or deque(map(encode_record, self._wait()))
                    if not batch:
                        return
                    while batch and (is_fresh or self._max_file_bytes is None or size + len(batch[0]) <= self._max_file_bytes):
                        size += file.write(batch.popleft())
                        is_fresh = False
                    file.flush()
                    if batch:
                        break

    def _wait(self) -> deque[LineRecord]:
        """Return what has come, after gathering for a moment; nothing means that the recording is over."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting) or self._is_closing)
            if not self._is_closing:
                self._changed.wait_for(lambda: self._is_closing, timeout=_FLUSH_S)
            batch, self._waiting = self._waiting, deque()
            self._n_waiting = 0
            return batch

    def _header(self) -> RecordingHeader:
        software = f"biobot-gateway {version('biobot-gateway')}"
        return RecordingHeader(
            port=self._port, dialect=self._dialect, software=software, wall_ns=time.time_ns(), monotonic_ns=time.monotonic_ns()
        )


def record_to_file(path: Path, *, port: str, dialect: str, on_fault: Callable[[str], None] = lambda _: None) -> Recorder:
    """Record into one new file; ``fault`` tells at the end whether all was written.

    Raises
    ------
    RecordingError
        The file is there already, or cannot be made.
    """
    try:
        file = path.open("xb")
    except FileExistsError as error:
        raise RecordingError(path=str(path), reason="is there already; name another file, or remove it") from error
    except OSError as error:
        raise RecordingError(path=str(path), reason=f"cannot be made: {error.strerror}") from error
    return Recorder(open_next=lambda: file, port=port, dialect=dialect, on_fault=on_fault)


def record_to_directory(directory: Path, *, radio: str, port: str, dialect: str, max_bytes: int) -> Recorder:
    """Record into files ``RADIO-START-NNNN.biorec`` of a directory, never more than ``max_bytes`` of one radio: the oldest go.

    Raises
    ------
    RecordingError
        The directory cannot be made.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(path=str(directory), reason=f"cannot be made: {error.strerror}") from error
    stem = "".join(one if one.isalnum() else "-" for one in radio).strip("-")
    start = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
    max_file_bytes = max_bytes // _KEPT_FILES
    n_files = 0

    def open_next() -> BinaryIO:
        nonlocal n_files
        _remove_oldest(directory, stem, room_for=max_file_bytes, max_bytes=max_bytes)
        while True:
            n_files += 1
            try:
                return (directory / f"{stem}-{start}-{n_files:04d}{SUFFIX}").open("xb")
            except FileExistsError:
                continue

    def on_fault(reason: str) -> None:
        _log.warning("recording.ended", port=port, reason=reason, advice="make room, then start again")

    return Recorder(open_next=open_next, port=port, dialect=dialect, on_fault=on_fault, max_file_bytes=max_file_bytes)


def _remove_oldest(directory: Path, stem: str, *, room_for: int, max_bytes: int) -> None:
    """Remove the oldest files of a radio until one more fits; the names sort by age."""
    files = sorted(directory.glob(f"{stem}-????????T????????????Z-*{SUFFIX}"))
    total = sum(file.stat().st_size for file in files)
    for file in files:
        if total + room_for <= max_bytes:
            return
        total -= file.stat().st_size
        file.unlink()
