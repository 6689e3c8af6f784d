"""Ids of any kind to numbers, and back to what was written: whole numbers stay themselves, all else is numbered in the order of names."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mapper.types import IntArray

_WHOLE = re.compile(r"[0-9]{1,40}", re.ASCII)
_NEGATIVE = re.compile(r"-[0-9]{1,40}", re.ASCII)
_NUMBER = re.compile(r"0*([0-9]+?)(\.0*)?", re.ASCII)
_MAX_ID = 2**63 - 1


@dataclass(frozen=True, kw_only=True)  # without slots: a cached property needs a place
class NodeNames:
    """What each number stands for; empty where ids are numbers already.

    ``alike`` are names that differ only in case, blanks, or zeros of a number.
    """

    text_of: Mapping[int, str] = field(default_factory=dict)
    alike: tuple[tuple[str, ...], ...] = ()

    def name(self, number: int) -> str:
        """Return what was written."""
        return self.text_of.get(number, str(number))

    def number_of(self, text: str) -> int | None:
        """Return the number of what was written, None where it was not."""
        return self._numbers.get(text) if self.text_of else as_number(text)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {name: number for number, name in self.text_of.items()}


class NodeTable:
    """Codes of the ids met so far, in the order of meeting."""

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def codes(self, texts: Iterable[str]) -> list[int]:
        """Return the code of each id; an empty id is -1."""
        known = self._codes
        coded = []
        for text in texts:
            code = known.get(text)
            if code is None:
                bare = text.strip()
                code = known[text] = known.setdefault(bare, len(known)) if bare else -1
            coded.append(code)
        return coded

    @property
    def texts(self) -> dict[int, str]:
        """The ids by their codes."""
        return {code: text for text, code in self._codes.items() if code >= 0 and text == text.strip()}


def number_nodes(texts: Mapping[int, str]) -> tuple[IntArray, NodeNames]:
    """Give every id a number.

    Parameters
    ----------
    texts
        The ids by their codes.

    Returns
    -------
    numbers
        By code, shape (largest code + 1,): the id itself where all ids are whole numbers from 0 to 2^63-1; else its place in the order of
        names, counted from 1, in which numbers within names count as numbers. -1 where all ids are whole and this one is below 0: by such
        ids logs mean "nobody".
    """
    numbers = np.full(max(texts, default=-1) + 1, -1, dtype=np.int64)
    wholes = {code: as_number(text) for code, text in texts.items()}
    if all(whole is not None or _NEGATIVE.fullmatch(texts[code]) for code, whole in wholes.items()):
        for code, whole in wholes.items():
            numbers[code] = -1 if whole is None else whole
        return numbers, NodeNames()
    ordered = sorted(texts.items(), key=lambda item: (_natural(item[1]), item[1]))
    for number, (code, _) in enumerate(ordered, start=1):
        numbers[code] = number
    names = {number: text for number, (_, text) in enumerate(ordered, start=1)}
    return numbers, NodeNames(text_of=names, alike=_alike(list(names.values())))


def as_number(text: str) -> int | None:
    """Return an id that is a whole number from 0 to 2^63-1, None for any other."""
    return int(text) if _WHOLE.fullmatch(text) and int(text) <= _MAX_ID else None


def _natural(text: str) -> tuple[str | int, ...]:
    """Sort key: runs of digits by their value. Even places are text, odd ones numbers, so that any two keys compare."""
    return tuple(int(part) if place % 2 else part for place, part in enumerate(re.split(r"([0-9]{1,40})", text)))


def _alike(texts: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    groups: defaultdict[str, list[str]] = defaultdict(list)
    for text in texts:
        bare = "".join(text.casefold().split())
        whole = _NUMBER.fullmatch(bare)
        groups[whole[1] if whole else bare].append(text)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)
