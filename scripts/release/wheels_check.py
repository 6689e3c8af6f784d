"""``make wheels-check``: wheel and sdist install into bare virtual environments, and what they install maps a recording.

For each Python that is found here, and for system trees: first our wheel and then our sdist, which is compiled there, beside the pinned
dependencies out of the bundle; ``pip check`` must find that our own requirements are met.
"""

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from scripts.release.lock_file import Target, pins_for, read_lock
from scripts.release.machines import Machine
from scripts.release.trials import make_parser, run_inside, try_machines
from scripts.release.version import ROOT
from scripts.release.wheels import download_wheels

_BUILD = ROOT / "requirements" / "build.txt"


def main(arguments: Sequence[str] | None = None) -> int:
    """Try wheel and sdist; 0 where both work on every machine that was tried, 1 where not or where none could be."""
    options = make_parser("wheels-check", "Install wheel and sdist into bare environments, and map.").parse_args(arguments)
    if not options.bundle.exists():
        print(f"error: there is no {options.bundle}, from which the dependencies come; make bundle makes it", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as place:
        # They are in Python alone: the same wheels do for all.
        target = Target(python="3.11", machine="x86_64")
        download_wheels(pins_for(read_lock(_BUILD), target), target, Path(place))
        return try_machines(
            lambda machine, folder: _try_both(machine, folder, tools=Path(place)),
            bundle=options.bundle,
            trees=options.tree,
            only=options.only,
        )


def _try_both(machine: Machine, folder: Path, *, tools: Path) -> bool:
    shutil.copytree(tools, folder / "build-tools")
    wheel = next((folder / "wheels").glob(f"biobot_gateway-*_{machine.processor}.whl"))
    sdist = next(folder.glob("biobot_gateway-*.tar.gz"))
    return run_inside(machine, "files", folder, machine.place(wheel), machine.place(sdist))


if __name__ == "__main__":
    sys.exit(main())
