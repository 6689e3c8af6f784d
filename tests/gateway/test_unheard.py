"""Laws of what is taken for the unheard part of an encounter."""

import random
from itertools import pairwise

import pytest

from gateway.unheard import BeaconLoss, guesses, n_missed


def _first_heard(rng: random.Random, loss: float) -> float:
    """How long after a contact began one side hears its first beacon [periods]: each comes up to a tenth late, and some are lost."""
    phase, number = rng.random(), 0
    while True:
        at = phase + number + 0.1 * (rng.random() - rng.random())
        if at >= 0.0 and rng.random() >= loss:
            return at
        number += 1


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.2, 0.3])
def test_the_begin_is_within_the_bound_of_the_guess_as_often_as_it_says(loss: float) -> None:
    """4000 contacts that two sides hear of, and as many that one does; own simulation of beacons."""
    rng, table = random.Random(7), guesses(loss)
    within_both = within_alone = 0
    for _ in range(4000):
        one, other = _first_heard(rng, loss), _first_heard(rng, loss)
        earlier, half = table.between(abs(one - other))
        within_both += abs(min(one, other) - earlier) <= half
        earlier, half = table.of_alone
        within_alone += abs(one - earlier) <= half
    assert within_both >= 0.975 * 4000
    assert within_alone >= 0.975 * 4000


def test_without_loss_a_guess_is_at_most_half_a_period() -> None:
    table = guesses(0.0)
    assert table.of_alone[0] == 0.5
    for gap in (0.0, 0.3, 0.99, 1.05):
        earlier, half = table.between(gap)
        assert earlier <= 0.5
        assert half <= 0.6
    assert table.n_bridged == table.n_bridged_alone == 0


def test_the_more_beacons_are_lost_the_wider_the_bound_and_the_gap_that_is_bridged() -> None:
    tables = [guesses(loss) for loss in (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)]
    for less, more in pairwise(tables):
        assert less.of_alone[1] <= more.of_alone[1]
        assert less.n_bridged <= more.n_bridged
        assert less.n_bridged_alone <= more.n_bridged_alone
        assert more.n_bridged <= more.n_bridged_alone


def test_a_beacon_that_is_merely_late_was_not_missed() -> None:
    assert [n_missed(gap) for gap in (0.0, 0.99, 1.09, 1.11, 2.05, 2.2)] == [0, 0, 0, 1, 1, 2]


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3])
def test_the_share_of_lost_beacons_is_found_from_the_gaps_between_reports(loss: float) -> None:
    """A side's contact of 20 beacons falls into reports, each of beacons heard in a row."""
    rng, found = random.Random(3), BeaconLoss()
    for _ in range(300):
        heard = [k for k in range(20) if rng.random() >= loss]
        ends = [k for k in heard if k + 1 not in heard]
        begins = [k for k in heard if k - 1 not in heard]
        before = None
        for begin, end in zip(begins, ends, strict=True):
            found.observe(duration=float(end - begin), gap=0.0 if before is None else float(begin - before))
            before = end
    # What was lost before a side's first report and after its last is not seen.
    assert abs(found.share - loss) <= 0.15 * loss + 0.001
    assert abs(found.now.loss - loss) <= 0.05
