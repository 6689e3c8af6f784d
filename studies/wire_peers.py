"""Other libraries' framing, each as a program of its own that is spoken to through pipes (scripts/wire_peers/framings.py)."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.errors import StudyError

DEFAULT_PYTHON = Path(".venv-wire-peers/bin/python")
_PROGRAM = Path(__file__).parent.parent / "scripts" / "wire_peers" / "framings.py"

PEERS = {"digi-xbee-1": "xbee, AP=1", "digi-xbee-2": "xbee, AP=2", "zigpy-xbee": "xbee, AP=2", "zigpy-znp": "znp"}
"""By the program's name: the framing of ours that it is compared with."""


@dataclass(frozen=True, slots=True)
class PeerProgram:
    """The running program; it ends when its input is closed, at the latest with this process."""

    name: str
    process: subprocess.Popen[str]

    @classmethod
    def start(cls, name: str, *, python: Path) -> "PeerProgram":
        """Start the program of a name in ``PEERS``, with the Python that has the library."""
        command = [str(python), str(_PROGRAM), name]
        try:
            return cls(name, subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        except OSError as error:
            raise StudyError(f"{python}: {error.strerror}; make it by: make wire-peers") from error

    def decode(self, chunks: Sequence[bytes], *, rounds: int = 1) -> tuple[list[bytes], float]:
        """Return the data of the sound frames that it finds in a stream, and its least processor time of ``rounds`` [s].

        Raises
        ------
        StudyError
            The program ended.
        """
        source, sink = self.process.stdin, self.process.stdout
        assert source is not None
        assert sink is not None
        try:
            print(json.dumps({"chunks": [chunk.hex() for chunk in chunks], "rounds": rounds}), file=source, flush=True)
            answer = sink.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise StudyError(f"{self.name} ended with status {self.process.wait()}; its message is above")
        told = json.loads(answer)
        return [bytes.fromhex(body) for body in told["bodies"]], told["seconds"]

    def close(self) -> None:
        """End the program."""
        self.process.communicate()


def start_peers(python: Path) -> dict[str, PeerProgram]:
    """Start all programs whose library is there; those that are not are told on stderr. digi-xbee may also be beside us."""
    programs = {}
    for name in PEERS:
        is_beside_us = name.startswith("digi") and importlib.util.find_spec("digi") is not None
        program_python = Path(sys.executable) if is_beside_us else python
        try:
            program = PeerProgram.start(name, python=program_python)
            program.decode([b""])
        except StudyError as error:
            print(f"left out: {error}", file=sys.stderr)
        else:
            programs[name] = program
    return programs
