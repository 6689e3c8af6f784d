"""The most memory that this process has held at a time."""

import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def peak_memory() -> int:
    """Return the peak of resident memory [bytes].

    Notes
    -----
    Linux tells it of the program that runs now. What ``getrusage`` tells, and is used elsewhere, counts the process as it was before it
    became this program, too: a small child of a large parent looks large.
    """
    if _STATUS.exists():
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
