"""How far each command of the documents is run, and what it must end with.

A command is run to its end and must end with 0. The rules below are for what cannot: each says why, and one that no command needs is an
error. Nothing on this machine is touched: devices and ``/tmp`` are put into the test's own directory, and a site to a port where nobody
listens.
"""

import re
from dataclasses import dataclass
from enum import Enum, auto


class Extent(Enum):
    """How far a command is run."""

    WHOLE = auto()
    """To its end, whatever that is."""
    CONFIGURATION = auto()
    """With ``--check-config``: its configuration holds."""
    WORDS = auto()
    """With ``--help``: its command, flags, values and choices are what the program knows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """What is said of the commands that match ``pattern``, from their beginning."""

    pattern: str
    why: str
    extent: Extent = Extent.WHOLE
    status: int = 0
    says: str = ""
    """What it says then, on either stream."""


RULES = (
    Rule(pattern=r"biobot-gateway run(?!.* --check-config)", why="waits for a dongle, until a signal", extent=Extent.CONFIGURATION),
    Rule(pattern=r"biobot-gateway router ", why="carries messages until a signal", extent=Extent.CONFIGURATION),
    Rule(pattern=r"biobot-mapper serve", why="serves until a signal", extent=Extent.CONFIGURATION),
    Rule(pattern=r"biobot-sim (serve|replay)", why="walks in real time until a signal", extent=Extent.CONFIGURATION),
    Rule(pattern=r"biobot-gateway replay .*--link", why="waits for whoever opens the line", extent=Extent.WORDS),
    Rule(pattern=r"biobot-gateway (probe (--all|tcp:)|record)", why="asks devices of this machine or network", extent=Extent.WORDS),
    Rule(pattern=r"biobot-gateway probe /", why="no dongle is plugged in", status=1, says="there is no "),
    Rule(pattern=r"biobot-gateway (sniff|check-radio) ", why="no dongle is plugged in", status=1, says="there is no "),
    Rule(pattern=r"biobot-gateway steer \d+$", why="wants a terminal", status=2, says="this is no terminal"),
    Rule(pattern=r"biobot-gateway stop --all", why="no gateway runs", status=1, says="nobody listens there"),
    Rule(
        pattern=r"biobot-gateway (command|stop \d|steer .*--script|mission|status)\b",
        why="no gateway runs, and each waits some seconds for one; tests/e2e and tests/gateway have them obeyed",
        extent=Extent.WORDS,
    ),
    Rule(pattern=r"biobot-gateway audit verify .*--head", why="that row is of another journal", status=1, says="b57d2c04a1f0"),
    Rule(pattern=r"biobot-mapper tokens revoke", why="that token is another mapper's", status=1, says="1f0c93aa"),
)


def rule_for(text: str) -> Rule | None:
    """Return the rule for a command, or None: it is run and ends with 0."""
    return next((rule for rule in RULES if re.match(rule.pattern, text)), None)
