"""giotto-ph, as a program of its own that is spoken to through pipes: its licence (AGPL) asks that it be kept apart from ours."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

from studies.errors import StudyError
from studies.truth import Floats, Intervals

# Reads a matrix a line, and writes the seconds taken and the bars of dimensions 0 and 1, all as JSON.
_PROGRAM = """
import json, sys, time
import numpy as np
from gph import ripser_parallel

for line in sys.stdin:
    distances = np.array(json.loads(line))
    begin = time.perf_counter()
    bars = ripser_parallel(distances, metric="precomputed", maxdim=1, n_threads=int(sys.argv[1]))["dgms"]
    seconds = time.perf_counter() - begin
    print(json.dumps([seconds, *(found.tolist() for found in bars)]), flush=True)
"""


def is_installed() -> bool:
    """Tell whether giotto-ph is there, without loading it."""
    return importlib.util.find_spec("gph") is not None


@dataclass(frozen=True, slots=True)
class GiottoProgram:
    """The running program; it ends when its input is closed, at the latest with this process."""

    process: subprocess.Popen[str]

    @classmethod
    def start(cls, *, n_threads: int) -> "GiottoProgram":
        """Start the program with so many threads."""
        command = [sys.executable, "-c", _PROGRAM, str(n_threads)]
        return cls(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))

    def __call__(self, distances: Floats) -> tuple[float, Intervals]:
        """Compute persistence; return the seconds that it took, without the way through the pipes, and the bars.

        Raises
        ------
        StudyError
            The program ended.
        """
        source, sink = self.process.stdin, self.process.stdout
        assert source is not None
        assert sink is not None
        try:
            print(json.dumps(distances.tolist()), file=source, flush=True)
        except BrokenPipeError:
            answer = ""
        else:
            answer = sink.readline()
        if not answer:
            raise StudyError(f"giotto-ph ended with status {self.process.wait()}; its message is above")
        seconds, merges, loops = json.loads(answer)
        return seconds, (np.array(merges).reshape(-1, 2), np.array(loops).reshape(-1, 2))

    def close(self) -> None:
        """End the program."""
        self.process.communicate()
