"""``make bundle-check``: the bundle is installed and maps on machines whose network is cut off.

Every Python of this machine that the bundle is for is tried in a network namespace with nothing but loopback, and so are system trees
(``--tree``): another system's Python, or another processor's under QEMU. What cannot be tried here is told with its reason.
"""

import platform
import sys
from collections.abc import Sequence
from pathlib import Path

from scripts.release.machines import Machine
from scripts.release.trials import make_parser, run_inside, try_machines


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the bundle; 0 where it works on every machine that was tried, 1 where not or where none could be."""
    parser = make_parser("bundle-check", "Install the bundle and map, without a network.")
    parser.add_argument("--speed", default="4", help="insects of the demo are so much faster than life (default: 4)")
    parser.add_argument("--no-demo", action="store_true", help="leave out the demo: three processes that talk over loopback")
    options = parser.parse_args(arguments)
    if not options.bundle.exists():
        print(f"error: there is no {options.bundle}; make bundle makes it", file=sys.stderr)
        return 2
    speed = None if options.no_demo else options.speed
    return try_machines(
        lambda machine, folder: _try_one(machine, folder, speed=speed),
        bundle=options.bundle,
        trees=options.tree,
        only=options.only,
    )


def _try_one(machine: Machine, folder: Path, *, speed: str | None) -> bool:
    if speed is not None and machine.processor != platform.machine():
        print("  the demo is left out: it walks in real time, which an emulator does not keep")
        speed = None
    return run_inside(machine, "bundle", folder, *([] if speed is None else [speed]))


if __name__ == "__main__":
    sys.exit(main())
