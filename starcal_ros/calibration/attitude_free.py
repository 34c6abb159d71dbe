# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter on what no rotation changes: a camera from single frames, without an attitude.

The parameters are constants, or walk at random. Each frame is one update of an extended Kalman
filter (W19 Eq. 23 to 28, the covariance as a root, see `kalman`), iterated while its steps are
large against what is then known.

A star is rejected where the sum of squares of a frame falls by more than the gate when it goes,
the worst first (data snooping; W. Baarda, *A Testing Procedure for Use in Geodetic Networks*,
1968). In a frame that does not fit all pairs vote first (`acquisition.consensus`), so that wrong
stars can not hide each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import invariants
from starcal_ros.calibration.frame_arithmetic import kernel
from starcal_ros.calibration.invariants import Frame, Information, Lens
from starcal_ros.config.models import nominal_camera, of_intrinsics, star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, kalman
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.consensus import OUT_OF_PLACE, consensus
from starcal_ros.core.units import NS, SQRT_HOUR
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples, Stars
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.measurements.timeline import NEVER_NS

Measurement = Callable[[Frame], Information]
"""What a method takes from a frame."""

_ITERATIONS = 10
_LARGE = 0.3            # sigmas: a step that asks for another iteration
_TINY = 1e-9            # weight given to what the rest of a frame can not tell about a star


class CameraBelief(NamedTuple):
    """What is known of the camera.

    Attributes
    ----------
    parameters : (..., p) array
        Estimate.
    root : (..., p, p) array
        Root of the covariance of its error.
    """

    parameters: Array
    root: Array

    @property
    def sigma(self) -> Array:
        """Standard deviations, (..., p)."""
        return np.sqrt(np.einsum('...ij,...ij->...i', self.root, self.root))


def update(belief: CameraBelief, stars: Stars, lens: Lens, measure: Measurement) -> CameraBelief:
    """Correct a belief with a frame, all of whose stars count.

    Parameters
    ----------
    belief : CameraBelief
        Before the frame.
    stars : Stars
        Two or more, of finite sigma.
    lens : Lens
        Camera model.
    measure : callable
        What is compared.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where the steps lead to a camera that can not have seen the stars.
    """
    return _iterate(belief, stars, lens, measure)[0]


def _iterate(belief: CameraBelief, stars: Stars, lens: Lens, measure: Measurement
             ) -> tuple[CameraBelief, Frame, Array]:
    """Return the corrected belief, the frame as last linearised, and how far from the prior."""
    prior = at = belief.parameters
    for _ in range(_ITERATIONS):
        frame = invariants.linearize(stars, at, lens)
        matrix, vector = measure(frame)
        away = at - prior
        fitted = _told(belief, away, matrix, vector)
        step, at = fitted.parameters - at, fitted.parameters
        if (np.abs(step) <= _LARGE * fitted.sigma).all():
            break
    return fitted, frame, away


def _told(belief: CameraBelief, away: Array, matrix: Array, vector: Array) -> CameraBelief:
    """Return what is known after information that was taken `away` from what was believed."""
    prior, root = belief
    p = prior.shape[-1]
    if kernel and vector.ndim == prior.ndim == 1:
        return CameraBelief(*kernel.correct(prior, root, away, matrix, vector))
    root_t = np.swapaxes(root, -1, -2)
    vector = vector - (matrix @ away[..., None])[..., 0]
    # As kalman.correct, for information in place of residuals.
    L = np.linalg.cholesky(np.eye(p) + root_t @ matrix @ root)
    solved = np.linalg.solve(L, np.concatenate((root_t, root_t @ vector[..., None]), axis=-1))
    corrected = np.swapaxes(solved[..., :p], -1, -2)
    return CameraBelief(prior - (corrected @ solved[..., p:])[..., 0], corrected)


def screen(belief: CameraBelief, stars: Stars, lens: Lens, measure: Measurement, gate: float
           ) -> tuple[CameraBelief, Mask]:
    """Correct the belief of one run with those stars of a frame that fit.

    Parameters
    ----------
    belief, stars, lens, measure
        As for `update`, without batch axes.
    gate : float
        Largest fall of the sum of squares when a good star is left out; two degrees of freedom.

    Returns
    -------
    belief : CameraBelief
        After the frame.
    used : (n,) bool array
        Stars that were used. Where no more than half of them fit it is none, and the belief stays.
    """
    with np.errstate(all='ignore'):
        fitted, misfit = _fit(belief, stars, lens, measure)
        if misfit.max() <= gate:
            return fitted, np.ones(len(misfit), np.bool_)
        use = _vote(belief, stars, lens)
        while 2 * use.sum() > len(use):
            fitted, misfit = _fit(belief, stars.take(use), lens, measure)
            if misfit.max() <= gate:
                return fitted, use
            use[np.flatnonzero(use)[np.argmax(misfit)]] = False
    return belief, np.zeros_like(use)


def _fit(belief: CameraBelief, stars: Stars, lens: Lens, measure: Measurement
         ) -> tuple[CameraBelief, Array]:
    """Return the belief corrected with all stars, and by how much each of them misfits."""
    try:
        fitted, frame, away = _iterate(belief, stars, lens, measure)
        return fitted, _misfit(frame, belief.root, away)
    except np.linalg.LinAlgError:
        return belief, np.full(len(stars.sigma), np.inf)


def _misfit(frame: Frame, root: Array, away: Array) -> Array:
    """Return by how much the sum of squares falls when a star goes, (n,).

    Let K weight the centroid residuals z of a frame whose attitude is unknown and whose parameters
    have a prior. The fall is ``g' K_j^-1 g``, with g the two numbers of K z and K_j the 2 x 2
    block of K that belong to the star.

    Parameters
    ----------
    frame : Frame
        Linearised.
    root : (p, p) array
        Of the prior covariance.
    away : (p,) array
        From the prior to where the frame is linearised.
    """
    if kernel:
        return np.asarray(kernel.misfit(*frame[1:3], frame.Q, root, away, _TINY))
    z, M = frame.z - frame.H @ away, frame.H @ root
    V = np.linalg.solve(np.linalg.cholesky(np.eye(len(root)) + M.T @ M), M.T).T
    g_u, g_v = (z - V @ (V.T @ z)).reshape(-1, 2).T
    known = np.concatenate((frame.Q, V), axis=1)            # K = I - known known'
    known = known.reshape(-1, 2, known.shape[1])
    K = (1.0 + _TINY) * np.eye(2) - known @ np.swapaxes(known, 1, 2)
    uu, uv, vv = K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]
    return (vv * g_u * g_u - 2.0 * uv * g_u * g_v + uu * g_v * g_v) / (uu * vv - uv * uv)


def _vote(belief: CameraBelief, stars: Stars, lens: Lens) -> Mask:
    """Tell which stars agree with the attitude that most of them agree with."""
    try:
        frame = invariants.linearize(stars, belief.parameters, lens)
    except np.linalg.LinAlgError:
        return np.zeros(len(stars.sigma), np.bool_)
    spread = np.linalg.norm((frame.H @ belief.root).reshape(len(stars.sigma), -1), axis=-1)
    wrong = (6.0 * spread + 10.0) * np.linalg.norm(
        invariants.direction_slopes(frame), axis=(-2, -1))
    r_s = lens.unproject(stars.uv, belief.parameters)
    size = np.linalg.norm(r_s - r_s[0], axis=-1).max()
    return consensus(stars.u_i, r_s, float(min(wrong.max(), OUT_OF_PLACE * size)))


class AttitudeFree:
    """A calibration by single frames, as a `CameraMethod`.

    Parameters
    ----------
    scenario : Scenario
        Nominal camera, initial sigmas, walks, gate, and the intrinsics to estimate.
    measure : callable
        What is compared.
    min_stars : int
        Stars of which a frame can tell something.
    known : CameraEstimate, optional
        In place of the nominal camera and its initial sigmas, from other frames.
    """

    def __init__(self, scenario: Scenario, measure: Measurement, min_stars: int,
                 known: CameraEstimate | None = None) -> None:
        options, begun = scenario.estimator, nominal_camera(scenario, known)
        self._lens = Lens(scenario.camera.pixel_pitch_mm)
        self._measure, self._min_stars = measure, min_stars
        estimated = np.isin(camera.INTRINSICS, scenario.intrinsics.estimate)
        self._first = CameraBelief(begun.intrinsics, kalman.root_of(begun.covariance))
        self._density = of_intrinsics(options.process_noise) / SQRT_HOUR * estimated
        self._gate = star_gate(options)
        self._patience = options.reacquire_after_frames
        self._directions = StarDirections(scenario)
        self._belief = self._first
        self._used_ns = NEVER_NS
        self._frames = self._stars = self._rejected_in_a_row = 0
        self._notices = Notices()
        self.take_notices = self._notices.take

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples: they tell nothing here."""

    def add_frames(self, frames: Frames) -> None:
        """Take frames."""
        stars = self._directions.of(frames, self._notices)
        for k, stamp_ns in enumerate(frames.stamp_ns.tolist()):
            rows = np.arange(frames.first[k], frames.first[k + 1])
            rows = rows[np.isfinite(stars.sigma[rows])]
            if len(rows) >= self._min_stars:
                self._take(stamp_ns, stars.take(rows))

    def _take(self, stamp_ns: int, stars: Stars) -> None:
        belief = self._belief
        if self._density.any() and self._frames:
            walked = self._density * np.sqrt((stamp_ns - self._used_ns) * NS)
            belief = belief._replace(
                root=kalman.predict(belief.root, np.eye(len(walked)), np.diag(walked)))
        belief, used = screen(belief, stars, self._lens, self._measure, self._gate)
        if used.any():
            self._belief, self._used_ns, self._rejected_in_a_row = belief, stamp_ns, 0
            self._frames += 1
            self._stars += int(used.sum())
            self._notices.count('stars that do not fit: rejected', int((~used).sum()))
            return
        self._notices.count('frames of which most do not fit: rejected', 1)
        self._rejected_in_a_row += 1
        if self._rejected_in_a_row == self._patience and self._frames:
            self._notices.say(f'{self._patience} frames in a row up to {stamp_ns} ns do not fit: '
                              'the calibration begins afresh')
            self._belief, self._frames, self._stars = self._first, 0, 0

    def estimate(self) -> CameraEstimate | None:
        """Return the camera after the last frame."""
        if not self._frames:
            return None
        parameters, root = self._belief
        return CameraEstimate(parameters, root @ root.T, self._frames, self._stars)
