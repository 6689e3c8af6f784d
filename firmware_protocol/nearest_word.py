"""What was meant by a word that is none of those known: for keys of a configuration, and for the commands and flags of every program."""

import argparse
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, NoReturn

_UNKNOWN_COMMAND = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)$", re.DOTALL)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'run'?`` for the nearest of those known, or nothing where none is near."""
    nearest = get_close_matches(word, sorted(known), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""


class CommandParser(argparse.ArgumentParser):
    """A parser that names the nearest command, value or flag where one is not known; its commands' parsers are of its kind."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as ever, but refuse a flag that is not known here, where those that are can be named."""
        found, extras = super().parse_known_args(args, namespace)
        unknown = [word for word in extras if word.startswith("-")]
        if unknown:
            flags = [flag for action in self._actions for flag in action.option_strings if action.help != argparse.SUPPRESS]
            nearest = did_you_mean(unknown[0].partition("=")[0], flags)
            self.error(f"unrecognized arguments: {' '.join(extras)}{nearest}")
        return found, extras

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and what was meant; exit with status 2."""
        unknown = _UNKNOWN_COMMAND.search(message)
        nearest = "" if unknown is None else did_you_mean(unknown[1], re.findall(r"[^\s,']+", unknown[2]))
        super().error(message + nearest)
