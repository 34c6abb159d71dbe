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
`projected_residuals.SCATTER`. A right fit rejects next to nothing, but wrong identifications are
what the gate is for: up to `REJECTED` of the stars may go.

Limits: with T the mean of k F at which a test fails, a pattern of amplitude a in n stars is found
in one case of two where ``a^2 n w = sigma^2 (T - k)``, w the mean square length of what camera
and attitudes leave of the pattern of amplitude 1. What they explain is not found at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.fitted_stars import FittedStars
from starcal_ros.calibration.projected_residuals import LEAST, ProjectedResiduals
from starcal_ros.calibration.residual_patterns import (cell, lens_terms, of_groups, of_runs,
                                                       phase_terms, quantile, weightiest)
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.distributions import chi2_ppf, f_isf
from starcal_ros.core.statistic import ALARM, Statistic
from starcal_ros.core.statistic import MARGIN

REJECTED = 0.3
"""Share of the stars that may be rejected."""

LEVEL, REJECTIONS = 'NIS of the centroids', 'share of rejected stars'
LENS, CELLS, PHASE = 'lens beyond the model', 'mean over the detector', 'mean over the pixel'
TIME, AGREEMENT = 'camera from frame to frame', 'camera of the method against these stars'
SCATTER_CELLS, SCATTER_MAGNITUDE = 'scatter over the detector', 'scatter over the magnitude'
SCATTER_SIGMA = 'scatter over the stated sigma'
IMAGES = 'images that ask for another camera'
AIR = 'air of another time, or none'
HELD_OUT = 'held-out images against fitted ones'

_FINE, _COARSE = 8, 4   # cells along each side, at most
_RINGS, _BRIGHTNESSES = 4, 5
_SHARES = 0.5, 0.25     # of the weight of all stars

AS_STATED = (1.0,) * 7
"""Factors of a camera whose sigmas are right."""


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
    left = ProjectedResiduals(stars, of_runs(stars.frame, by_camera) if walks else by_camera)
    if left.freedom < LEAST:
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
        found.append(left.agreement(AGREEMENT, C, variance))
        if not found[-1].passed:
            factors.append(factors[0] * found[-1].value)
    found += left.scatter(SCATTER_CELLS, cell(stars.uv, detector, _COARSE),
                          quantile(np.linalg.norm(stars.uv, axis=1), _RINGS))
    by_weight = left.scatter_of(SCATTER_SIGMA, *(
        weightiest(stars.sigma, share) for share in _SHARES))
    found += by_weight
    factors += [factors[0] * each.value for each in by_weight if each.value > each.high]
    known = np.isfinite(stars.magnitude)
    if known.all():
        found += left.scatter(SCATTER_MAGNITUDE, quantile(stars.magnitude, _BRIGHTNESSES))
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
           f'{LEAST} are needed for a test')
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
    if adjusted.freedom < LEAST:
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


def _held_out(stars: FittedStars, C: Array, free: Mask, variance: float, freedom: int
              ) -> list[Statistic]:
    """Return the test of images that the camera was not fitted to."""
    own = ProjectedResiduals(stars, np.empty((*stars.z.shape, 0)))
    if own.freedom < LEAST:
        return []
    squares = own.squares_beside(stars.by_camera[..., free], C)
    return [Statistic(HELD_OUT, squares / own.freedom / variance, 0.0,
                      float(f_isf(ALARM, own.freedom, freedom)) * MARGIN, own.freedom)]


def _patterns(stars: FittedStars, estimate: CameraEstimate, detector: Detector, by_camera: Array
              ) -> list[tuple[str, Array]]:
    """Return the patterns that are looked for, (n, 2, k) in sigmas."""
    weight = (1.0 / stars.sigma)[:, None, None]
    return [(LENS, weight * lens_terms(stars.uv - estimate.intrinsics[:2], detector)),
            (CELLS, weight * of_groups(cell(stars.uv, detector, _FINE))),
            (PHASE, weight * phase_terms(stars.uv + detector.centre_raster)),
            (TIME, of_runs(stars.frame, by_camera))]
