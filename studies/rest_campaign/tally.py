"""What was asked and answered, and what was wrong, with the request that shows it."""

import shlex
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Final

import requests

from studies.rest_campaign.askers import Target
from studies.rest_campaign.judge import Fault

_OWN_FIELDS: Final = {"User-Agent", "Connection", "Content-Length", "Accept-Encoding", "Accept", "X-Schemathesis-TestCaseId"}
NO_ANSWER: Final = 0
"""In the place of a status, where there was none or the answer broke off."""
_MOST_SHOWN: Final = 2000


@dataclass(slots=True)
class Failure:
    """One rule that one operation broke, however often."""

    operation: str
    fault: Fault
    status: int
    command: str
    """The shortest request that shows it."""
    count: int = 1


@dataclass(slots=True)
class Tally:
    """Counts of a campaign."""

    statuses: dict[str, Counter[int]] = field(default_factory=dict)
    """By operation."""
    kinds: Counter[str] = field(default_factory=Counter)
    """By who asked, and how."""
    failures: dict[tuple[str, str, int], Failure] = field(default_factory=dict)

    @property
    def n_cases(self) -> int:
        """How many requests were sent."""
        return sum(counts.total() for counts in self.statuses.values())

    def count(self, operation: str, answer: requests.Response, faults: list[Fault], *, kinds: tuple[str, ...], target: Target) -> None:
        """Note an answer."""
        self.statuses.setdefault(operation, Counter())[answer.status_code] += 1
        self.kinds.update(kinds)
        for fault in faults:
            key = (operation, fault.rule, answer.status_code)
            command = write_command(answer.request, target=target)
            known = self.failures.get(key)
            if known is None:
                self.failures[key] = Failure(operation=operation, fault=fault, status=answer.status_code, command=command)
                continue
            known.count += 1
            if len(command) < len(known.command):
                known.command, known.fault = command, fault


def write_command(request: requests.PreparedRequest, *, target: Target) -> str:
    """Write a request as a call of curl; tokens by the names of their roles."""
    parts = ["curl", "-si"]
    if request.method == "HEAD":
        parts.append("--head")
    else:
        parts += ["-X", str(request.method)]
    for name, value in request.headers.items():
        if name not in _OWN_FIELDS:
            parts += ["-H", f"{name}: {value if isinstance(value, str) else value.decode('latin-1')}"]
    body = request.body if isinstance(request.body, bytes) else str(request.body or "").encode()
    before = ""
    if body:
        text = body[:_MOST_SHOWN].decode("ascii", "backslashreplace")
        if body.isascii() and text.isprintable():
            parts += ["--data-binary", text]
        else:
            octets = "".join(rf"\x{byte:02x}" for byte in body[:_MOST_SHOWN])
            before = f"printf {shlex.quote(octets)} | "
            parts += ["--data-binary", "@-"]
    parts.append(str(request.url))
    command = before + shlex.join(parts)
    for role, token in target.tokens.items():
        command = command.replace(token, f"${role.upper()}")
    return command.replace(target.url, "$URL")


def write_report(tally: Tally, facts: Mapping[str, object]) -> str:
    """Write a campaign as Markdown: facts, cases per operation and status, and what was wrong."""
    lines = [f"- {name}: {value}" for name, value in facts.items()]
    lines += [f"- requests by {', '.join(f'{kind} {count:,}' for kind, count in sorted(tally.kinds.items()))}", ""]
    lines += ["| operation | requests | answers |", "|---|---|---|"]
    for operation, counts in sorted(tally.statuses.items()):
        told = ", ".join(f"{status} ×{count:,}" for status, count in sorted(counts.items()))
        lines.append(f"| `{operation}` | {counts.total():,} | {told} |")
    n_errors = sum(
        count for counts in tally.statuses.values() for status, count in counts.items() if status >= HTTPStatus.INTERNAL_SERVER_ERROR
    )
    lines += [
        "",
        f"{tally.n_cases:,} requests, {n_errors:,} of them answered 503 or 501 as documented; {len(tally.failures)} rules broken.",
    ]
    for failure in tally.failures.values():
        lines += ["", f"**{failure.operation}**, {failure.status}, {failure.count} times: {failure.fault.rule}: {failure.fault.detail}"]
        lines += ["", "```sh", failure.command, "```"]
    return "\n".join(lines) + "\n"
