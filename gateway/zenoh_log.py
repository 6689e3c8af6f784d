"""Zenoh's own log, brought into ours: it names why a connection is refused, but repeats it with every attempt, on standard output.

Only for a process whose standard output is nobody's, as the router's: file descriptor 1 becomes a pipe that is read here.
"""

import os
import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from typing import Final

from gateway.log import EventLog

_log = EventLog(__name__)

_ANSI: Final = re.compile(r"\x1b\[[0-9;]*m")
_LINE: Final = re.compile(r"\S+\s+(?P<level>WARN|ERROR)\s+.*?(?P<target>zenoh[\w:]*):\s+(?P<text>.*)\Z")
_NUMBERS: Final = re.compile(r"[0-9a-f]{16,}|\d+")
_HINT: Final = re.compile(r"\. Hint: increase the system open file limit\.?")  # Zenoh's guess at any failed accept
_PLAIN_WORDS: Final = {
    "peer sent no certificates": "somebody who connects shows no certificate; give them tls.certificate and tls.key",
    "received fatal alert: CertificateRequired": "the other router wants a certificate; give tls.certificate and tls.key",
    "invalid peer certificate: Expired": "somebody who connects shows a certificate that is out of date; renew it, and compare both clocks",
    "invalid peer certificate: NotValidYet": "somebody who connects shows a certificate that is not valid yet; compare both clocks",
    "invalid peer certificate": "somebody who connects shows a certificate of another authority; issue theirs with the one of tls.ca",
    "received fatal alert: CertificateExpired": "somebody who connects finds our certificate out of date; renew it, compare both clocks",
    "received fatal alert: BadCertificate": "somebody who connects refuses our certificate: it is not for the address they use "
    "(`certs issue --host`), or not of the authority of their tls.ca",
    "received fatal alert": "somebody who connects refuses our certificate: it is of another authority than their tls.ca",
    "InvalidContentType": "somebody who connects speaks no TLS; their endpoint should begin with tls/",
    **dict.fromkeys(
        ("Unknown interest", "Unknown subscriber id", "Unknown queryable id", "Unknown token id", "Unknown id"),
        "somebody takes back what this router never took from them, since it is denied to them: who is not on the roster "
        "(router.stranger names them), or whose role does not let them; where all that are connected are on it, no harm is done",
    ),
    "handshake eof": "somebody who connects hung up before TLS was agreed on: a port scan, one that speaks no TLS, or one that gave up",
}
"""What Zenoh says of handshakes, measured with eclipse-zenoh 1.10; the first that fits counts. It does not tell whose they were."""

_MAX_TEXT: Final = 500
_MAX_KNOWN: Final = 256
_QUIET_S: Final = 60.0
"""A message that was not repeated for so long is told anew when it comes again."""


class SaidOnce:
    """Lets a message pass the first time, and again after it has been quiet for a while; numbers in it make no difference."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, float] = OrderedDict()

    def is_new(self, text: str, *, now_s: float) -> bool:
        """Say whether to tell it; ``now_s`` is monotonic."""
        key = _NUMBERS.sub("N", text)
        last_s = self._known.pop(key, None)
        self._known[key] = now_s
        if len(self._known) > _MAX_KNOWN:
            self._known.popitem(last=False)
        return last_s is None or now_s - last_s >= _QUIET_S


def parse_line(line: str) -> tuple[str, str] | None:
    """Return level and text of a line of Zenoh's log, or None where it is none that a person should see."""
    match = _LINE.match(_ANSI.sub("", line).strip())
    if match is None:
        return None
    return match["level"], _HINT.sub("", match["text"]).split(" at /", maxsplit=1)[0][:_MAX_TEXT]


def put_plainly(text: str) -> str:
    """Return what Zenoh says of a refused handshake in words that name the next step, its own in brackets; all else as it is."""
    plain = _plain_words(text)
    return text if plain is None else f"{plain} [{text}]"


def what_is_told(lines: Iterable[str], *, clock_s: Callable[[], float] = time.monotonic) -> Iterator[tuple[str, str]]:
    """Yield level and words of each line of Zenoh's log that says something new; two that mean the same are one."""
    said = SaidOnce()
    for line in lines:
        parsed = parse_line(line)
        if parsed is not None and said.is_new(_plain_words(parsed[1]) or parsed[1], now_s=clock_s()):
            yield parsed[0], put_plainly(parsed[1])


def _plain_words(text: str) -> str | None:
    return next((words for sign, words in _PLAIN_WORDS.items() if sign in text), None)


def capture_zenoh_log() -> None:
    """Read what this process writes to standard output from now on as Zenoh's log, and tell what is new in it."""
    read_end, write_end = os.pipe()
    os.dup2(write_end, 1)
    os.close(write_end)
    import zenoh  # noqa: PLC0415  # loads 33 MB, which the command line's --help does not need

    zenoh.init_log_from_env_or("warn")
    threading.Thread(target=_read, args=(read_end,), name="zenoh-log", daemon=True).start()


def _read(descriptor: int) -> None:
    with os.fdopen(descriptor, encoding="utf-8", errors="replace") as lines:
        for level, reason in what_is_told(lines):
            say = _log.error if level == "ERROR" else _log.warning
            say("zenoh", reason=reason)
