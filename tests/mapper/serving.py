"""`biobot-mapper serve` as a real process, on a free port."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mapper.access import Role, add_token

START_S = 90.0
STOP_S = 60.0
PATIENCE_S = 150.0
"""A map is computed by a process that steps back behind all others; at a load of 40 that is not within a minute."""


def until(is_met: Callable[[], bool]) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not is_met():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@contextmanager
def serving(directory: Path, *, connect: int, arguments: Sequence[str] = ()) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Yield the page's URL, with a slash to join paths to, and the process; end it as an operator would, and find that it ends well.

    Operator anna has a token there, which `token_of` returns.
    """
    url_file = directory / "url"
    url_file.unlink(missing_ok=True)
    tokens = directory / "tokens.json"
    if not tokens.exists():
        add_token(tokens, name="anna", role=Role.OPERATOR, secret_file=directory / "token")
    command = [sys.executable, "-m", "mapper", "serve", "--port", "0", "--url-file", str(url_file), "--connect", f"tcp/127.0.0.1:{connect}"]
    command += ["--tokens", str(tokens)]
    with (directory / "mapper.log").open("a", encoding="utf-8") as log:
        process = subprocess.Popen([*command, *arguments], stdout=log, stderr=log, text=True)
    try:
        deadline = time.monotonic() + START_S
        while not url_file.exists():
            assert process.poll() is None, (directory / "mapper.log").read_text()
            assert time.monotonic() < deadline, "the mapper did not come up"
            time.sleep(0.02)
        yield f"{url_file.read_text().strip()}/", process
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            assert process.wait(STOP_S) == 0, (directory / "mapper.log").read_text()
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def token_of(directory: Path) -> str:
    """Return the token of operator anna, of the mapper that serves from a directory."""
    return (directory / "token").read_text().strip()


def shown(directory: Path) -> dict[str, str]:
    """Return the header that shows it."""
    return {"Authorization": f"Bearer {token_of(directory)}"}
