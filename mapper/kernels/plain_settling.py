"""Settling of tracks in numpy alone: as settling.c, rounded alike, because every sum is made in the order of the links."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from mapper.kernels.arrays import Links, Tension
from mapper.types import BoolArray, FloatArray, IntArray

# As in settling.c.
_TURN_LIMIT: Final = 3.0
_LENGTH_LIMIT: Final = 2.0
_NO_LENGTH: Final = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Weights:
    """Of lengths and of changes of velocity, shape (k,), and the diagonal of the equations (v,)."""

    tension: FloatArray
    stiffness: FloatArray
    diagonal: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Net:
    """The equations: where each link adds to, and how much.

    A link adds to its target and source, and with a link before to target, that one's source, and its own source: ``places`` (r,) are those
    vertices, link after link, and ``is_used`` (k, 5) says which of the five there are.
    """

    source: IntArray
    target: IntArray
    origin: IntArray
    has_before: BoolArray
    is_used: BoolArray
    places: IntArray
    time: FloatArray
    pull: FloatArray
    to_target: FloatArray
    to_origin: FloatArray


def settle(links: Links, start: FloatArray, pull: FloatArray, *, tension: Tension, rounds: int, steps: int) -> FloatArray:
    """See `Kernels.settle_tracks`."""
    net = _make_net(links, pull, blur=tension.blur)
    xy = start.copy()
    for _ in range(rounds):
        weights, right = _weigh(net, start, xy, tension)
        xy = _solve(net, weights, right, xy, steps=steps)
    return xy


def _make_net(links: Links, pull: FloatArray, *, blur: float) -> _Net:
    source, target, before = (column.astype(np.int64) for column in (links.sources, links.targets, links.before))
    has_before = before >= 0
    origin = np.where(has_before, source[before], 0) if len(before) else before
    is_used = np.column_stack([np.ones((len(source), 2), dtype=bool), *[has_before] * 3])
    per_time = 1 / np.maximum(links.times, blur)
    return _Net(
        source=source,
        target=target,
        origin=origin,
        has_before=has_before,
        is_used=is_used,
        places=np.column_stack([target, source, target, origin, source])[is_used],
        time=links.times,
        pull=pull,
        to_target=per_time,
        to_origin=per_time[before] if len(before) else per_time,
    )


def _weigh(net: _Net, start: FloatArray, xy: FloatArray, tension: Tension) -> tuple[_Weights, FloatArray]:
    """Return the weights, and the right side of the equations, shape (v, 2)."""
    blur2, swerve2 = tension.blur * tension.blur, tension.swerve * tension.swerve
    apart = xy[net.target] - xy[net.source]
    length = np.sqrt(apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1]) + _NO_LENGTH * tension.blur
    excess = length - net.time
    lag = tension.drift * net.time
    loose = 1 / ((blur2 + lag * lag) + excess * excess / (_LENGTH_LIMIT * _LENGTH_LIMIT))
    weights = np.where(excess > 0, 1 / blur2, loose)
    force = (weights * net.time / length)[:, None] * apart
    right = net.pull[:, None] * start
    np.add.at(right, np.column_stack([net.target, net.source]).ravel(), np.stack([force, -force], axis=1).reshape(-1, 2))
    s, f = net.to_target, net.to_origin
    m = f + s
    change = _changes(net, xy)
    variance = blur2 * (f * f + s * s + m * m) + swerve2
    square = change[:, 0] * change[:, 0] + change[:, 1] * change[:, 1]
    stiffness = np.where(net.has_before, 1 / (variance + square / (_TURN_LIMIT * _TURN_LIMIT)), 0.0)
    diagonal = net.pull.copy()
    shares = np.column_stack([weights, weights, stiffness * s * s, stiffness * f * f, stiffness * m * m])
    np.add.at(diagonal, net.places, shares[net.is_used])
    return _Weights(tension=weights, stiffness=stiffness, diagonal=diagonal), right


def _changes(net: _Net, xy: FloatArray) -> FloatArray:
    """Return the change of velocity where each link begins, shape (k, 2); without meaning where no link is before."""
    s, f = net.to_target[:, None], net.to_origin[:, None]
    return np.asarray(s * xy[net.target] + f * xy[net.origin] - (f + s) * xy[net.source])


def _apply(net: _Net, weights: _Weights, xy: FloatArray) -> FloatArray:
    left = net.pull[:, None] * xy
    drawn = weights.tension[:, None] * (xy[net.target] - xy[net.source])
    bent = weights.stiffness[:, None] * _changes(net, xy)
    s, f = net.to_target[:, None], net.to_origin[:, None]
    parts = np.stack([drawn, -drawn, s * bent, f * bent, -((f + s) * bent)], axis=1)
    np.add.at(left, net.places, parts[net.is_used])
    return left


def _multiply(one: FloatArray, other: FloatArray) -> FloatArray:
    product = one * other
    if len(product) % 2:
        product = np.concatenate([product, np.zeros((1, 2))])
    lanes = np.cumsum(product.reshape(-1, 4), axis=0)[-1]
    return np.array([lanes[0] + lanes[2], lanes[1] + lanes[3]])


def _ratio(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.divide(one, other, out=np.zeros(2), where=other > 0)


def _solve(net: _Net, weights: _Weights, right: FloatArray, xy: FloatArray, *, steps: int) -> FloatArray:
    residual = right - _apply(net, weights, xy)
    way = residual / weights.diagonal[:, None]
    before = _multiply(residual, way)
    for _ in range(steps):
        left = _apply(net, weights, way)
        step = _ratio(before, _multiply(way, left))
        xy = xy + step * way
        residual = residual - step * left
        scaled = residual / weights.diagonal[:, None]
        now = _multiply(residual, scaled)
        way = scaled + _ratio(now, before) * way
        before = now
    return xy
