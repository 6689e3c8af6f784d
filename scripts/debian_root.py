"""A Debian system in a folder, made by debootstrap: the base of images, and the bare machine that the README promises to work on.

debootstrap asks the mirror that it is set up for; proxies are those of the environment.
"""

import shutil
import subprocess
from pathlib import Path

SLIM = (
    "usr/share/doc/*", "usr/share/man/*", "usr/share/info/*", "usr/share/locale/*", "usr/share/lintian/*", "usr/share/groff/*",
    "var/cache/apt/*", "var/lib/apt/lists/*", "var/log/*",
)  # fmt: skip
"""What Debian's own image ``debian:bookworm-slim`` leaves out as well; all but the copyright notices, which stay there and here."""

_COMPLETE = ".biobot-complete"


def make_root(root: Path, *, suite: str, include: tuple[str, ...] = (), is_slim: bool = False) -> None:
    """Install Debian's least system, and packages with what they depend on and no more, into a folder; nothing where it is whole already.

    Raises
    ------
    subprocess.CalledProcessError
        debootstrap failed; it has said why.
    """
    mark = root / _COMPLETE
    made_of = " ".join((suite, *include))
    if mark.exists() and mark.read_text() == made_of:
        return
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    command = ["debootstrap", "--variant=minbase", *([f"--include={','.join(include)}"] if include else []), suite, str(root)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    if is_slim:
        _slim(root)
    mark.write_text(made_of)


def _slim(root: Path) -> None:
    for pattern in SLIM:
        for path in root.glob(pattern):
            notice = path / "copyright"
            if path.is_symlink() or not path.is_dir():
                path.unlink()
            elif notice.is_file() or notice.is_symlink():
                for other in path.iterdir():
                    if other != notice:
                        shutil.rmtree(other) if other.is_dir() and not other.is_symlink() else other.unlink()
            elif path.name != "partial":
                shutil.rmtree(path)
