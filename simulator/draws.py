"""Random draws that are a pure function of (seed, biobot, index): no generator, no state, no order.

Only additions, multiplications, divisions and square roots are used on floats, which IEEE 754 rounds the same everywhere; the
logarithm and the circle are computed here from those, because the ones of a C library or a vector unit differ in the last bit
from one machine to the next.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]

# Constants of splitmix64: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)

_LN_2 = 0.6931471805599453
_TWO_PI = 6.283185307179586


def words(*, seed: int, biobot: Words, stream: int, index: Words) -> Words:
    """Hash the key of each draw into 64 bits.

    Parameters
    ----------
    seed
        0 to 2^64 - 1.
    biobot, index
        Identity and number of each draw, shape (k,).
    stream
        Sets apart draws of different use under one index.

    Returns
    -------
    Words
        Shape (k,). Each part of the key goes through one full round of splitmix64 on top of the parts before it.
    """
    state = np.full(biobot.shape, seed, dtype=np.uint64)
    for part in (biobot, np.full(biobot.shape, stream, dtype=np.uint64), index):
        state = _mix((state + _GAMMA) ^ (part * _GAMMA))
    return _mix(state + _GAMMA)


def uniform(bits: Words) -> Floats:
    """Map 64 random bits to the middle of one of 2^52 equal parts of (0, 1): never 0, never 1."""
    return ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def exponential(bits: Words) -> Floats:
    """Map 64 random bits to an exponential variable of mean 1: finite and positive."""
    fraction, exponent = np.frexp(uniform(bits))
    small = fraction < 0.7071067811865476
    fraction = np.where(small, 2.0 * fraction, fraction)
    exponent = np.where(small, exponent - 1, exponent)
    # ln m = 2 artanh((m - 1) / (m + 1)), |argument| < 0.172: the 12th term is below 1e-18.
    ratio = (fraction - 1.0) / (fraction + 1.0)
    square = ratio * ratio
    series = np.full_like(ratio, 1.0 / 23.0)
    for odd in range(21, 0, -2):
        series = series * square + 1.0 / odd
    return -(exponent * _LN_2 + 2.0 * ratio * series)


def circle(turns: Floats) -> tuple[Floats, Floats]:
    """Return cosine and sine of an angle given in turns, shape (k,), within 1e-15."""
    quarter = np.rint(4.0 * turns)
    angle = (turns - 0.25 * quarter) * _TWO_PI  # from -pi/4 to pi/4; the difference is exact
    square = angle * angle
    sine = np.ones_like(angle)
    cosine = np.ones_like(angle)
    for n in range(16, 0, -2):  # Taylor series to angle^17 and angle^18: the next terms are below 1e-18
        sine = 1.0 - sine * square / (n * (n + 1.0))
        cosine = 1.0 - cosine * square / ((n + 2.0) * (n + 1.0))
    cosine = 1.0 - cosine * square / 2.0
    sine = sine * angle
    turn = quarter.astype(np.int64) % 4
    swapped = turn % 2 == 1
    x = np.where(swapped, sine, cosine)
    y = np.where(swapped, cosine, sine)
    return np.where((turn == 1) | (turn == 2), -x, x), np.where(turn >= 2, -y, y)


def _mix(state: Words) -> Words:
    state = (state ^ (state >> np.uint64(30))) * _MIX_1
    state = (state ^ (state >> np.uint64(27))) * _MIX_2
    return state ^ (state >> np.uint64(31))
