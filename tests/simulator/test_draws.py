"""Laws of the keyed random draws."""

from decimal import Decimal, getcontext

import numpy as np

from simulator import draws

MASK = 2**64 - 1


def words(**changed: int) -> int:
    key = {"seed": 1, "biobot": 2, "stream": 3, "index": 4} | changed
    one = draws.words(
        seed=key["seed"], biobot=np.array([key["biobot"]], np.uint64), stream=key["stream"], index=np.array([key["index"]], np.uint64)
    )
    return int(one[0])


def test_the_mixer_is_splitmix64() -> None:
    """First outputs for the state 1234567, as printed with many public implementations of splitmix64."""
    states = np.array([(1234567 + k * 0x9E3779B97F4A7C15) & MASK for k in (1, 2, 3)], np.uint64)
    assert draws._mix(states).tolist() == [6457827717110365317, 3203168211198807973, 9817491932198370423]


def test_every_part_of_the_key_changes_the_draw() -> None:
    assert len({words(), words(seed=2), words(biobot=3), words(stream=4), words(index=5), words(seed=2**64 - 1), words(biobot=2**63)}) == 7


def test_draws_do_not_depend_on_their_company() -> None:
    many = draws.words(seed=9, biobot=np.arange(100, dtype=np.uint64), stream=1, index=np.arange(100, dtype=np.uint64))
    single = [int(draws.words(seed=9, biobot=np.array([k], np.uint64), stream=1, index=np.array([k], np.uint64))[0]) for k in range(100)]
    assert many.tolist() == single


def test_uniform_draws_stay_strictly_between_0_and_1() -> None:
    low, high = draws.uniform(np.array([0, MASK], np.uint64))
    assert 0 < low < 2**-52
    assert 1 - 2**-52 < high < 1


def test_exponential_draws_are_minus_the_logarithm() -> None:
    bits = np.concatenate([np.array([0, MASK], np.uint64), draws.words(seed=1, biobot=np.arange(500, dtype=np.uint64), stream=0,
                           index=np.zeros(500, np.uint64))])  # fmt: skip
    getcontext().prec = 40
    exact = [float(-Decimal(float(u)).ln()) for u in draws.uniform(bits)]
    np.testing.assert_allclose(draws.exponential(bits), exact, rtol=4e-16 * 4, atol=1e-17)


def test_draws_have_the_moments_of_their_distributions() -> None:
    bits = draws.words(seed=5, biobot=np.arange(200_000, dtype=np.uint64), stream=7, index=np.zeros(200_000, np.uint64))
    u, e = draws.uniform(bits), draws.exponential(bits)
    np.testing.assert_allclose([u.mean(), u.var(), e.mean(), e.var()], [1 / 2, 1 / 12, 1, 1], rtol=0.015)


def test_the_circle_is_round_and_in_phase() -> None:
    turns = np.concatenate([np.linspace(-0.25, 1, 4001), np.array([0.125, 0.25, 0.5, 0.75])])
    x, y = draws.circle(turns)
    np.testing.assert_allclose(x * x + y * y, 1, atol=1e-15)
    np.testing.assert_allclose(x, np.cos(2 * np.pi * turns), atol=2e-15)
    np.testing.assert_allclose(y, np.sin(2 * np.pi * turns), atol=2e-15)
