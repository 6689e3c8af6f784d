"""Start of the command line. What takes time to import is imported where an interrupt ends the program without a traceback."""

import sys
from collections.abc import Sequence

_EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; see `mapper.command_line`. An interrupt ends it with 130."""
    try:
        from mapper.command_line import run_command_line  # noqa: PLC0415  # see above

        return run_command_line(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        return _EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
