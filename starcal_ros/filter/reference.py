# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of a frame in numpy: what `kernel` has to give, and what runs without numba.

The model stands in `error_state`, that of the tests in `responses` and `innovation_tests`. Every
array has one leading axis: the runs of a batch, or one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera, kalman, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter import curvature, hypotheses, likelihood, process_noise, responses
from starcal_ros.filter.frame_innovation import BLIND, SPREAD, cell_of, tally
from starcal_ros.filter.responses import fitted as fit
from starcal_ros.filter.states import EPSILON, LENS, PSI, SCALE, THETA
from starcal_ros.filter.stretch import Constants, Gained, Intervals, StretchStars, TestSums, Values
from starcal_ros.measurements.preintegration import composed as compose

__all__ = ['COMPILED', 'advance', 'bends', 'carry', 'compose', 'correct', 'fit', 'judge',
           'propagate', 'tally']

COMPILED = False

SEEN = [*range(THETA.start, THETA.stop), *range(LENS.start, LENS.stop)]
"""The states that a frame shows at once."""


class Carried(NamedTuple):
    """A belief at the end of an interval.

    Attributes
    ----------
    C_gi : (r, 3, 3) array
        Attitude.
    error : (r, n) array
        Expected error.
    root : (r, n, n) array
        Root of its covariance, lower triangular, in the filter's scale.
    Phi : (r, n, n) array
        Transition of the scaled errors.
    """

    C_gi: Array
    error: Array
    root: Array
    Phi: Array


class Corrected(NamedTuple):
    """A belief after a frame, and what the frame said.

    Attributes
    ----------
    error, root : arrays
        Expected error and root of its covariance; freed of the error where there is feedback.
    C_gi, bias, C_sg, intrinsics : arrays
        Values, likewise.
    freed : (r, n) array
        The error that the values were freed of; zero without feedback.
    chi2, accepted, residual : arrays
        See `error_state.Update`.
    nis, spread : (r,) arrays
        Likewise.
    z, H, M, L : arrays
        See `core.kalman.Evidence`.
    """

    error: Array
    root: Array
    C_gi: Array
    bias: Array
    C_sg: Array
    intrinsics: Array
    freed: Array
    chi2: Array
    accepted: Mask
    residual: Array
    nis: Array
    spread: Array
    z: Array
    H: Array
    M: Array
    L: Array


class TurnFound(NamedTuple):
    """What the tests of the model make of a frame.

    Attributes
    ----------
    judged : (r,) bool array
        Whether it tells anything: its prediction is certain, and its stars tell a turn.
    e : (r, 3) array
        Whitened turn, Eq. (C.1) of `innovation_tests`; means nothing where it tells nothing.
    L : (r, 3, 3) array
        Root of its information [1/rad], likewise.
    normal : (r, n, 2) array
        Innovations, each coordinate divided by its standard deviation; 0 for an unused star.
    cell : (r, n) int array
        Where the stars are on the detector.
    log_det : (r,) array
        ln det S of the stars used, Eq. (G.1) of `likelihood`.
    """

    judged: Mask
    e: Array
    L: Array
    normal: Array
    cell: Ints
    log_det: Array


def propagate(C_gi: Array, C_sg: Array, error: Array, root: Array, Delta: Array, turn: Array,
              J_b: Array, slopes: Array, sigma: Array, duration: Array, density: Array,
              scale: Array) -> Carried:
    """Carry beliefs over an interval (T18 Eq. 22, Eq. (E.1) of `error_state`).

    Parameters
    ----------
    C_gi, C_sg : (r, 3, 3) arrays
        Attitude and mounting.
    error : (r, n) array
        Expected error.
    root : (r, n, n) array
        Root of its covariance, scaled.
    Delta : (r, 3, 3) array
        Turn of g for the reference of the preintegration.
    turn : (r, 3) array
        What it lacks, applied before it [rad].
    J_b : (r, 3, 3) array
        Derivative of the turn by the bias [s].
    slopes : (r, 3, m) array
        Derivative of the turn by the errors of the optional states.
    sigma : (r,) array
        Standard deviation of the noise of the turn about each axis [rad].
    duration : (r,) array
        Of the interval [s].
    density : (13,) array
        Random walks of the calibrated states, per root second.
    scale : (n,) array
        Of the states.
    """
    runs, n = error.shape
    Delta = Delta @ rotation.exp(turn)
    C_s1g0 = C_sg @ Delta
    C_s1s0 = C_s1g0 @ np.swapaxes(C_sg, -1, -2)
    Phi = np.zeros((runs, n, n))
    Phi[:, range(n), range(n)] = 1.0
    Phi[:, THETA, THETA] = C_s1s0
    Phi[:, THETA, PSI] = np.eye(3) - C_s1s0
    Phi[:, THETA, EPSILON] = B = C_s1g0 @ J_b
    Phi[:, THETA, LENS.stop:] = C_s1g0 @ slopes
    error = (Phi @ error[..., None])[..., 0]
    Q_root = np.zeros((runs, n, 3))
    Q_root[:, range(3), range(3)] = (sigma / SCALE[0])[:, None]
    if density.any():
        Q_root = np.concatenate((
            Q_root, process_noise.root(density, B, duration, n) / scale[:, None]), axis=-1)
    Phi = Phi * (scale / scale[:, None])
    return Carried(rotation.orthonormalized(Delta @ C_gi), error,
                   kalman.predict(root, Phi, Q_root), Phi)


def in_view(r_s: Array, cos_field: float) -> Mask:
    """Tell which directions (..., n, 3) lie inside the field, (..., n).

    Far outside of it the distortion means nothing, and its uncertainty everything.
    """
    return np.asarray(r_s[..., 2] > cos_field * np.sqrt(np.sum(r_s * r_s, axis=-1)))


def predict(C_si: Array, shift: Array, slopes: Array, intrinsics: Array, u_i: Array,
            pitch_mm: float, cos_field: float) -> tuple[Array, Array, Mask]:
    """Return predicted centroids, their derivatives by the errors, and which are in view.

    Parameters
    ----------
    C_si : (..., 3, 3) array
        Attitude of the star tracker, `shift` included.
    shift : (..., 3, 3) array
        What the optional states turn it by.
    slopes : (..., 3, m) array
        Rotation vector by which it is off for each error of theirs.
    intrinsics : (..., 7) array
        Camera.
    u_i : (..., n, 3) array
        Apparent places.
    pitch_mm : float
    cos_field : float
        Of the radius up to which a star may be predicted.

    Returns
    -------
    uv : (..., n, 2) array
    H : (..., n, 2, 16 + m) array
    in_view : (..., n) bool array
    """
    r_s = u_i @ np.swapaxes(C_si, -1, -2)
    seen = in_view(r_s, cos_field)
    if not seen.all():
        r_s = np.where(seen[..., None], r_s, (0.0, 0.0, 1.0))
    uv, H_s, H_intrinsics = camera.linearize(r_s, intrinsics, pitch_mm)
    H = np.zeros((*H_s.shape[:-1], LENS.stop + slopes.shape[-1]))
    H[..., THETA] = H_s
    H[..., LENS] = H_intrinsics
    if slopes.shape[-1]:
        H[..., THETA] = H_s @ shift[..., None, :, :]
        H[..., LENS.stop:] = H_s @ slopes[..., None, :, :]
    return uv, H, seen


def whitened(H: Array, z: Array, trail: Array) -> tuple[Array, Array]:
    """Return G^-1 H and G^-1 z, ``G G' = I + l l' / (12 s^2)`` of Eq. (E.2), G lower triangular.

    Parameters
    ----------
    H : (..., n, 2, k) array
    z : (..., n, 2) array
    trail : (..., n, 2) array
        l / (s sqrt(12)).
    """
    a, b = trail[..., 0], trail[..., 1]
    inverse = np.zeros((*a.shape, 2, 2))
    inverse[..., 0, 0] = 1.0 / np.sqrt(1.0 + a * a)
    inverse[..., 1, 1] = np.sqrt((1.0 + a * a) / (1.0 + a * a + b * b))
    inverse[..., 1, 0] = -a * b / (1.0 + a * a) * inverse[..., 1, 1]
    return inverse @ H, (inverse @ z[..., None])[..., 0]


def bends(C_si: Array, u_i: Array, sigma: Array, error: Array, root: Array, intrinsics: Array,
          shift: Array, second: Array, largest: Array, pitch_mm: float, cos_field: float) -> bool:
    """Tell whether what a frame leaves out may matter in any run; see `curvature.bends`.

    Parameters
    ----------
    C_si, u_i, sigma, error, root, intrinsics : arrays
        See `correct`; without the stars that are not in view. With feedback an error is expected
        only of a frame that is linearised where it fits: nothing matters there.
    shift, second, largest : arrays
        See `curvature.Curvature`.
    pitch_mm, cos_field : float
        See `predict`.
    """
    usable = in_view(u_i @ np.swapaxes(C_si, -1, -2), cos_field) & ~np.any(
        error != 0.0, axis=-1, keepdims=True)
    return bool(curvature.bends(
        root[..., SEEN, :] * SCALE[SEEN, None], np.where(usable, sigma, np.inf), shift, second,
        largest, pitch_mm / intrinsics[..., 2]).any())


def correct(C_gi: Array, bias: Array, C_sg: Array, intrinsics: Array, error: Array, root: Array,
            C_si: Array, shift: Array, slopes: Array, trail: Array, u_i: Array, uv: Array,
            sigma: Array, left_out: Array, direct: Array, scale: Array, pitch_mm: float,
            cos_field: float, gate: float, feedback: bool) -> Corrected:
    """Correct beliefs with a frame (T18 Eq. 23 to 26).

    Parameters
    ----------
    C_gi, bias, C_sg, intrinsics : arrays
        Values.
    error, root : arrays
        Their expected error, and the root of its covariance, scaled.
    C_si, shift, slopes : arrays
        See `predict`.
    trail : (r, 3) array
        Turn of the camera during the exposure, over the spot's width and sqrt(12); zero where
        stars do not trail.
    u_i, uv, sigma : arrays
        The stars; infinite sigma for one that is not used.
    left_out : (r, n) array
        Standard deviation of what the linear model leaves out of each centroid [px].
    direct : (r, n, 2, m) array
        How the errors of the optional states displace each centroid.
    scale : (n,) array
        Of the states.
    pitch_mm, cos_field : float
        See `predict`.
    gate : float
        Largest chi-square of a star that is used.
    feedback : bool
        Free the values of the error.
    """
    predicted, H, seen = predict(C_si, shift, slopes, intrinsics, u_i, pitch_mm, cos_field)
    H[..., LENS.stop:] += direct
    z = predicted - uv
    H_white, innovations = H, z - times(H, error[..., None, :])
    if trail.any():
        H_white, innovations = whitened(
            H, innovations, (H[..., THETA] @ trail[:, None, :, None])[..., 0])
    # Not a bit differs where nothing is left out.
    if left_out.any():
        sigma = np.hypot(sigma, left_out)
    innovation = kalman.innovate(root, H_white * scale, innovations, sigma)
    accepted = seen & np.isfinite(sigma) & (innovation.chi2 <= gate)
    step, after, nis = kalman.correct(root, innovation, accepted)
    error = error + scale * step
    residual = times(H, error[..., None, :]) - z
    freed = np.zeros_like(error)
    if feedback:
        turn = rotation.exp(-np.stack((error[..., THETA], error[..., PSI])))
        C_si = C_sg @ C_gi
        C_sg = rotation.orthonormalized(turn[1] @ C_sg)
        C_gi = rotation.orthonormalized(np.swapaxes(C_sg, -1, -2) @ turn[0] @ C_si)
        bias, intrinsics = bias - error[..., EPSILON], intrinsics - error[..., LENS]
        freed, error = error, freed
    variance = np.einsum('...i,...i->...', innovation.M, innovation.M)
    spread = np.sqrt(np.max(np.where(accepted[..., None], variance, 0.0), axis=(-2, -1),
                            initial=0.0))
    said = kalman.evidence(innovation, H_white * scale / sigma[..., None, None], accepted, after)
    return Corrected(error, after, C_gi, bias, C_sg, intrinsics, freed, innovation.chi2, accepted,
                     residual, nis, spread, said.z, said.H, said.M, said.L)


def carry(E: Array, Phi: Array, C_gi_before: Array, C_gi: Array, C_sg: Array, Delta: Array,
          J: Array, duration: Array) -> None:
    """Carry the responses to effects, in place, over an interval, Eq. (R.1) of `responses`.

    Parameters
    ----------
    E : (r, n, 3 g) array
        Responses.
    Phi : (r, n, n) array
        Transition of the scaled errors.
    C_gi_before, C_gi, C_sg : (r, 3, 3) arrays
        Attitude at the beginning and the end of the interval, and mounting.
    Delta, J, duration : arrays
        See `preintegration`.
    """
    V = hypotheses.shift(C_gi_before, C_gi, C_sg, Delta, J, duration, E.shape[-2])
    E[...] = Phi @ E
    E[..., :V.shape[-1]] += V


def judge(z: Array, H: Array, M: Array, L: Array, root: Array, E: Array, s: Array,
          information: Array, C_si: Array, rate_s: Array, u_i: Array, uv: Array, sigma: Array,
          magnitude: Array, accepted: Mask, spread: Array, nis: Array, half: Array, C_sg: Array,
          noise: Array) -> TurnFound:
    """Take a frame into the responses to effects, in place, and tell what it says of turns.

    Parameters
    ----------
    z, H, M, L, root : arrays
        See `core.kalman.Evidence`.
    E, s, information : arrays
        See `responses`.
    C_si : (r, 3, 3) array
        Attitude of the star tracker before the frame.
    rate_s : (r, 3) array
        Rate of the camera, in s [rad/s].
    u_i, uv, sigma, magnitude : arrays
        The stars.
    accepted, spread, nis : arrays
        See `error_state.Update`.
    half : (2,) array
        Half of the detector [px].
    C_sg : (r, 3, 3) array
        Mounting.
    noise : (r, 2) array
        Of `hypotheses.drawn`.
    """
    said = kalman.Evidence(z, H, M, L, root)
    N, v = said.explained(H[..., THETA] / SCALE[0])
    values = np.linalg.eigvalsh(N)
    # Stars at one place tell no roll.
    judged = ((accepted.sum(axis=-1) > 2) & (spread < SPREAD)
              & (values[..., 0] > BLIND * values[..., -1]) & np.isfinite(nis))
    d = np.zeros((*z.shape, E.shape[-1]))
    known = hypotheses.direct(said, C_si, rate_s, hypotheses.Sight(u_i, uv, magnitude, half))
    d[..., :known.shape[-1]] = known
    responses.respond(said, d, np.asarray(judged), E, s, information)
    drawn = hypotheses.drawn(N, C_sg, noise)
    s[..., :drawn.shape[-2], :] -= np.where(judged[..., None, None], drawn, 0.0)
    root_N = np.linalg.cholesky(np.where(judged[..., None, None], N, np.eye(3)))
    variance = np.einsum('...i,...i->...', M, M)
    normal = (z / np.sqrt(1.0 + variance)).reshape(uv.shape)
    e = np.asarray(np.linalg.solve(root_N, v[..., None])[..., 0], np.float64)
    return TurnFound(np.asarray(judged), e, root_N, normal, cell_of(uv, half),
                     likelihood.log_det(sigma, accepted, L))


def advance(belief: Values, constants: Constants, intervals: Intervals, stars: StretchStars,
            sums: TestSums, out: Gained, most: int) -> tuple[int, bool]:
    """Process no frame: one after the other is what the calibrator does with the rest of this."""
    return 0, False


def times(A: Array, x: Array) -> Array:
    """Return A x, (..., n), of A (..., n, k) and x (..., k)."""
    return (A @ x[..., None])[..., 0]
