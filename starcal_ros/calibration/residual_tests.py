# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the residuals of stars are noise, once camera and attitudes are fitted.

Model
-----
The residuals of n stars, each divided by its sigma, are z = H x + e with the errors x of camera
(seven, less those that are held) and attitudes (three a frame). Where the model is right, e is
white. What no camera and no attitude explains is ::

    Q Q' = H (H'H)^-1 H',   P = I - Q Q',   P z = P e,   z'P z ~ s^2 chi2(m)
    m = 2 n - rank H                                                                   (T.1)

with s^2 = 1 where the stated sigmas are right. Whatever camera the residuals were taken with, P z
is the same to first order: the tests need no method's weights, and no covariance of its camera.
A pattern that a right model does not show, with directions D (2 n, k), is found by its score ::

    q = D'P z,   G = D'P D,   c = q'G^-1 q
    F = (c / k) / ((z'P z - c) / (m - k)) ~ F(k, m - k)                                (T.2)

where s^2 cancels: a pattern is judged against the scatter of these very stars, and sigmas that
are wrong by a factor give no false alarm. Directions that camera and attitudes explain drop out.

The camera of a method is compared with the one that these stars ask for. With Q_c the columns of Q
that belong to the camera, A = Q_c'H and C its stated covariance ::

    t = Q_c'z,   cov t <= s^2 (I + A C A'),   t'(I + A C A')^-1 t / (k s^2) <~ F(k, m)     (T.3)

The bound holds because the stars tested are among those that the camera was made of: its error
goes along with theirs. Held-out images are compared likewise, with their own attitudes out.

A statistic fails where chance gives its value less than `ALARM` of the time. Level and held-out
images may be off by `MARGIN` beyond that, or by what a source of sigmas is worth; scatter by
`SCATTER`. A right fit rejects next to nothing, but wrong identifications are what the gate is for:
up to `REJECTED` of the stars may go.

Limits: with T the mean of k F at which a test fails, a pattern of amplitude a in n stars is found
in one case of two where ``a^2 n w = sigma^2 (T - k)``, w the mean square length of what camera
and attitudes leave of the pattern of amplitude 1. What they explain is not found at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration.bundle_adjustment import Adjusted, Observations
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.distributions import chi2_ppf, f_isf, f_ppf
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.statistic import ALARM, Statistic
from starcal_ros.filter.innovation_tests import MARGIN

SCATTER = 2.0
"""Factor by which the variance of a cell or a brightness may differ from that of the rest."""
REJECTED = 0.3
"""Share of the stars that may be rejected."""
GROUPS = 12
"""Runs of frames, each with a camera of its own, that are compared, at most."""

LEVEL, REJECTIONS = 'NIS of the centroids', 'share of rejected stars'
LENS, CELLS, PHASE = 'lens beyond the model', 'mean over the detector', 'mean over the pixel'
TIME, AGREEMENT = 'camera from frame to frame', 'camera of the method against these stars'
SCATTER_CELLS, SCATTER_MAGNITUDE = 'scatter over the detector', 'scatter over the magnitude'
IMAGES = 'images that ask for another camera'
AIR = 'air of another time, or none'
HELD_OUT = 'held-out images against fitted ones'

_LEAST = 30             # degrees of freedom before a statistic says anything
_A_CELL = 20            # stars of a cell, on average, at least
_FINE, _COARSE = 8, 4   # cells along each side, at most
_RINGS, _BRIGHTNESSES = 4, 5
_RANK = 1e-7            # singular value, of the largest, from which a column counts
_LEFT = 1e-3            # part of a direction that camera and attitudes must leave


AS_STATED = (1.0,) * 7
"""Factors of a camera whose sigmas are right."""


class FittedStars(NamedTuple):
    """Stars of some frames, their attitudes fitted and the camera held.

    Attributes
    ----------
    frame : (n,) int array
        Frame of each star, not decreasing.
    uv : (n, 2) array
        Predicted centroids, from the centre of the detector [px]. The measured ones hold the very
        noise that is tested: a star at rest would seem displaced by its place in the pixel.
    sigma : (n,) array
        Standard deviation of each axis [px].
    magnitude : (n,) array
        NaN where it is not known.
    z : (n, 2) array
        Measured minus predicted centroid, in sigmas.
    by_attitude : (n, 2, 3) or (n, 2, 4) array
        d (predicted centroid) / d rotation, in sigmas; and by the focal length that a frame has
        for itself, where it has one.
    by_camera : (n, 2, p) array
        The same by the intrinsics, in units of `scale`.
    scale : (p,) array
        That of the lens model.
    rejected : int
        Stars that the gate took.
    """

    frame: Ints
    uv: Array
    sigma: Array
    magnitude: Array
    z: Array
    by_attitude: Array
    by_camera: Array
    scale: Array
    rejected: int


@dataclass(frozen=True)
class Consistency:
    """What the residuals say.

    Attributes
    ----------
    statistics : tuple of Statistic
    centroid_factor : float or None
        How much larger than stated the variances of the centroids are; None where nothing is
        stated, or too little is known.
    camera_factors : tuple of float
        By what the variance of each of the intrinsics is to be multiplied to be believed; 1
        where all tests pass.
    why : str
        Why there is no statistic, if there is none.
    """

    statistics: tuple[Statistic, ...] = ()
    centroid_factor: float | None = None
    camera_factors: tuple[float, ...] = AS_STATED
    why: str = ''

    def beside(self, other: Consistency) -> Consistency:
        """Return these tests and others of the same camera."""
        statistics = other.statistics + self.statistics
        factor = self.centroid_factor
        return Consistency(
            statistics, other.centroid_factor if factor is None else factor,
            tuple(max(pair) for pair in zip_longest(
                self.camera_factors, other.camera_factors, fillvalue=1.0)),
            '' if statistics else other.why or self.why)

    @property
    def failed(self) -> tuple[Statistic, ...]:
        """The statistics outside their bands."""
        return tuple(each for each in self.statistics if not each.passed)


def fitted_stars(spots: Observations, adjusted: Adjusted, magnitude: Array, lens: LensModel
                 ) -> FittedStars:
    """Return the stars inside the gate, linearised at their camera.

    Parameters
    ----------
    spots : Observations
        Of known direction.
    adjusted : Adjusted
        Their fit.
    magnitude : (m,) array
        Of each spot, NaN where it is not known.
    lens : LensModel
        What the camera is.
    """
    used = adjusted.used
    frame, sigma = spots.frame[used], spots.sigma[used]
    r_s = adjusted.C_si[frame] @ spots.u_i[used][..., None]
    uv, by_attitude, by_camera = (each[:, 0] for each in lens.linearize(
        np.swapaxes(r_s, 1, 2), adjusted.intrinsics_of(frame)))
    weight = (1.0 / sigma)[:, None, None]
    by_attitude, by_camera = weight * by_attitude, weight * by_camera * lens.scale
    if adjusted.own_f is not None:       # it goes with the attitude
        by_attitude = np.concatenate((by_attitude, by_camera[..., 2:3]), axis=-1)
        by_camera[..., 2] = 0.0
    return FittedStars(
        frame, uv, sigma, magnitude[used], adjusted.residual[used] / sigma[:, None],
        by_attitude, by_camera, lens.scale, int((~used).sum()))


def consistency(stars: FittedStars, estimate: CameraEstimate, detector: Detector, gated: float,
                margin: float | None = MARGIN, stated: float = 1.0, walks: bool = False,
                heldout: FittedStars | None = None) -> Consistency:
    """Return all tests of the residuals.

    Parameters
    ----------
    stars : FittedStars
        All that the camera was fitted to, or some of them.
    estimate : CameraEstimate
        The camera that they were fitted with.
    detector : Detector
    gated : float
        Mean of the squared residual of a star that passed the gate, over that of any star.
    margin : float, optional
        Factor by which the variance of a centroid may be off; None where nobody stated it.
    stated : float
        The variance that was stated over that of `stars`.
    walks : bool
        Whether the camera changes as the model knows: it is then freed in each run of frames.
    heldout : FittedStars, optional
        Stars that took no part.
    """
    free = estimate.sigma > 0.0
    if not len(stars.frame):
        return Consistency(why=TOO_FEW.format(0))
    by_camera = stars.by_camera[..., free]
    left = _Left(stars, _of_runs(stars.frame, by_camera) if walks else by_camera)
    if left.freedom < _LEAST:
        return Consistency(why=TOO_FEW.format(max(left.freedom, 0)))
    variance = left.squares / left.freedom / gated
    found, factors = [], [np.full(int(free.sum()), variance)]
    if margin is not None:
        found.append(_level(variance / stated, left.freedom, margin))
    C = (estimate.covariance / np.outer(stars.scale, stars.scale))[np.ix_(free, free)]
    more = max(1.0, estimate.stars / len(stars.frame))      # stars that show the same pattern
    for name, directions in _patterns(stars, estimate, detector, by_camera):
        looked = left.pattern(name, directions, None if walks else C)
        if looked is not None:
            test, moved = looked
            found.append(test)
            if not test.passed:
                # What has a shape moves the camera by a known amount; what has none by chance.
                like_noise = 1.0 + (test.value - 1.0) * more if name in (CELLS, TIME) else 1.0
                factors.append(variance * like_noise + moved)
    if free.any() and not walks:
        found.append(left.agreement(C, variance))
        if not found[-1].passed:
            factors.append(factors[0] * found[-1].value)
    found += left.scatter(SCATTER_CELLS, _cell(stars.uv, detector, _COARSE),
                          _quantile(np.linalg.norm(stars.uv, axis=1), _RINGS))
    known = np.isfinite(stars.magnitude)
    if known.all():
        found += left.scatter(SCATTER_MAGNITUDE, _quantile(stars.magnitude, _BRIGHTNESSES))
    if heldout is not None and len(heldout.frame):
        found += _held_out(heldout, C, free, variance * gated, left.freedom)
    total = len(stars.frame) + stars.rejected
    found.append(Statistic(REJECTIONS, stars.rejected / total, 0.0, REJECTED, total))
    factor = np.ones(len(free))
    if not all(each.passed for each in found):
        factor[free] = np.max(factors, axis=0)
    return Consistency(tuple(found), None if margin is None else variance / stated,
                       tuple(factor.tolist()))


TOO_FEW = ('{} numbers are left of the stars once camera and attitudes are fitted, '
           f'{_LEAST} are needed for a test')
"""Why there is no test."""


def of_unidentified(adjusted: Adjusted, sigma: Array, gated: float) -> Consistency:
    """Return the tests of spots whose directions were fitted, too.

    A pattern is not looked for: the directions would explain most of it.

    Parameters
    ----------
    adjusted : Adjusted
    sigma : (m,) array
        Of its spots [px].
    gated : float
        As for `consistency`.
    """
    if adjusted.freedom < _LEAST:
        return Consistency(why=TOO_FEW.format(max(adjusted.freedom, 0)))
    used = adjusted.used
    squares = np.sum((adjusted.residual[used] / sigma[used, None])**2)
    variance = float(squares) / adjusted.freedom / gated
    level = _level(variance, adjusted.freedom, MARGIN)
    rejected = Statistic(REJECTIONS, float(np.mean(~used)), 0.0, REJECTED, len(used))
    failed = not (level.passed and rejected.passed)
    return Consistency((level, rejected), variance, (variance if failed else 1.0,) * 7)


def _level(variance: float, freedom: int, margin: float) -> Statistic:
    low, high = chi2_ppf([ALARM / 2.0, 1.0 - ALARM / 2.0], freedom) / freedom
    return Statistic(LEVEL, variance, float(low) / margin, float(high) * margin, freedom)


class _Left:
    """What camera and attitudes leave of the residuals of some stars, Eq. (T.1)."""

    def __init__(self, stars: FittedStars, by_camera: Array) -> None:
        self._first = np.flatnonzero(np.diff(stars.frame, prepend=-1))
        self._row = np.unique(stars.frame, return_inverse=True)[1]
        self._Q_a, attitudes = self._basis_of_attitudes(stars.by_attitude)
        H = self._turned_out(by_camera).reshape(2 * len(self._row), -1)
        length = np.linalg.norm(H, axis=0)
        U, s, _ = np.linalg.svd(H / np.where(length > 0.0, length, 1.0), full_matrices=False)
        self._Q_c = U[:, s > _RANK * s.max(initial=0.0)]
        self._A = self._Q_c.T @ H           # slopes of the camera in that basis
        z = self._turned_out(stars.z[..., None]).reshape(-1)
        self._t = self._Q_c.T @ z
        self._z = z - self._Q_c @ self._t
        self.squares = float(self._z @ self._z)
        self.freedom = 2 * len(self._row) - attitudes - self._Q_c.shape[1]
        self._of_star = (2.0 - np.sum(self._Q_a**2, axis=(1, 2))
                         - np.sum(self._Q_c**2, axis=1).reshape(-1, 2).sum(axis=1))

    def _basis_of_attitudes(self, H: Array) -> tuple[Array, int]:
        """Return orthonormal columns, (n, 2, 3), that span those of a frame, and all ranks."""
        values, V = np.linalg.eigh(np.add.reduceat(np.swapaxes(H, 1, 2) @ H, self._first, axis=0))
        counts = values > _RANK**2 * values[:, -1:]
        inverse = np.where(counts, 1.0 / np.sqrt(np.where(counts, values, 1.0)), 0.0)
        return H @ (V * inverse[:, None, :])[self._row], int(counts.sum())

    def _turned_out(self, D: Array) -> Array:
        """Return vectors, (n, 2, k), less what attitudes explain of them."""
        share = np.add.reduceat(np.swapaxes(self._Q_a, 1, 2) @ D, self._first, axis=0)
        out: Array = D - self._Q_a @ share[self._row]
        return out

    def pattern(self, name: str, directions: Array, C: Array | None
                ) -> tuple[Statistic, Array] | None:
        """Return the score test of directions, (n, 2, k), Eq. (T.2); None with too few stars.

        Beside it stands the square of the shift of the camera, in sigmas of the covariance C,
        that comes of leaving the direction that explains most out of the model; 0 where there is
        no covariance.
        """
        D = directions / np.maximum(np.linalg.norm(directions, axis=(0, 1)), 1e-30)
        D = self._turned_out(D).reshape(len(self._z), -1)
        of_camera = self._Q_c.T @ D
        D -= self._Q_c @ of_camera
        G, q = D.T @ D, D.T @ self._z
        values, V = np.linalg.eigh(G)
        values, V = values[values > _LEFT**2], V[:, values > _LEFT**2]
        k, rest = V.shape[1], self.freedom - V.shape[1]
        if not k or rest < _LEAST:
            return None
        explained = float(np.sum((V.T @ q)**2 / values))
        value = explained / k / ((self.squares - explained) / rest)
        test = Statistic(name, value, 0.0, float(f_isf(ALARM, k, rest)), k)
        if C is None:
            return test, np.zeros(1)
        left = np.maximum(np.diag(G), _LEFT**2)
        most = int(np.argmax(q**2 / left))
        shift = np.linalg.lstsq(self._A, of_camera[:, most] * q[most] / left[most], rcond=None)[0]
        return test, shift**2 / np.diag(C)

    def agreement(self, C: Array, variance: float) -> Statistic:
        """Return the test of a camera with the covariance C, Eq. (T.3)."""
        S = np.eye(len(self._t)) + self._A @ C @ self._A.T
        k = len(self._t)
        value = float(self._t @ np.linalg.solve(S, self._t)) / k / variance
        return Statistic(AGREEMENT, value, 0.0, float(f_isf(ALARM, k, self.freedom)), k)

    def scatter(self, name: str, *groupings: Ints) -> list[Statistic]:
        """Return the test of that group of stars, each (n,), whose scatter differs most."""
        of_star = np.sum(self._z.reshape(-1, 2)**2, axis=1)
        pairs: list[tuple[float, float]] = []
        for group in groupings:
            pairs += zip(np.bincount(group, of_star).tolist(),
                         np.bincount(group, self._of_star).tolist())
        pairs = [(squares, freedom) for squares, freedom in pairs
                 if _LEAST <= freedom <= self.freedom - _LEAST]
        half, found = ALARM / 2.0 / max(len(pairs), 1), []
        for squares, freedom in pairs:
            rest = self.freedom - freedom
            ratio = squares / freedom / ((self.squares - squares) / rest)
            low, high = f_ppf([half, 1.0 - half], freedom, rest)
            found.append(Statistic(name, ratio, float(low) / SCATTER,
                                   float(high) * SCATTER, len(pairs)))
        return [max(found, key=lambda each: max(each.value / each.high, each.low / each.value))
                ] if found else []


def _held_out(stars: FittedStars, C: Array, free: Mask, variance: float, freedom: int
              ) -> list[Statistic]:
    """Return the test of images that the camera was not fitted to."""
    own = _Left(stars, np.empty((*stars.z.shape, 0)))
    if own.freedom < _LEAST:
        return []
    H = own._turned_out(stars.by_camera[..., free]).reshape(len(own._z), -1)
    M = H @ _root(C)
    b = M.T @ own._z
    squares = own.squares - float(b @ np.linalg.solve(np.eye(len(C)) + M.T @ M, b))
    return [Statistic(HELD_OUT, squares / own.freedom / variance, 0.0,
                      float(f_isf(ALARM, own.freedom, freedom)) * MARGIN, own.freedom)]


def _root(C: Array) -> Array:
    """Return a matrix whose square, times its transpose, is a covariance."""
    try:
        return np.asarray(np.linalg.cholesky(C + 1e-30 * np.eye(len(C))))
    except np.linalg.LinAlgError:       # of parameters that do nearly the same
        values, V = np.linalg.eigh(C)
        return np.asarray(V * np.sqrt(np.maximum(values, 0.0)))


def _patterns(stars: FittedStars, estimate: CameraEstimate, detector: Detector, by_camera: Array
              ) -> list[tuple[str, Array]]:
    """Return the patterns that are looked for, (n, 2, k) in sigmas."""
    weight = (1.0 / stars.sigma)[:, None, None]
    return [(LENS, weight * lens_terms(stars.uv - estimate.intrinsics[:2], detector)),
            (CELLS, weight * _of_groups(_cell(stars.uv, detector, _FINE))),
            (PHASE, weight * phase_terms(stars.uv + detector.centre_raster)),
            (TIME, _of_runs(stars.frame, by_camera))]


def lens_terms(xy: Array, detector: Detector) -> Array:
    """Return what a lens may do beyond the model, (n, 2, 10), at points xy (n, 2).

    Radial terms of the seventh and ninth order, decentring of the fourth, a prism of the second
    and of the fourth order, and a scale and an axis that differ between u and v.
    """
    x, y = (xy / (0.5 * np.hypot(detector.width, detector.height))).T
    rr, nought = x * x + y * y, np.zeros(len(x))
    terms = [(x * rr**3, y * rr**3), (x * rr**4, y * rr**4),
             (rr * (rr + 2.0 * x * x), 2.0 * rr * x * y),
             (2.0 * rr * x * y, rr * (rr + 2.0 * y * y)),
             (rr, nought), (nought, rr), (rr * rr, nought), (nought, rr * rr),
             (x, -y), (y, x)]
    return np.moveaxis(np.array(terms), -1, 0).swapaxes(1, 2)


def phase_terms(uv_raster: Array) -> Array:
    """Return two harmonics of the place within a pixel, each axis its own, (n, 2, 8)."""
    out = np.zeros((len(uv_raster), 2, 8))
    for axis in range(2):
        angle = 2.0 * np.pi * uv_raster[:, axis]
        out[:, axis, 4 * axis:4 * axis + 4] = np.stack(
            (np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)), axis=-1)
    return out


def _cell(uv: Array, detector: Detector, most: int) -> Ints:
    """Return the cell of each star, as many along each side as stars suffice for."""
    side = int(np.clip(np.sqrt(len(uv) / _A_CELL), 2, most))
    place = np.floor((uv / [detector.width, detector.height] + 0.5) * side)
    column, row = np.clip(place, 0, side - 1).astype(np.int64).T
    return np.asarray(row * side + column)


def _quantile(values: Array, parts: int) -> Ints:
    """Return in which of so many parts of like size each value is."""
    edges = np.quantile(values, np.linspace(0.0, 1.0, parts + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values), np.int64)


def _of_groups(group: Ints) -> Array:
    """Return a shift of each group along u and along v, (n, 2, k)."""
    member = np.eye(int(group.max()) + 1)[group]
    return np.concatenate([np.stack((member, nought), axis=1)[:, ::step]
                           for nought in [np.zeros_like(member)] for step in (1, -1)], axis=-1)


def _of_runs(frame: Ints, by_camera: Array) -> Array:
    """Return an error of the camera in each run of frames, (n, 2, k)."""
    number = np.unique(frame, return_inverse=True)[1]
    frames = int(number.max()) + 1
    runs = min(frames, GROUPS)
    member = np.eye(runs)[number * runs // frames]
    return (by_camera[..., None] * member[:, None, None, :]).reshape(len(frame), 2, -1)
