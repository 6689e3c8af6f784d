"""A pseudo-terminal that a gateway opens as if it were a dongle's serial port."""

import asyncio
import errno
import fcntl
import os
import stat
import tty
from pathlib import Path
from typing import IO

from simulator.errors import LineError
from simulator.lines.line import Pacer, wait_ready, write_all

_ABSENT_POLL_S = 0.05
"""How often a pty that nobody has open is looked at: the kernel reports it as readable all the time, so it cannot be waited for."""


_NO_TERMINAL = -1


class PtyEnd:
    """The master side of a pseudo-terminal, under a symbolic link that keeps its name when the terminal's changes.

    Raises
    ------
    LineError
        The link's place is taken by something that is no link to a terminal, or cannot be written.
    """

    def __init__(self, path: Path, *, baud: int | None = None) -> None:
        self._path = path
        self._lock = _take_lock(path)
        self._in, self._out = Pacer(baud), Pacer(baud)
        self._master, self._name = _NO_TERMINAL, ""
        try:
            self._make_terminal()
        except BaseException:
            self._drop_lock()
            raise

    @property
    def address(self) -> str:
        """Return ``serial:`` and the link's path."""
        return f"serial:{self._path}"

    async def read(self) -> bytes:
        """See ``SerialEnd``."""
        while True:
            try:
                data = os.read(self._master, self._in.chunk)
            except BlockingIOError:
                await wait_ready(self._master, asyncio.get_running_loop().add_reader, asyncio.get_running_loop().remove_reader)
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
                await asyncio.sleep(_ABSENT_POLL_S)
            else:
                await self._in.pace(len(data))
                return data

    async def write(self, data: bytes) -> None:
        """See ``SerialEnd``."""
        await write_all(self._master, data, pacer=self._out)

    async def unplug(self) -> None:
        """See ``SerialEnd``: hang up, and take the link away if it is still ours."""
        try:
            if str(self._path.readlink()) == self._name:
                self._path.unlink()
        except OSError:
            pass  # somebody else has taken the name, or removed it
        os.close(self._master)
        self._master = _NO_TERMINAL

    async def plug_in(self) -> None:
        """See ``SerialEnd``: a new terminal under the old link."""
        self._make_terminal()

    async def aclose(self) -> None:
        """Hang up, take the link away, and let others have the name."""
        if self._master != _NO_TERMINAL:
            await self.unplug()
        self._drop_lock()

    def _make_terminal(self) -> None:
        self._master, slave = os.openpty()
        try:
            tty.setraw(slave)
            self._name = os.ttyname(slave)
            os.set_blocking(self._master, False)
            _place_link(self._path, self._name)
        except BaseException:
            os.close(self._master)
            self._master = _NO_TERMINAL
            raise
        finally:
            os.close(slave)  # held open by us, a gateway's hang-up could not be noticed

    def _drop_lock(self) -> None:
        Path(self._lock.name).unlink(missing_ok=True)  # while it is still held
        self._lock.close()


def _take_lock(path: Path) -> IO[bytes]:
    """Make sure that no other simulator serves this name; the lock goes with the process, however it ends."""
    name = path.with_name(f".{path.name}.lock")
    try:
        lock = name.open("wb")
    except OSError as error:
        raise LineError(line=f"pty:{path}", problem=f"cannot be made: {error.strerror or error}; does the directory exist?") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.close()
        raise LineError(line=f"pty:{path}", problem="is served by another simulator; choose another path, or end that one") from error
    try:
        is_current = os.path.samestat(os.fstat(lock.fileno()), name.stat())
    except FileNotFoundError:
        is_current = False
    if not is_current:  # its last owner removed it between our opening and locking it
        lock.close()
        return _take_lock(path)
    return lock


def _place_link(path: Path, target: str) -> None:
    """Make ``path`` a symbolic link to a terminal, replacing an earlier one at once; nobody ever finds the name missing."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        mode = 0
    except OSError as error:
        raise LineError(line=f"pty:{path}", problem=f"cannot be looked at: {error.strerror}") from error
    if mode and not (stat.S_ISLNK(mode) and path.readlink().is_relative_to("/dev/pts")):
        raise LineError(line=f"pty:{path}", problem="exists and is not a link to a terminal; choose another path, or remove it")
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        fresh.symlink_to(target)
        fresh.replace(path)
    except OSError as error:
        raise LineError(line=f"pty:{path}", problem=f"cannot be made: {error.strerror or error}; does the directory exist?") from error
