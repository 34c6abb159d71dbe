# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulation of W19, Wu et al. 2019, Sec. 4.1: its camera, data sets, criteria and bound.

2500 frames of a 1920 x 1080 camera of 16 mm, 2400 to calibrate and 100 to judge by, stars of the
catalogue at attitudes drawn at random. W19 states neither the attitudes nor the initial
covariance; the latter is wide here, so that it adds nothing to 2400 frames.

A run is one draw of the centroid noise; runs are a leading batch axis, and see the same sky.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import erfa
import numpy as np
from scipy.spatial.transform import Rotation

from starcal_ros.calibration import attitude_free
from starcal_ros.calibration.attitude_free import CameraBelief, Measurement
from starcal_ros.calibration.invariants import Lens
from starcal_ros.calibration.methods import angular_distance, singular_value
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.units import ARCSEC
from starcal_ros.measurements.samples import Stars
from starcal_ros.reproduction import published_cameras
from starcal_ros.sky import catalog

DETECTOR = Detector(1920, 1080, 0.0029)
TRUTH = np.array([1.0, 16.0, 970.0, 550.0, -0.5, 0.5])
"""W19 Table 1: s, f [mm], u0, v0 [px], k1, k2."""
PRECISION = np.array([1e-5, 1e-4, 1.0, 1.0, 1e-2, 1e-1])
"""W19 Table 1, the weights of its observability."""
START = np.array([1.0, 15.5, 960.0, 540.0, 0.0, 0.0])
"""W19 Sec. 4.1, Test 1."""
START_SIGMA = np.array([0.01, 1.0, 50.0, 50.0, 1.0, 5.0])

CALIBRATE, JUDGE, RATE_HZ = 2400, 100, 2.0
SIGMA_PX = 0.5


class Group(NamedTuple):
    """A limiting magnitude (Hp), and how many stars a frame has on average in the paper."""

    magnitude: float
    stars: float


GROUPS = {'group1': Group(6.22, 31.4), 'group2': Group(5.77, 19.1), 'group3': Group(4.98, 7.7)}
"""W19's groups by their number of stars. At its limits, V of 6, 5.5 and 4.6, taken as Hp, the sky
has 24.5, 14.1 and 5.1 stars a frame on average."""

_RICH = 8               # stars: Model 2 then takes four, and differs from Model 1

LENS = Lens(DETECTOR.pitch_mm, published_cameras.square_w19)

METHODS: dict[str, dict[str, Measurement]] = {
    'AD': {'full': angular_distance.full, 'diagonal': angular_distance.diagonal},
    'SVD': {weighting: partial(singular_value.measure, model=4, chosen=(2, 3),
                               full=weighting == 'full') for weighting in ('full', 'diagonal')},
}
"""By name and weighting: the angular distances, and {sigma2, sigma3} of Model 4."""


class PerfectFrame(NamedTuple):
    """What a frame shows without noise.

    Attributes
    ----------
    u_i : (n, 3) array
        Directions of the stars.
    uv : (n, 2) array
        Centroids [raster px].
    """

    u_i: Array
    uv: Array


class Sky(NamedTuple):
    """The frames of a data set: those to calibrate with, and those to judge by."""

    calibrate: list[PerfectFrame]
    judge: list[PerfectFrame]


def sky(scenario: Scenario, group: Group) -> Sky:
    """Return the frames of a group, 2400 and 100 of them, or as many as the scenario is long."""
    frames = min(CALIBRATE, max(int(scenario.simulation.duration_s * RATE_HZ), 2))
    stars = catalog.load(group.magnitude)
    u_i = erfa.s2c(stars.ra, stars.dec)
    count = frames + min(JUDGE, frames)
    attitudes = Rotation.random(count, np.random.default_rng(scenario.simulation.seed))
    views = [_view(u_i, C_si) for C_si in attitudes.as_matrix()]
    return Sky(views[:frames], views[frames:])


def _view(u_i: Array, C_si: Array) -> PerfectFrame:
    half = 0.5 * DETECTOR.pitch_mm * np.hypot(DETECTOR.width, DETECTOR.height)
    # 1.1: the principal point is off the centre, and the distortion draws stars in
    near = u_i[u_i @ C_si[2] > np.cos(np.arctan(1.1 * half / TRUTH[1]))]
    uv = published_cameras.project_w19(near @ C_si.T, TRUTH, DETECTOR.pitch_mm)
    seen = DETECTOR.contains(uv - DETECTOR.centre_raster)
    return PerfectFrame(near[seen], uv[seen])


def noisy(views: Sequence[PerfectFrame], sigma_px: float, seeds: Iterable[Sequence[int]]
          ) -> list[Array]:
    """Return the centroids of each frame with noise, (runs, n, 2), a seed a run."""
    counts = [len(view.uv) for view in views]
    noise = np.stack([np.random.default_rng(seed).standard_normal((sum(counts), 2))
                      for seed in seeds])
    return [view.uv + sigma_px * part for view, part in zip(
        views, np.split(noise, np.cumsum(counts)[:-1], axis=1))]


def calibrate(views: Sequence[PerfectFrame], uv: Sequence[Array], sigma_px: float,
              measure: Measurement,
              each: Callable[[CameraBelief], None] = lambda belief: None) -> CameraBelief:
    """Return what is known after all frames, of all runs.

    Parameters
    ----------
    views, uv
        Frames, and their noisy centroids.
    sigma_px : float
        Their noise.
    measure : callable
        The method.
    each : callable
        Called with what is known after each frame.
    """
    runs = len(uv[0])
    belief = CameraBelief(np.tile(START, (runs, 1)), np.tile(np.diag(START_SIGMA), (runs, 1, 1)))
    for view, measured in zip(views, uv):
        if len(view.uv) >= singular_value.MIN_STARS:
            u_i = np.broadcast_to(view.u_i, (runs, *view.u_i.shape))
            sigma = np.full(measured.shape[:-1], sigma_px)
            belief = attitude_free.update(belief, Stars(u_i, measured, sigma), LENS, measure)
        each(belief)
    return belief


def rmse_arcsec(parameters: Array, views: Sequence[PerfectFrame], uv: Sequence[Array]) -> Array:
    """Return the RMS error of the angular distances of each frame, (runs, frames) [arcsec].

    Criterion A of W19 with centroids without noise, B with noisy ones; frames of one star, which
    have no distance, are left out.
    """
    return np.stack([
        np.sqrt(np.mean((_angles(published_cameras.unproject_w19(
            measured, parameters, DETECTOR.pitch_mm)) - _angles(view.u_i))**2, axis=-1))
        for view, measured in zip(views, uv) if len(view.uv) > 1], axis=-1) / ARCSEC


def _angles(w: Array) -> Array:
    """Return the angles of all pairs, from the chord, which is exact for small ones too."""
    one, other = np.triu_indices(w.shape[-2], 1)
    chord = np.linalg.norm(w[..., one, :] - w[..., other, :], axis=-1)
    return 2.0 * np.arcsin(0.5 * chord)


def cramer_rao(views: Sequence[PerfectFrame], sigma_px: float) -> Array:
    """Return the bound on the covariance of W19's parameters, (6, 6), attitudes unknown.

    Slopes are differences of the projection, so that a wrong derivative is not repeated here.
    """
    information: Array = np.diag(START_SIGMA**-2.0)
    for view in views:
        if len(view.uv) < singular_value.MIN_STARS:
            continue
        r_s = published_cameras.unproject_w19(view.uv, TRUTH, DETECTOR.pitch_mm)
        N = np.stack([_slope(r_s + 1e-6 * np.cross(axis, r_s), r_s - 1e-6 * np.cross(axis, r_s))
                      / 2e-6 for axis in np.eye(3)], axis=-1)
        H = np.stack([_slope(r_s, r_s, step) / (2.0 * step.sum())
                      for step in np.diag(PRECISION)], axis=-1)
        Q = np.linalg.qr(N).Q
        H = (H - Q @ (Q.T @ H)) / sigma_px
        information += H.T @ H
    return np.linalg.inv(information).astype(float)


def _slope(more: Array, less: Array, step: Array | float = 0.0) -> Array:
    """Return the difference of the centroids, (2 n,), of two sets of directions or cameras."""
    return (published_cameras.project_w19(more, TRUTH + step, DETECTOR.pitch_mm)
            - published_cameras.project_w19(less, TRUTH - step, DETECTOR.pitch_mm)).ravel()


def nees(belief: CameraBelief) -> Array:
    """Return the normalised estimation error squared of each run, (runs,); 6 degrees."""
    whitened = np.linalg.solve(belief.root, (belief.parameters - TRUTH)[..., None])
    return np.sum(whitened**2, axis=(-2, -1))


def rich_views(scenario: Scenario, count: int) -> list[PerfectFrame]:
    """Return the first frames of group2 that show all models, for W19's Fig. 3 and 4."""
    return [view for view in sky(scenario, GROUPS['group2']).calibrate
            if len(view.uv) >= _RICH][:count]


def least_observable(view: PerfectFrame, model: int, chosen: Sequence[int]) -> float:
    """Return the minimum singular value of the observability matrix of a frame (W19 Eq. 30).

    In units of PRECISION, of the slopes of singular values as they are, in no units of sigma.
    """
    w, _, dw = published_cameras.backproject_w19(view.uv, TRUTH, DETECTOR.pitch_mm)
    member = singular_value.groups(model, len(w))
    squares, p = np.linalg.eigh(singular_value.gram(member, w))
    order = [3 - k for k in chosen]
    slopes = singular_value.slopes(member, w, p[..., order],
                                   np.sqrt(np.maximum(squares[..., order], 1e-24)), dw)
    H = slopes.sum(axis=-2).reshape(-1, len(TRUTH)) * PRECISION
    # Fewer residuals than parameters leave something unobserved.
    return float(np.linalg.svd(H, compute_uv=False)[-1]) if len(H) >= len(TRUTH) else 0.0
