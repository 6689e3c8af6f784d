"""The reference coordinator firmware on an emulated board: QEMU's mps2-an385, its serial line on a pty."""

import json
import re
import socket
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

EMULATOR = "qemu-system-arm"
_PTY = re.compile(r"redirected to (/dev/\S+)")
_START_TIMEOUT_S = 60.0
_POLL_S = 0.02


@dataclass(slots=True, kw_only=True)
class EmulatedBoard:
    """A board that runs for as long as this context; ``folder`` takes its log and its control socket."""

    image: Path
    folder: Path
    port: str = ""
    """Device of the serial line."""
    _process: subprocess.Popen[bytes] | None = None
    _control: socket.socket | None = None

    def __enter__(self) -> Self:
        control, log = self.folder / "qmp", self.folder / "board.log"
        command = [
            EMULATOR, "-M", "mps2-an385", "-display", "none", "-monitor", "none", "-nic", "none", "-serial", "pty",
            "-qmp", f"unix:{control},server=on,wait=off", "-kernel", str(self.image),
        ]  # fmt: skip
        with log.open("wb") as output:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)
        try:
            deadline = time.monotonic() + _START_TIMEOUT_S
            while not (found := _PTY.search(log.read_text())) or not control.exists():
                is_starting = self._process.poll() is None and time.monotonic() < deadline
                assert is_starting, f"the board did not start: {log.read_text()}"
                time.sleep(_POLL_S)
            self.port = found.group(1)
            self._control = socket.socket(socket.AF_UNIX)
            self._control.settimeout(_START_TIMEOUT_S)
            self._control.connect(str(control))
            self._execute("qmp_capabilities")
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._control is not None:
            self._control.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def reset(self) -> None:
        """Reset the board as its button does, at whatever instant; what is in RAM stays there."""
        self._execute("system_reset")

    def _execute(self, command: str) -> None:
        """Run a command of the QEMU Machine Protocol; greetings and events in between are passed over."""
        assert self._control is not None
        self._control.sendall(json.dumps({"execute": command}).encode() + b"\n")
        received = b""
        while True:
            chunk = self._control.recv(4096)
            assert chunk, "the board has ended"
            received += chunk
            *lines, received = received.split(b"\n")
            for answer in map(json.loads, filter(None, lines)):
                assert "error" not in answer, answer
                if "return" in answer:
                    return
