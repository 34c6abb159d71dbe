# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How far calibrations of one instrument differ: in sigmas, over the detector, and with time.

States
------
Two results of their own data have errors that know nothing of each other ::

    d = x_B - x_A,   C = C_A + C_B,   chi2 = d' C^-1 d   of as many degrees as states    (C.1)

where the difference of the mounting is the small rotation Psi in s, ``C_sg,B C_sg,A'``. Several
agree where they have a common value, its degrees of freedom taken off ::

    m = (sum C_i^-1)^-1 sum C_i^-1 x_i,   chi2 = sum (x_i - m)' C_i^-1 (x_i - m)         (C.2)

Detector
--------
Two cameras that see the same after a turn are the same: it is taken for attitude, or by the
mounting. So the directions r_A that a grid of pixels uv has in A are turned by the rotation R
that brings them nearest to these pixels in B, and what is left is the difference ::

    duv = project_B(R r_A) - uv,   R = argmin sum |duv|^2                                (C.3)

To first order ``duv = M J d``, J by the intrinsics, M what takes the turn out of it; its
covariance says how large chance makes it. A star's direction in the gyro axes differs by the
turn of ::

    C_sg,B' R C_sg,A,   to first order   C_sg,A' (-H^+ J d_camera - d_mounting)          (C.4)

H by the turn: a principal point that is off and a mounting that makes up for it are no difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.distributions import chi2_sf
from starcal_ros.core.units import NS
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.results.read import StoredResult

CHANCE = 1e-3
"""Probability with which calibrations that are the same are said to differ."""
NAMES = STATE_NAMES[CALIBRATED]
GROUPS = {'mounting and camera': slice(3, 13), 'mounting': slice(3, 6), 'camera': slice(6, 13),
          'gyro bias': slice(0, 3)}
RIGID = ('mounting and camera', 'mounting', 'camera')
"""The groups that say whether an instrument is the same; a gyro bias may wander."""
_GRID = 17          # points of each side of the detector
_STEPS = 6          # of Gauss and Newton
_DAY_S = 86400.0


class Agreement(NamedTuple):
    """A chi-square, its degrees of freedom, and the probability of more."""

    chi2: float
    freedom: int

    @property
    def probability(self) -> float:
        """How often chance makes it larger; 1 of nothing."""
        return float(chi2_sf(self.chi2, self.freedom)) if self.freedom else 1.0


class StateDifference(NamedTuple):
    """One state: its name, the difference and its sigma, in STATE_UNITS."""

    name: str
    difference: float
    sigma: float


@dataclass(frozen=True)
class OverDetector:
    """What two cameras differ by, over the detector.

    Attributes
    ----------
    uv : (n, n, 2) array
        Points of the detector, rows of v [px from its centre].
    difference, sigma : (n, n, 2), (n, n) array
        What the implied rotation leaves there, and the root of the mean variance of its two
        axes [px].
    turn : (3,) array
        The implied rotation vector, in s [rad].
    net, net_sigma : (3,) array or None
        Rotation vector by which a star's direction differs in the gyro axes, and the standard
        deviation of each component; None without mountings [rad].
    """

    uv: Array
    difference: Array
    sigma: Array
    turn: Array
    net: Array | None
    net_sigma: Array | None

    @property
    def length(self) -> Array:
        """Length of the differences, (n, n) [px]."""
        return np.linalg.norm(self.difference, axis=-1)


class Trend(NamedTuple):
    """One state over the stamps, or over a quantity: a straight line, against none.

    Its slope and sigma are in STATE_UNITS a day, or a unit of the quantity;
    `constant` is the chi-square about the mean, `line` that about the line.
    """

    name: str
    slope: float
    sigma: float
    constant: Agreement
    line: Agreement


def states(a: StoredResult, b: StoredResult) -> list[StateDifference]:
    """Return the difference b - a of each state that both have estimated or hold."""
    names, d, C = _difference(a, b)
    unit = UNIT[CALIBRATED][-len(d):]
    return [StateDifference(*each) for each in zip(
        names, (d / unit).tolist(), (np.sqrt(np.diagonal(C)) / unit).tolist())]


def agreements(results: Sequence[StoredResult]) -> dict[str, Agreement]:
    """Return the chi-square of each group of states about their common value, Eq. (C.2).

    Of two results that is Eq. (C.1). Groups that a camera alone has not are left out.
    """
    groups = GROUPS if _size(results) == len(NAMES) else {'camera': GROUPS['camera']}
    return {name: _together(results, rows) for name, rows in groups.items()}


def differing(found: Mapping[str, Agreement]) -> list[str]:
    """Return the groups by which an instrument is not the same; several share the chance."""
    tested = [name for name in RIGID if name in found]
    return [name for name in tested if found[name].probability < CHANCE / len(tested)]


def _together(results: Sequence[StoredResult], of: slice) -> Agreement:
    first, size = results[0], _size(results)
    rows = np.arange(len(NAMES))[of] - (len(NAMES) - size)
    free = np.all([np.diagonal(each.covariance)[-size:][rows] > 0.0 for each in results], axis=0)
    chosen = rows[free]
    scale = np.sqrt(sum(np.diagonal(each.covariance)[-size:][chosen] for each in results))
    x = np.array([_value(first, each, size)[chosen] for each in results]) / scale
    weights = [np.linalg.inv(each.covariance[-size:, -size:][np.ix_(chosen, chosen)]
                             / np.outer(scale, scale)) for each in results]
    mean = np.linalg.solve(sum(weights), sum(W @ each for W, each in zip(weights, x)))
    return Agreement(float(sum((each - mean) @ W @ (each - mean) for W, each in zip(weights, x))),
                     (len(results) - 1) * len(chosen))


def over_detector(a: StoredResult, b: StoredResult, detector: Detector) -> OverDetector:
    """Return what two cameras differ by over a detector, Eq. (C.3)."""
    half = 0.5 * (np.array([detector.width, detector.height]) - 1.0)
    u, v = (np.linspace(-each, each, _GRID) for each in half)
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    R, left, H, J = turned_best(uv.reshape(-1, 2), a.intrinsics, b.intrinsics, detector.pitch_mm)
    turned = np.linalg.lstsq(H, J, rcond=None)[0]
    J = J - H @ turned
    variance = np.einsum('ij,jk,ik->i', J, a.of_camera + b.of_camera, J).reshape(-1, 2)
    net = net_sigma = None
    if a.C_sg is not None and b.C_sg is not None:
        net = rotation.log(b.C_sg.T @ R @ a.C_sg)
        G = -a.C_sg.T @ np.hstack((np.eye(3), turned))
        rigid = GROUPS['mounting and camera']
        C = (a.covariance + b.covariance)[rigid, rigid]
        net_sigma = np.sqrt(np.diagonal(G @ C @ G.T))
    return OverDetector(uv, left.reshape(uv.shape),
                        np.sqrt(variance.mean(axis=1)).reshape(uv.shape[:2]),
                        rotation.log(R), net, net_sigma)


def turned_best(uv: Array, before: Array, after: Array, pitch_mm: float
                ) -> tuple[Array, Array, Array, Array]:
    """Return what two cameras differ by when turned to each other, Eq. (C.3).

    Parameters
    ----------
    uv : (n, 2) array
        Places [px from the centre of the detector].
    before, after : (7,) array
        Intrinsics, as in `starcal_ros.core.camera`.
    pitch_mm : float
        Pixel pitch [mm].

    Returns
    -------
    R : (3, 3) array
        The implied rotation.
    left : (n, 2) array
        What it leaves [px].
    H, J : (2 n, 3) and (2 n, 7) array
        Derivatives of the places by turn and intrinsics [px/rad and px a unit].
    """
    r_s, R = camera.unproject(uv, before, pitch_mm), np.eye(3)
    for _ in range(_STEPS):
        there, H_turn, J = camera.linearize(r_s @ R.T, after, pitch_mm)
        H, left = H_turn.reshape(-1, 3), there - uv
        turn = np.linalg.lstsq(H, left.reshape(-1), rcond=None)[0]
        R = rotation.exp(-np.asarray(turn, np.float64)) @ R
    return R, left, H, J.reshape(-1, 7)


def trends(results: Sequence[StoredResult]) -> list[Trend]:
    """Return how each state goes with the stamps; nothing where they are less than three."""
    stamps = [each.stamp_ns for each in results]
    if None in stamps:
        return []
    return trends_over(results, (
        np.array(stamps) - min(each for each in stamps if each is not None)) * NS / _DAY_S)


def trends_over(results: Sequence[StoredResult], t: Array) -> list[Trend]:
    """Return how each state goes with a quantity, one value a result.

    Nothing where it has less than three different values: they say nothing of a straight line.
    """
    if len(np.unique(t)) < 3:
        return []
    size, found = _size(results), list[Trend]()
    values = np.array([_value(results[0], each, size) for each in results])
    sigmas = np.array([np.sqrt(np.diagonal(each.covariance)[-size:]) for each in results])
    unit = UNIT[CALIBRATED][-size:]
    for k, name in enumerate(NAMES[-size:]):
        if not (sigmas[:, k] > 0.0).all():
            continue
        y, sigma = (values[:, k] - values[0, k]) / unit[k], sigmas[:, k] / unit[k]
        weight = sigma**-2
        about = y - np.average(y, weights=weight)
        moment = t - np.average(t, weights=weight)
        spread = float(weight @ moment**2)
        slope = float(weight @ (moment * about)) / spread
        found.append(Trend(name, slope, spread**-0.5,
                           Agreement(float(weight @ about**2), len(t) - 1),
                           Agreement(float(weight @ (about - slope * moment)**2), len(t) - 2)))
    return found


def _size(results: Sequence[StoredResult]) -> int:
    return min(len(each.covariance) for each in results)


def _value(origin: StoredResult, result: StoredResult, size: int) -> Array:
    """Return the last `size` of the calibrated states, the mounting as Psi away from another."""
    if result.bias is None or result.C_sg is None or origin.C_sg is None or size < len(NAMES):
        return result.intrinsics
    return np.concatenate((result.bias, rotation.log(result.C_sg @ origin.C_sg.T),
                           result.intrinsics))


def _difference(a: StoredResult, b: StoredResult) -> tuple[tuple[str, ...], Array, Array]:
    size = _size((a, b))
    C = a.covariance[-size:, -size:] + b.covariance[-size:, -size:]
    return tuple(NAMES[-size:]), _value(a, b, size) - _value(a, a, size), C
