"""How well encounters cover the place: counted in the plain way, on any encounters."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.coverage import MAX_MINUTES, describe_coverage
from mapper.types import ModeSpell
from tests.mapper.worlds import Row, encounter_rows, table_of

MIN_NS = 60_000_000_000


def stands(*nodes: int) -> list[ModeSpell]:
    return [ModeSpell(node=NodeId(node), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in nodes]


@given(rows=encounter_rows(max_size=12), factor=st.sampled_from([1, 20_000_000_000, 7_000_000_000_000]))
def test_encounters_are_counted_by_minute_biobot_and_group(rows: list[Row], factor: int) -> None:
    stretched = [(begin * factor, end * factor, first, second) for begin, end, first, second in rows]
    told = describe_coverage(table_of(stretched), stands(1, 99), None, minimum=2)
    minutes = Counter(begin // MIN_NS for begin, *_ in stretched)
    first = max(min(minutes), max(minutes) - MAX_MINUTES + 1)
    assert told["per_minute"] == {"begin_s": first * 60, "counts": [minutes[minute] for minute in range(first, max(minutes) + 1)]}
    counts = Counter(node for *_, one, other in rows for node in (one, other))
    assert {item["id"]: item["n_encounters"] for item in told["biobots"]} == counts  # type: ignore[index, union-attr, call-overload]  # JSON
    groups = [{node} for node in counts]
    for *_, one, other in rows:
        joined = [group for group in groups if one in group or other in group]
        groups = [group for group in groups if group not in joined] + [set().union(*joined)]
    largest = max(sum(one in group for *_, one, _ in rows) for group in groups)
    assert told["giant_share"] == largest / len(rows)
    assert told["unmet_landmarks"] == [node for node in (1, 99) if node not in counts]


def test_no_encounters_are_told_as_such() -> None:
    told = describe_coverage(table_of([]), [], None, minimum=2)
    assert (told["n_encounters"], told["giant_share"], told["per_minute"]) == (0, None, {"begin_s": None, "counts": []})
    assert told["data"]["expected_wait_s"] is None  # type: ignore[index, call-overload]  # JSON


@given(n=st.integers(2, 40), step_s=st.integers(1, 50))
def test_what_is_missing_comes_at_the_rate_so_far(n: int, step_s: int) -> None:
    rows = [(k * step_s * 10**9, k * step_s * 10**9, 1 + k % 10, 11 + k % 10) for k in range(n)]
    told = describe_coverage(table_of(rows), [], None, minimum=2)
    n_biobots = min(n, 10) * 2
    missing = max(2, 15 * n_biobots // 2) - n
    wait_s = told["data"]["expected_wait_s"]  # type: ignore[index, call-overload]  # JSON
    n_lately = sum(begin >= rows[-1][0] - 5 * MIN_NS for begin, *_ in rows)
    span_s = max(min(5 * 60, (n - 1) * step_s), 1)
    if missing > 0:
        assert abs(wait_s - missing * span_s / n_lately) < 1e-6 * wait_s  # type: ignore[operator]  # a number
    else:
        assert wait_s is None
