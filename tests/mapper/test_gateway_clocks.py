"""Clocks of many base stations: those that share no pair of biobots are passed over, and nothing else is said for it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapper import gateway_clocks
from mapper.clock_samples import SampledRows, number_pairs
from mapper.clock_votes import ClockDifference, ClockSample, compare_clocks
from mapper.gateway_clocks import GatewayClocks, Source
from mapper.types import BoolArray, IntArray

_S = 1_000_000_000


def _chain(*, n_gateways: int, n_shared: int, seed: int) -> tuple[SampledRows, list[int]]:
    """Return what gateways in a row told, each sharing encounters with the next alone, and how far each one's clock is ahead [ns]."""
    draws = np.random.default_rng(seed)
    ahead = draws.integers(-400, 400, n_gateways) * _S
    rows: list[tuple[int, int, int, int]] = []
    for gateway in range(n_gateways):
        for at in range(2 * n_shared + 3):
            low = 100 * gateway + at
            pair = int(number_pairs(np.array([low]), np.array([low + 50]))[0])
            middle = int(draws.integers(0, 3600 * _S))
            told_by = (gateway, gateway + 1) if at < n_shared and gateway + 1 < n_gateways else (gateway,)
            rows += [(one, pair, middle + int(ahead[one]), 3 * _S) for one in told_by]
    columns = np.array(rows, dtype=np.int64).T
    usable = np.ones(len(rows), dtype=np.bool_)
    facts = SampledRows(source=columns[0], pair=columns[1], middle_ns=columns[2], length_ns=columns[3], is_usable=usable)
    return facts, ahead.tolist()


def _settled(facts: SampledRows, *, n_gateways: int) -> GatewayClocks:
    clocks = GatewayClocks()
    for gateway in range(n_gateways):
        clocks.number(Source(gateway=f"base{gateway}", anchor_ns=gateway))
    clocks.note(np.arange(len(facts.source)), sources=facts.source, pairs=facts.pair)

    def read(rows: IntArray) -> SampledRows:
        return SampledRows(
            source=facts.source[rows],
            pair=facts.pair[rows],
            middle_ns=facts.middle_ns[rows],
            length_ns=facts.length_ns[rows],
            is_usable=facts.is_usable[rows],
        )

    clocks.settle(read)
    return clocks


@given(n_gateways=st.integers(2, 5), n_shared=st.integers(0, 12), seed=st.integers(0, 2**16))
def test_what_is_said_is_what_comparing_every_two_says(n_gateways: int, n_shared: int, seed: int) -> None:
    facts, _ = _chain(n_gateways=n_gateways, n_shared=n_shared, seed=seed)
    found = _settled(facts, n_gateways=n_gateways).report()

    def has_met_everybody(clocks: GatewayClocks, _facts_of: object) -> BoolArray:
        return np.ones((len(clocks.sources), len(clocks.sources)), dtype=np.bool_)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GatewayClocks, "_meet", has_met_everybody)
        assert _settled(facts, n_gateways=n_gateways).report() == found


def test_fifty_base_stations_in_a_row_are_compared_with_their_neighbours_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    facts, ahead = _chain(n_gateways=50, n_shared=8, seed=1)
    n_compared = 0

    def count(one: ClockSample, other: ClockSample) -> ClockDifference | None:
        nonlocal n_compared
        n_compared += 1
        return compare_clocks(one, other)

    monkeypatch.setattr(gateway_clocks, "compare_clocks", count)
    clocks = _settled(facts, n_gateways=50)
    assert n_compared == 49
    told = {clock.source.gateway: clock for clock in clocks.report()}
    reference = ahead[int(told["base0"].reference.gateway.removeprefix("base"))]
    for gateway, own in enumerate(ahead):
        clock = told[f"base{gateway}"]
        assert clock.offset_ns is not None
        assert abs(clock.offset_ns - (reference - own)) <= max(clock.bound_ns, 1)
