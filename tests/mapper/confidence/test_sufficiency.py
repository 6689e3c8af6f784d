"""What is said of the data, and what would help."""

import pytest

from mapper.certainty import sure_text
from mapper.confidence.sufficiency import ACROSS_PARTS, Doubt, Facts, describe_count, judge_data
from mapper.types import HoleCount

_SURE = HoleCount(value=1, probability=0.97, probabilities=(0.01, 0.97, 0.02))
_UNSURE = HoleCount(value=1, probability=0.55, probabilities=(0.3, 0.55, 0.13, 0.02))


def _facts(
    *,
    each: float = 30.0,
    landmarks: int = 10,
    walkers: int = 40,
    apart: float = 0.0,
    count: HoleCount = _SURE,
    seen: float = 0.9,
    span_s: float = 600.0,
    moved: bool = False,
    doubts: tuple[Doubt, ...] = (),
) -> Facts:
    return Facts(
        encounters_each=each,
        n_landmarks=landmarks,
        n_walkers=walkers,
        n_components=1 + (apart > 0),
        apart=apart,
        count=count,
        well_seen=seen,
        span_s=span_s,
        has_moved_on=moved,
        doubts=doubts,
    )


def test_much_of_all_is_enough() -> None:
    verdict = judge_data(_facts())
    assert (verdict.is_enough, verdict.reasons, verdict.remedies) == (True, (), ())


@pytest.mark.parametrize(
    ("facts", "reason", "remedy"),
    [
        (_facts(each=12.0), "12 encounters per biobot; 15 are wanted", "walk 2.5 min more, at the rate so far"),
        (_facts(each=12.0, span_s=0.0), "12 encounters per biobot; 15 are wanted", "walk on"),
        (
            _facts(landmarks=3),
            "3 landmarks in the largest component; 5 are wanted",
            "let 2 more biobots stand still, better 10-20 % of all",
        ),
        (
            _facts(landmarks=0),
            "no landmark in the largest component; 5 are wanted",
            "let 5 more biobots stand still, better 10-20 % of all",
        ),
        (_facts(doubts=(Doubt(reason="they fly", remedy="clip their wings"),)), "they fly", "clip their wings"),
        (_facts(walkers=4), "only 4 biobots walk; 10 are wanted", "let 6 more biobots walk"),
        (
            _facts(apart=0.4),
            "40% of the encounters are not joined to the largest of 2 components by any biobot: the parts have no meeting in common",
            ACROSS_PARTS,
        ),
        (
            _facts(count=_UNSURE),
            "the number of holes is only 55% sure; 0: 30%, 2: 13%",
            "walk 10 min more for twice the encounters, or let more biobots walk",
        ),
        (
            _facts(count=_UNSURE, moved=True),
            "the number of holes is only 55% sure; 0: 30%, 2: 13%",
            "stay longer at each place, or pass it twice",
        ),
        (
            _facts(seen=0.1),
            "90% of the points are badly seen: their distances may be wrong by more than a tenth of the map",
            "let more biobots stand still, spread over the place, and walk on",
        ),
    ],
)
def test_each_lack_is_named_with_its_remedy(facts: Facts, reason: str, remedy: str) -> None:
    """600 s gave 12 encounters for each; 15 take a quarter of the time more."""
    verdict = judge_data(facts)
    assert (verdict.is_enough, verdict.reasons, verdict.remedies) == (False, (reason,), (remedy,))


def test_numbers_that_may_be_instead_are_listed_by_their_chance() -> None:
    assert describe_count(_UNSURE) == "55% sure; 0: 30%, 2: 13%"
    assert describe_count(_SURE) == "97% sure"


def test_nothing_is_called_certain() -> None:
    assert (sure_text(1.0), sure_text(0.0), sure_text(0.5)) == ("over 99% sure", "under 1% sure", "50% sure")
