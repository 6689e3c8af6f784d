"""How a command ends: its exit status, and complaints on stderr."""

import sys

DONE, FAILED, USAGE = 0, 1, 2


def complain(*lines: str, status: int = DONE) -> int:
    """Write each line to stderr under the program's name; return ``status``."""
    for line in lines:
        print(f"biobot-gateway: {line}", file=sys.stderr)
    return status
