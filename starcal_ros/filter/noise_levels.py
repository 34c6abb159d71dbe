# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How large the noises are that the innovations show: score and information of each level.

Model
-----
A level theta is the standard deviation or the density of one noise; the covariance P and the error
x that the filter takes off its nominal values depend on it. Carried beside them are
``D = d P / d ln theta^2`` and ``xi = d x / d ln theta^2`` (K the gain, H of one frame, Phi of one
interval) ::

    D <- Phi D Phi' + Q_theta,          xi <- Phi xi
    D <- (I - K H) D (I - K H)',        xi <- (I - K H) (xi + D v)                     (L.1)

Q_theta is the part of the process noise that is theta's. The innovation z of a frame has the
covariance S, of which the level makes ``dS = H D H'``, and itself depends on it by ``-H xi``;
twice its log likelihood is ``-ln det S - z' S^-1 z``. With ``N = H' S^-1 H`` and
``v = H' S^-1 z`` ::

    score       = (v' D v - tr D N) / 2 + xi' v
    information = tr(D N D N) / 2 + xi' N xi                                           (L.2)

Where the level is right, the score is of mean 0 and its variance is the information: the root of
the scores of a run is the likeliest level, and ``1 / information`` the variance of ln theta^2. Of
a noise that the stars drown, nearly all information is that of xi. Of centroids the same holds
with what no turn of the camera explains (`innovation_tests`), r its sum of squares and m its
degrees of freedom: ``score = (r - m) / 2, information = m / 2``. N. K. Gupta, R. K. Mehra,
*Computational aspects of maximum likelihood estimation and reduction in sensitivity function
calculations*, IEEE Transactions on Automatic Control 19(6), 1974.

Scores are kept window by window: of a run with a fault in it those windows are left out which
contradict most of the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
import math
from typing import NamedTuple

import numpy as np

from starcal_ros.config.estimator import ProcessNoiseConfig
from starcal_ros.config.models import of_calibrated
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.distributions import normal_cdf, normal_pdf
from starcal_ros.core.kalman import Evidence
from starcal_ros.core.units import DEG_PER_SQRT_HOUR, SQRT_HOUR
from starcal_ros.filter import process_noise
from starcal_ros.filter.allowances import WINDOW
from starcal_ros.filter.states import CALIBRATED, EPSILON, SCALE, THETA, UNIT
from starcal_ros.measurements.preintegration import Preintegrated

CENTROIDS, GYRO = 'star_tracker.centroid_sigma_px', 'gyro.arw_deg_sqrt_h'
WALKS = tuple(f'estimator.process_noise.{item.name}' for item in fields(ProcessNoiseConfig))
FAR = 1.5
"""Factor by which a level is off the stated one that is said aloud."""

_CLEAR = 3.0            # sigmas of a difference that is no chance
_OUTLYING = 3.5         # spreads of the windows' scores from which on one is left out
_PASSES = 10
_LEAST = 1e-3           # part of a variance that one step leaves, at least
_FURTHEST = 3.0


class NoiseLevel(NamedTuple):
    """A level that was estimated.

    Attributes
    ----------
    key : str
        Its parameter.
    stated : float
        What the configuration says.
    value : float
        What the data say.
    spread : float
        Standard deviation of the value, as a part of it; infinite where nothing is known.
    used : bool
        Whether the calibration uses it.
    """

    key: str
    stated: float
    value: float
    spread: float
    used: bool

    @property
    def far(self) -> bool:
        """Whether it is off the stated one by what no chance explains and a user should know."""
        if self.stated == 0.0:
            return self.used and self.value > 0.0
        off = abs(math.log(max(self.value, 1e-300) / self.stated))
        return off > max(math.log(FAR), _CLEAR * self.spread)

    @property
    def sentence(self) -> str:
        """What was found."""
        known = f' +- {self.value * self.spread:.2g}' if math.isfinite(self.spread) else ''
        kept = '' if self.used else '; the stated one is kept: it explains the data as well'
        return f'{self.key} {self.value:.3g}{known}, stated {self.stated:.3g}{kept}'


def said_aloud(levels: Sequence[NoiseLevel]) -> list[str]:
    """Return what a user should know of levels that were estimated."""
    return [f'{each.sentence}: far from what is stated' for each in levels if each.far]


def stated(scenario: Scenario, key: str) -> float:
    """Return what a scenario states for a level."""
    return float(scenario.flat()[key])


def with_levels(scenario: Scenario, levels: Mapping[str, float]) -> Scenario:
    """Return a scenario with other levels, but for that of the centroids (`sigma_factor`)."""
    return scenario.replace({key: value for key, value in levels.items() if key != CENTROIDS})


def sigma_factor(scenario: Scenario, levels: Mapping[str, float]) -> float:
    """Return what the sigma of each star is to be multiplied by: messages may state their own."""
    value = levels.get(CENTROIDS)
    return 1.0 if value is None else value / stated(scenario, CENTROIDS)


class Scores:
    """Score and information of some levels of one run, Eq. (L.1), (L.2).

    Parameters
    ----------
    levels : mapping
        Values that the filter has, by their parameters.
    scale : (n,) array
        Of the filter's states.
    gated : float
        Mean of the squared residual of a star that passed the gate, over that of any star.

    Attributes
    ----------
    windows : list of (k, 2) array
        Score and information of each level, of each `WINDOW` frames.
    """

    def __init__(self, levels: Mapping[str, float], scale: Array, gated: float) -> None:
        self.levels = dict(levels)
        self._scale, self._gated = scale, gated
        self._moving = [key for key in levels if key != CENTROIDS]
        n = len(scale)
        self._D = np.zeros((len(self._moving), n, n))
        self._xi = np.zeros((len(self._moving), n))
        self.restart()

    def restart(self) -> None:
        """Forget the scores, as where a level has another value from now on."""
        self.windows: list[Array] = []
        self._sums, self._frames = np.zeros((len(self.levels), 2)), 0

    def carry(self, gyro: Preintegrated, Phi: Array) -> None:
        """Take an interval in, of the transition (n, n) of the scaled errors."""
        B = Phi[THETA, EPSILON] * (SCALE[THETA, None] / SCALE[EPSILON])
        for D, key in zip(self._D, self._moving):
            root = self._root(key, B, gyro.duration)
            D[:] = Phi @ D @ Phi.T + root @ root.T
        self._xi = self._xi @ Phi.T

    def _root(self, key: str, B: Array, duration: Array) -> Array:
        n = len(self._scale)
        if key == GYRO:
            root = np.zeros((n, 3))
            root[THETA] = np.eye(3) * (
                self.levels[key] * DEG_PER_SQRT_HOUR * np.sqrt(duration) / SCALE[0])
            return root
        only = replace(ProcessNoiseConfig(), **{key.rpartition('.')[2]: self.levels[key]})
        density = of_calibrated(only) * UNIT[CALIBRATED] / SQRT_HOUR
        return process_noise.root(density, B, duration, n) / self._scale[:, None]

    def found(self) -> None:
        """Know that the attitude was found afresh: its covariance is no matter of the noise."""
        self._D[:, THETA] = self._D[:, :, THETA] = 0.0
        self._xi[:, THETA] = 0.0

    def meet(self, said: Evidence, rest: float, freedom: int, judged: bool) -> bool:
        """Take a frame in; return whether it was the last of a window.

        Parameters
        ----------
        said : Evidence
        rest : float
            Of its normalised innovation squared, what no turn explains.
        freedom : int
            Its degrees of freedom.
        judged : bool
            Whether the frame tells of the levels; D and xi follow it all the same.
        """
        N, v = said.explained(said.H)
        if judged:
            self._sums += self._of_frame(N, v, rest, freedom)
            self._frames += 1
        F = np.eye(len(self._scale)) - said.root @ said.root.T @ (said.H.T @ said.H)
        self._xi = (self._xi + self._D @ v) @ F.T
        self._D = F @ self._D @ F.T
        if self._frames < WINDOW:
            return False
        self.windows.append(self._sums)
        self._sums, self._frames = np.zeros_like(self._sums), 0
        return judged

    def _of_frame(self, N: Array, v: Array, rest: float, freedom: int) -> Array:
        DN, xi = self._D @ N, self._xi
        walks = iter(np.stack((
            0.5 * (np.einsum('i,kij,j->k', v, self._D, v) - np.einsum('kii->k', DN)) + xi @ v,
            0.5 * np.einsum('kij,kji->k', DN, DN) + np.einsum('ki,ij,kj->k', xi, N, xi)), axis=-1))
        centroids = (0.5 * (rest / self._gated - freedom), 0.5 * freedom)
        return np.array([centroids if key == CENTROIDS else next(walks) for key in self.levels])

    def steps(self) -> dict[str, tuple[float, float]]:
        """Return for each level by which part theta^2 is to grow, and the information."""
        if not self.windows:
            return {}
        scores = np.stack(self.windows)
        return {key: combined(scores[:, k]) for k, key in enumerate(self.levels)}


def combined(windows: Array) -> tuple[float, float]:
    """Return what windows (w, 2) of scores and informations say of theta^2.

    Returns
    -------
    step : float
        By which part of itself theta^2 is to grow.
    information : float
        Of the windows that were used.
    """
    score, information = windows.T
    told = information > 0.0
    if not told.any():
        return 0.0, 0.0
    score, information = score[told], information[told]
    step = float(np.median(score / information))
    keep = np.ones(len(score), bool)
    for _ in range(_PASSES):
        off = np.abs((score - step * information) / np.sqrt(information))
        # Far from its value a level puts all windows off alike.
        before, keep = keep, off <= _OUTLYING * max(1.0, 1.4826 * float(np.median(off)))
        step = float(score[keep].sum() / information[keep].sum())
        if (keep == before).all():
            break
    return step, float(information[keep].sum())


def scaled(key: str, step: float, information: float) -> float:
    """Return by what a level is to be multiplied for a step of its square.

    The variances of centroids grow with theta^2, those of states that noise moves and stars hold
    with theta: the factor that is right there leaves nothing to the next step. A step that chance
    explains is none; one of the latter goes no further than `_FURTHEST`.
    """
    if step * step * information < 1.0:
        return 1.0
    if key == CENTROIDS:
        return math.sqrt(max(1.0 + step, _LEAST))
    return min(max(1.0 + 0.5 * step, 1.0 / _FURTHEST), _FURTHEST)


def expected(information: float) -> float:
    """Return by what a level is to be multiplied that is as likely larger as it may be.

    With theta^2 known to ``theta^2 / sqrt(information)`` and not negative, its mean is larger than
    its likeliest value: a level that hardly shows is not to be taken for none, with covariances
    that vanish.
    """
    if information <= 0.0:
        return 1.0
    known = 1.0 / math.sqrt(information)
    return math.sqrt(1.0 + known * float(normal_pdf(1.0 / known) / normal_cdf(1.0 / known)))


def spread(information: float) -> float:
    """Return the standard deviation of a level, as a part of it."""
    return 0.5 / math.sqrt(information) if information > 0.0 else math.inf


def found(scenario: Scenario, values: Mapping[str, float],
          informations: Mapping[str, float], used: bool = True) -> Sequence[NoiseLevel]:
    """Return the levels that were found."""
    return tuple(NoiseLevel(key, stated(scenario, key), value,
                            spread(informations.get(key, 0.0)), used)
                 for key, value in values.items())
