"""Run a program as on a machine whose wall clock is wrong: ``python -m studies.wrong_clock SECONDS MODULE ARGUMENT ...``.

The wall clock of the whole process is so many seconds ahead; the monotonic clock is as it is. Nothing of the program itself is another one.
"""

import runpy
import sys
import time


def main() -> None:
    """Set the clock of this process, then become the program."""
    ahead_ns = round(float(sys.argv[1]) * 1e9)
    right_ns = time.time_ns

    def wrong_ns() -> int:
        return right_ns() + ahead_ns

    def wrong() -> float:
        return wrong_ns() / 1e9

    time.time_ns, time.time = wrong_ns, wrong
    sys.argv = sys.argv[2:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
