"""A case is known by its content, and a program by what it does."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from studies.cases import PackageFile
from studies.cases.program import fingerprint, modules_behind, reduce_source
from studies.cases.study import digest
from studies.sweep.map_case import compute_case
from studies.trials import compute_trial

SCALARS = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5)
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3), max_leaves=8
)


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Case:
    colour: Colour
    at: tuple[float, int]


def turned(value: Any, rng: random.Random) -> Any:
    """Return the same value with the keys of every mapping in another order."""
    if isinstance(value, Mapping):
        keys = list(value)
        rng.shuffle(keys)
        return {key: turned(value[key], rng) for key in keys}
    return [turned(one, rng) for one in value] if isinstance(value, list) else value


@given(VALUES, st.randoms(use_true_random=False))
def test_the_order_of_keys_does_not_matter(value: Any, rng: random.Random) -> None:
    assert digest(turned(value, rng)) == digest(value)


@given(VALUES, VALUES)
def test_different_values_have_different_digests(one: Any, other: Any) -> None:
    assume(one != other)
    assert digest(one) != digest(other)


def test_whole_numbers_floats_truths_and_texts_are_told_apart() -> None:
    assert len({digest(value) for value in (1, 1.0, True, "1", [1], {"1": 1})}) == 6


def test_a_dataclass_is_known_by_its_fields() -> None:
    assert digest(Case(Colour.RED, (1.5, 2))) == digest({"at": [1.5, 2], "colour": "red"})


def test_a_number_that_json_cannot_hold_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        digest(float("inf"))


def test_comments_docstrings_and_layout_are_no_part_of_a_program_but_everything_else_is() -> None:
    source = b'"""Doc."""\nX = 1\n\n\ndef f(a: int) -> str:\n    """Doc."""\n    return "# text"\n\n\nclass C:\n    """Doc."""\n'
    same = b'X=1 # one\ndef f(a: int)->str:\n  """Another."""\n  return "# text"\nclass C: pass\n'
    assert reduce_source(source) == reduce_source(same)
    for old, new in ((b"X = 1", b"X = 2"), (b"# text", b"# tex"), (b"a: int", b"a: int = 0")):
        assert reduce_source(source.replace(old, new)) != reduce_source(source)


def test_behind_a_trial_are_the_mapper_and_the_engine_but_not_what_hands_cases_round() -> None:
    found = modules_behind(compute_trial.__module__)
    assert {"mapper.pipeline", "mapper.betti", "simulator.world", "simulator.engine", "studies.arenas", "studies"} <= found.keys()
    assert not any(name.startswith(("studies.cases", "gateway", "mapper.api")) for name in found)
    assert all(Path(path).suffix == ".py" for path in found.values())


def test_a_program_is_known_by_its_code_and_its_files() -> None:
    rules = PackageFile(package="mapper", path="data/classifier.json")
    names = {fingerprint(compute_trial), fingerprint(compute_case), fingerprint(compute_case, (rules,))}
    assert len(names) == 3
    assert fingerprint(compute_case, (rules,)) in names
