"""The first graphs of the study; all of them are in docs/mission.md."""

import pytest

from studies.landmark_choice import GRAPHS, MOST_OVER_BEST, make_graph, measure_cover


@pytest.mark.parametrize("name", GRAPHS)
def test_chosen_landmarks_cover_better_than_those_drawn_at_random(name: str) -> None:
    for seed in (1, 2):
        cover = measure_cover(make_graph(seed=seed, reach=GRAPHS[name]), seed=seed, n_draws=200)
        assert cover.ours <= MOST_OVER_BEST * cover.best
        assert cover.ours < cover.median
