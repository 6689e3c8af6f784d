"""One random draw at a time, as a pure function of (seed, biobot, stream, index).

The same words as ``draws.words`` gives for whole arrays, in plain integers: for radios and backpacks, which draw singly.
"""

import math

_MASK = (1 << 64) - 1
# Constants of splitmix64: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
_GAMMA = 0x9E3779B97F4A7C15
_MIX_1 = 0xBF58476D1CE4E5B9
_MIX_2 = 0x94D049BB133111EB


def word(*, seed: int, biobot: int, stream: int, index: int) -> int:
    """Hash the key of one draw into 64 bits."""
    state = seed & _MASK
    for part in (biobot, stream, index):
        state = _mix(((state + _GAMMA) & _MASK) ^ ((part * _GAMMA) & _MASK))
    return _mix((state + _GAMMA) & _MASK)


def uniform(*, seed: int, biobot: int, stream: int, index: int) -> float:
    """Draw from (0, 1): never 0, never 1."""
    return ((word(seed=seed, biobot=biobot, stream=stream, index=index) >> 12) + 0.5) * 2.0**-52


def exponential(*, seed: int, biobot: int, stream: int, index: int) -> float:
    """Draw from the exponential distribution of mean 1."""
    return -math.log(uniform(seed=seed, biobot=biobot, stream=stream, index=index))


def _mix(state: int) -> int:
    state = ((state ^ (state >> 30)) * _MIX_1) & _MASK
    state = ((state ^ (state >> 27)) * _MIX_2) & _MASK
    return state ^ (state >> 31)
