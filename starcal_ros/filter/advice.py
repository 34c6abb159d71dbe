# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The motion that would make the estimates better.

The filter's own covariance is carried through a minute of each of some motions, seen by a few
frames of an even star field: a rest, a rotation of 30 degrees about each of the gyro's axes either
way, and, where the gyro turns at present, that rotation as it is, backwards, at twice and at half
the rate. The motion that leaves least of the sigmas is recommended if it leaves less than `WORTH`
of what going on as at present leaves: what more frames alone would settle needs no other motion.
Which motion it is hardly depends on the noise that is assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
import re
from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import Filter
from starcal_ros.measurements.preintegration import Preintegrated

RATE = 0.5 * DEG
"""Rate of the rotations that are tried: 30 degrees in a minute, T18 Table 2 [rad/s]."""
WORTH = 0.9
"""What a motion may leave, at most, of the sigmas that the present one leaves."""
FRAMES = 'more frames are needed'
"""Advice where no motion is worth more than the present one."""

_ROTATE = 'rotate about '
_AXIS = re.compile(_ROTATE + '(-?[XYZ])')
_LENGTH_S = 60.0        # of a motion
_LOOKS = 6              # times that the stars are looked at on the way
_LOOK_PX = 0.02         # sigma of a centroid of a look: some six frames of 0.05 px
_GRID = 5               # stars of a look, along each side of the detector
_TURNS = 0.02 * DEG     # rate from which on the gyro turns [rad/s]
_NOISE = 50.0           # and in roots of 1/s of its angular random walk: five sigma at 100 Hz
_TIE = 1.1              # a motion must be so much better than one that is named before it


class Manoeuvre(NamedTuple):
    """One motion.

    Attributes
    ----------
    text : str
        What to do.
    rate : (3,) array
        Rate of g, in g [rad/s].
    """

    text: str
    rate: Array


class Ahead(NamedTuple):
    """What some motions would make of the sigmas.

    Attributes
    ----------
    texts : tuple of str
        What to do; the first, `FRAMES`, goes on as at present.
    sigma : (k, 16 + m) array
        Of all states after each, in the filter's units.
    """

    texts: tuple[str, ...]
    sigma: Array

    def best(self, states: Sequence[int]) -> str:
        """Return what leaves least of the sigmas of some states, on geometric average."""
        part = self.sigma[:, list(states)]
        left = np.exp(np.mean(np.log(part / part[0]), axis=-1))
        good = left <= min(_TIE * left.min(), WORTH)
        return self.texts[int(np.argmax(good))] if good.any() else FRAMES


def look_ahead(filter_: Filter, belief: Belief) -> Ahead:
    """Return what the motions would make of the sigmas."""
    tried = motions(present_rate(belief.estimate), _TURNS + _NOISE * filter_.walk)
    return Ahead(tuple(motion.text for motion in tried),
                 sigmas(filter_, belief, np.array([motion.rate for motion in tried])))


def present_rate(now: Nominal) -> Array:
    """Return the rate of g at the last frame, (3,), in g [rad/s]."""
    rate: Array = now.augmentation.gain(now.augmented) @ (now.reading - now.bias)
    return rate


def motions(rate: Array, least: float) -> list[Manoeuvre]:
    """Return the motions to compare, the present one first.

    Parameters
    ----------
    rate : (3,) array
        Present rate of g, in g [rad/s].
    least : float
        What counts as a rest.
    """
    turns = [Manoeuvre(f'{_ROTATE}{sign}{axis}', (-RATE if sign else RATE) * along)
             for sign in ('', '-') for axis, along in zip('XYZ', np.eye(3))]
    if not np.linalg.norm(rate) > least:
        return [Manoeuvre(FRAMES, np.zeros(3)), *turns]
    others = (('reverse the rotation', -1.0), ('rotate twice as fast', 2.0),
              ('rotate half as fast', 0.5))
    return [Manoeuvre(FRAMES, rate), Manoeuvre('stop the rotation', np.zeros(3)), *turns[:3],
            *(Manoeuvre(text, factor * rate) for text, factor in others), *turns[3:]]


def advised_axis(text: str) -> str:
    """Return the axis of g about which an advice says to rotate, as 'Y' or '-Y'; '' of none."""
    found = _AXIS.search(text)
    return found[1] if found else ''


def sigmas(filter_: Filter, belief: Belief, rates: Array) -> Array:
    """Return the sigmas of all states, (k, 16 + m), after each of k motions of rates (k, 3)."""
    k, now = len(rates), belief.estimate
    ahead = Belief(Nominal.stacked([now] * k), np.zeros((k, len(belief.error))),
                   np.broadcast_to(belief.root, (k, *belief.root.shape)))
    step, R = _interval(filter_, now, rates), None
    for _ in range(_LOOKS):
        ahead = filter_.propagate(ahead, step)
        # The rate is constant, so that all looks are alike.
        R = _look(filter_, ahead.nominal) if R is None else R
        M = R @ ahead.root
        L = np.linalg.cholesky(np.eye(M.shape[-1]) + np.swapaxes(M, -1, -2) @ M)
        root = np.swapaxes(np.linalg.solve(L, np.swapaxes(ahead.root, -1, -2)), -1, -2)
        ahead = Belief(ahead.nominal, ahead.error, root)
    return np.linalg.norm(ahead.whole_root, axis=-1)


def _interval(filter_: Filter, now: Nominal, rates: Array) -> Preintegrated:
    """Return the gyro's account of the time between two looks, for the bias of the start."""
    k, dt = len(rates), _LENGTH_S / _LOOKS
    readings = rates @ np.linalg.inv(now.augmentation.gain(now.augmented)).T + now.bias
    measured = readings - filter_.start.bias
    J = dt * rotation.right_jacobian(-measured * dt)
    if now.augmentation.needs_matrix:       # J_r dt (I kron omega')
        J = np.concatenate((J, (J[..., None] * measured[:, None, None]).reshape(k, 3, 9)), axis=-1)
    return Preintegrated(rotation.exp(-measured * dt), J, np.full(k, dt), np.zeros(k), readings,
                         np.ones(k), np.full(k, dt),
                         readings, filter_.start.bias)


def _look(filter_: Filter, nominal: Nominal) -> Array:
    """Return a root, (k, n, n), of the information of one look on the scaled states."""
    half = 0.5 * np.array([filter_.detector.width, filter_.detector.height])
    side = np.linspace(-1.0, 1.0, _GRID) * (1.0 - 1.0 / _GRID)
    uv = half * np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    r_s = camera.unproject(uv, nominal.intrinsics[0], filter_.detector.pitch_mm)
    _, H, _ = filter_.model.predict(nominal, r_s @ nominal.C_si)
    H, _ = filter_.model.whitened(nominal, H, np.zeros(H.shape[:-1]))
    H = H * (nominal.augmentation.scale / _LOOK_PX)
    return np.asarray(np.linalg.qr(H.reshape(len(H), -1, H.shape[-1]), mode='r'), np.float64)
