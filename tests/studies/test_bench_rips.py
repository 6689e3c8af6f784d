"""The benchmark of persistence compares diagrams before it tells a time."""

import numpy as np
import pytest

from studies.bench_rips import check_equal, main, time_in_turns
from studies.errors import OtherDiagramError
from studies.rips_peers import Missing, find_peers
from studies.samples import spread
from studies.truth import Floats, Intervals


def test_a_quick_round_compares_all_that_is_installed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--rounds", "1", "--sizes", "20", "60"]) == 0
    out = capsys.readouterr().out
    for kind in ("square, two obstacles", "encounter metric"):
        for n in (20, 60):
            assert f"{kind}, {n} points; diagrams equal" in out
    assert "ours, redzed-tda" in out or "ours, holos-tda" in out


def test_what_is_not_installed_has_a_reason() -> None:
    peers = find_peers()
    assert {"ripser.py", "GUDHI, RipsPersistence"} < peers.keys()
    for peer in peers.values():
        if isinstance(peer, Missing):
            assert "installed" in peer.reason
        elif hasattr(peer, "close"):
            peer.close()


def _bars(*loops: tuple[float, float]) -> Intervals:
    return np.array([[0.0, np.inf]]), np.array(loops, dtype=np.float64).reshape(-1, 2)


def test_another_diagram_is_an_error_and_bars_without_length_are_none() -> None:
    check_equal({"ours": _bars((1, 2), (3, 5)), "other": _bars((3, 5), (4, 4), (1, 2))}, matrix="m")
    with pytest.raises(OtherDiagramError, match="other gives other intervals of dimension 1"):
        check_equal({"ours": _bars((1, 2)), "other": _bars((1, 2), (1, 2))}, matrix="m")


def test_the_time_told_is_the_median_of_the_rounds() -> None:
    seconds = iter([9.0, 1.0, 5.0, 3.0])

    def peer(_: Floats) -> tuple[float, Intervals]:
        return next(seconds), _bars()

    assert time_in_turns(np.zeros((1, 1)), {"one": peer}, rounds=3)[0] == {"one": 3.0}


def test_points_spread_from_the_first() -> None:
    at = np.array([0.0, 1.0, 10.0, 6.0])
    assert spread(np.abs(at[:, None] - at), n_points=3).tolist() == [0, 2, 3]
