"""On which side of each obstacle a way goes: signatures of ways among points in the plane, by the rays they cross.

From the centre of each obstacle a ray goes up, to larger y. A way is written as the rays that it crosses in order, ``+k`` from left to
right and ``-k`` back; a crossing and the same one back directly after it are nothing. What is left is the signature. In the plane without
the centres two ways with the same ends can be drawn into each other if and only if their signatures are equal: the rays are the
generators of the free fundamental groupoid, and a reduced word of one is unique [BLK12, Hat02 1.A].
"""

from collections.abc import Iterable

import numpy as np

from mapper.types import FloatArray

Signature = tuple[int, ...]
"""Reduced: no number is followed by its negative. Obstacles are counted from 1."""


def cross_rays(starts: FloatArray, ends: FloatArray, centres: FloatArray) -> list[Signature]:
    """Return the signature of each of some straight steps.

    Parameters
    ----------
    starts, ends
        Shape (k, 2).
    centres
        Shape (b, 2).

    Notes
    -----
    A step that ends level with a centre and above it has crossed its ray if it came from the left, and one back crosses it again: rays
    belong to their right side. Of rays at one x the lower numbered counts as the left one. A step through a centre passes below it.
    """
    signatures: list[Signature] = [()] * len(starts)
    x, y = centres.T[:, None, :] if len(centres) else np.zeros((2, 1, 0))
    left, right = starts[:, :1], ends[:, :1]
    is_right, is_left = (left < x) & (x <= right), (right < x) & (x <= left)
    width = np.where(right == left, 1.0, right - left)
    height = starts[:, 1:] + (x - left) * (ends[:, 1:] - starts[:, 1:]) / width
    is_crossing = (is_right | is_left) & (height > y)
    for step in np.flatnonzero(is_crossing.any(axis=1)).tolist():
        crossed = np.flatnonzero(is_crossing[step])
        order = crossed[np.lexsort((crossed, centres[crossed, 0]))]
        signatures[step] = tuple((order + 1).tolist()) if is_right[step, order[0]] else tuple((-(order[::-1] + 1)).tolist())
    return signatures


def join(before: Signature, after: Iterable[int]) -> Signature:
    """Return the signature of one way after the other."""
    letters = list(before)
    for letter in after:
        if letters and letters[-1] == -letter:
            letters.pop()
        else:
            letters.append(letter)
    return tuple(letters)


def invert(signature: Signature) -> Signature:
    """Return the signature of the way back."""
    return tuple(-letter for letter in reversed(signature))
