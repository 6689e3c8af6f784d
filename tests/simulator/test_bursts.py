"""Laws of burst loss."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from simulator.errors import ParameterError
from simulator.radios.bursts import BurstLoss

GOOD_S, BAD_S = 8.0, 2.0


def strikes(loss: BurstLoss, t_s: NDArray[np.float64], *, sender: int | NDArray[np.int64] = 1, first: int = 0) -> NDArray[np.bool_]:
    who = np.broadcast_to(np.asarray(sender, dtype=np.uint64), t_s.shape)
    number = np.arange(first, first + t_s.size, dtype=np.uint64)
    return loss.strikes(sender=who, receiver=np.full(t_s.shape, 9, np.uint64), number=number, t_ns=np.rint(t_s * 1e9).astype(np.int64))


def test_the_stationary_loss_and_the_lengths_of_bursts_are_those_asked_for() -> None:
    """100,000 s of one link hold some 10,000 bursts: both means are known within 2 % or so (3 standard errors are 3 %)."""
    step_s = 0.1
    struck = strikes(BurstLoss(seed=3, good_s=GOOD_S, bad_s=BAD_S), np.arange(0, 100_000, step_s))
    assert struck.mean() == pytest.approx(BAD_S / (GOOD_S + BAD_S), rel=0.04)
    n_bursts = int((struck[1:] & ~struck[:-1]).sum())
    assert struck.sum() * step_s / n_bursts == pytest.approx(BAD_S, rel=0.06)
    assert (~struck).sum() * step_s / n_bursts == pytest.approx(GOOD_S, rel=0.06)


def test_how_long_a_link_is_left_alone_decides_how_much_it_remembers() -> None:
    """Correlation after t is exp(-t (1/good + 1/bad)), here 0.535 after 1 s."""
    struck = strikes(BurstLoss(seed=4, good_s=GOOD_S, bad_s=BAD_S), np.arange(0.0, 60_000.0)).astype(float)
    assert np.corrcoef(struck[:-1], struck[1:])[0, 1] == pytest.approx(np.exp(-(1 / GOOD_S + 1 / BAD_S)), abs=0.02)


def test_links_fail_independently_and_begin_in_their_stationary_state() -> None:
    first = strikes(BurstLoss(seed=5, good_s=GOOD_S, bad_s=BAD_S), np.zeros(20_000), sender=np.arange(20_000))
    assert first.mean() == pytest.approx(0.2, abs=0.01)


@given(cuts=st.lists(st.integers(0, 300), max_size=5))
def test_asking_in_pieces_changes_nothing(cuts: list[int]) -> None:
    t_s, sender = np.repeat(np.arange(100) * 0.7, 3), np.tile(np.array([1, 2, 3]), 100)
    whole = strikes(BurstLoss(seed=6, good_s=GOOD_S, bad_s=BAD_S), t_s, sender=sender)
    loss = BurstLoss(seed=6, good_s=GOOD_S, bad_s=BAD_S)
    edges = sorted({0, 300, *cuts})
    pieces = [strikes(loss, t_s[a:b], sender=sender[a:b], first=a) for a, b in itertools.pairwise(edges)]
    assert np.array_equal(np.concatenate(pieces), whole)


def test_it_agrees_with_one_step_after_another() -> None:
    """The slow way: of each packet the probabilities from the state before, and its own draw."""
    t_s = np.cumsum(np.random.default_rng(1).exponential(1.0, 500))
    fast = strikes(BurstLoss(seed=7, good_s=GOOD_S, bad_s=BAD_S), t_s)
    loss = BurstLoss(seed=7, good_s=GOOD_S, bad_s=BAD_S)
    assert [bool(strikes(loss, t_s[k : k + 1], first=k)[0]) for k in range(500)] == fast.tolist()


def test_a_burst_without_duration_is_refused() -> None:
    with pytest.raises(ParameterError, match="wanted two positive finite durations"):
        BurstLoss(seed=1, good_s=0.0, bad_s=1.0)
