"""Laws of the comparison with theory: the theory is what it is said to be, and insects obey it."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipk

from simulator.legs import Legs
from simulator.motion import MotionParameters
from studies.agreement import Agreement
from studies.encounter_rate import Gas, torus_rate, wall_factor
from studies.larva_dish import fit_two_exponentials
from studies.motion_theory import PARTS, main, mean_squared_displacement, power_law_distribution
from studies.wall_density import time_within, uniform_law_density


@pytest.mark.parametrize("part", PARTS)
def test_insects_obey_theory(part: str) -> None:
    found = PARTS[part](is_quick=True, seed=2)
    assert found
    assert [one.line() for one in found if not one.agrees] == []


def test_a_figure_out_of_its_limit_is_called_out_and_one_without_limit_never() -> None:
    off = Agreement(name="speed", measured=1.1, theory=1.0, within=0.05)
    assert not off.agrees
    assert "DISAGREES" in off.line()
    assert Agreement(name="speed", measured=1.1, theory=1.0, within=None).agrees


def test_displacement_is_straight_at_first_and_diffuses_with_the_persistent_length_at_last() -> None:
    assert mean_squared_displacement(free_paths=1e-4, mean_leg=3.0, persistence=0.7) == pytest.approx((3e-4) ** 2, rel=1e-3)
    assert mean_squared_displacement(free_paths=1e6, mean_leg=3.0, persistence=0.7) == pytest.approx(2 * 3e6 * (3.0 / 0.3), rel=1e-4)


def test_the_distribution_of_legs_has_the_mean_that_was_asked_for() -> None:
    motion = MotionParameters(speed=1.0, mean_leg=1.0, levy_exponent=2.0, longest_leg=20.0)
    length = np.linspace(0.0, 20.0, 200_001)
    beyond = 1.0 - power_law_distribution(length, exponent=2.0, shortest=motion.shortest_leg, longest=20.0)
    assert np.trapezoid(beyond, length) == pytest.approx(1.0, rel=1e-3)
    assert beyond[[0, -1]].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(("radius", "cut"), [(1 / 50, 0.025), (1 / 10, 0.124)])
def test_the_wall_factor_is_the_share_of_pairs_with_both_inside(radius: float, cut: float) -> None:
    inside = quad(lambda a: (1 - radius * math.cos(a)) * (1 - radius * math.sin(a)), 0, math.pi / 2)[0] / (math.pi / 2)
    assert wall_factor(radius) == pytest.approx(inside, rel=1e-12)
    assert 1 - wall_factor(radius) == pytest.approx(cut, abs=0.0005)


def test_landmarks_are_met_at_the_walkers_own_speed() -> None:
    among = torus_rate(Gas(radius=0.1, walkers=10))
    assert torus_rate(Gas(radius=0.1, walkers=10, landmarks=5)) - among == pytest.approx(2 * 0.1 * 5 * 10)
    assert among == pytest.approx(0.1 * 4 * 90 / math.pi)


def test_density_under_the_uniform_law_is_half_the_elliptic_integral_and_one_in_the_mean() -> None:
    rings = np.linspace(0.0, 1.0, 1001)
    density = uniform_law_density(rings[:-1], rings[1:])
    middle = 0.5 * (rings[:-1] + rings[1:])
    np.testing.assert_allclose(density[:900], ellipk(middle[:900] ** 2) / 2, rtol=1e-5)
    assert (density * np.diff(rings**2)).sum() == pytest.approx(1.0, rel=1e-9)


def test_time_within_a_circle_is_that_of_its_chord() -> None:
    """Past the origin at 0.6 with speed 2: a chord of 1.6, so 0.8 s; a rest counts whole or not; a leg that begins inside, in part."""
    legs = Legs(
        biobot=np.arange(4), t_start_s=np.zeros(4), t_end_s=np.array([10.0, 5.0, 5.0, 9.0]),
        x=np.array([-3.0, 0.5, 2.0, 0.0]), y=np.array([0.6, 0.0, 0.0, 0.0]), vx=np.array([2.0, 0.0, 0.0, 0.5]), vy=np.zeros(4),
    )  # fmt: skip
    np.testing.assert_allclose(time_within(legs, radius=1.0), [0.8, 5.0, 0.0, 2.0])


def test_a_mixture_of_two_exponentials_is_recovered() -> None:
    rng = np.random.default_rng(5)
    times = np.where(rng.random(20_000) < 0.2, rng.exponential(50.0, 20_000), rng.exponential(1.0, 20_000))
    np.testing.assert_allclose(fit_two_exponentials(times), (0.2, 1.0, 50.0), rtol=0.05)


def test_the_command_tells_every_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "--part", "rate"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "rate"
    assert all("measured" in line and "theory" in line for line in out[1:])
