"""The study of a map's shape, and the law of its scale."""

from math import exp, log

import numpy as np

from mapper.scale import ScaleLaw, estimate_scale, load_scale_law
from mapper.types import Evidence, Method
from studies.scale_fit import ScaleRun, fit_scale, misses
from studies.shape_check import ShapeCase, compute_shape, describe


def test_the_default_method_is_nearer_to_the_truth_than_the_papers_in_every_respect() -> None:
    ours, theirs = (
        compute_shape(ShapeCase(preset="paper-units", scenario="one-obstacle", method=method, seed=3))
        for method in (Method.DEFAULT, Method.PAPER)
    )
    assert ours.bottleneck[1] < 0.042
    assert ours.placement < 0.06
    for nearer, further in (
        (ours.bottleneck[1], theirs.bottleneck[1]),
        (ours.metric_error, theirs.metric_error),
        (ours.placement, theirs.placement),
        (abs(log(ours.scale)), abs(log(theirs.scale))),
    ):
        assert nearer < further
    assert ours.placement_of_exact < ours.placement
    assert describe([ours]).startswith("paper-units one-obstacle  default ")


def test_fitting_finds_the_law_that_made_the_runs() -> None:
    law = ScaleLaw(
        constant=-0.6,
        straightness=0.2,
        encounters=0.09,
        discs=0.7,
        enough=5000.0,
        per_disc=1.35,
        error=0.05,
        ranges=((-1.5, -0.2), (6.0, 10.5), (0.0, 0.2)),
    )
    rng = np.random.default_rng(1)
    runs = []
    for seed in range(60):
        evidence = Evidence(
            straightness=float(np.exp(rng.uniform(-1.5, -0.2))),
            n_encounters=float(np.exp(rng.uniform(6.0, 10.5))),
            disc_share=float(rng.uniform(0.0, 0.2)),
        )
        runs.append(ScaleRun(seed=seed, evidence=evidence, factor=estimate_scale(evidence, law).factor))
    runs[7] = ScaleRun(seed=7, evidence=runs[7].evidence, factor=0.3 * runs[7].factor)  # a folded map does not pull the others along
    fitted = fit_scale(runs)
    for name in ("constant", "straightness", "encounters", "discs"):
        assert abs(getattr(fitted, name) - getattr(law, name)) < 0.01, name
    assert np.abs(np.delete(misses(fitted, runs), 7)).max() < 0.01
    assert fitted.error < 0.01


def test_beyond_what_the_law_was_fitted_to_nothing_is_extrapolated() -> None:
    law = load_scale_law()
    low, high = (tuple(span[end] for span in law.ranges) for end in (0, 1))
    for edge, beyond in ((low, (-20.0, 0.0, -1.0)), (high, (5.0, 30.0, 1.0))):
        at, past = (
            estimate_scale(Evidence(straightness=exp(r), n_encounters=exp(n), disc_share=a), law).factor for r, n, a in (edge, beyond)
        )
        assert abs(at / past - 1.0) < 1e-9
