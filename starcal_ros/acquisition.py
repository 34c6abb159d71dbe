# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Attitude from the stars of one frame alone, wrong stars left out.

1. A star with a wrong number has wrong angles to nearly all others, a star with the right one
   to few: it stays while at least half of its angles agree with the catalogue, within what the
   camera may be wrong by.
2. The stars that stay give the attitude: Wahba's problem, scipy's solution.
3. The frame is fitted from there by Gauss-Newton (an iterated Kalman update), because first
   errors of many pixels are too large for one linear step; the worst star is left out until
   every residual lies inside the gate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from starcal_ros import camera
from starcal_ros.estimator import LENS, SCALE, Belief, Filter, Stars

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_STARS = 3
"""Stars that must agree before an attitude is believed."""

_ITERATIONS = 10
_CONVERGED = 0.01       # step, in sigmas of the fit, below which Gauss-Newton stops


class AcquisitionError(ValueError):
    """The stars of a frame give no attitude; the message says why."""


def acquire(filter_: Filter, belief: Belief | None, stars: Stars) -> tuple[Belief, Stars]:
    """Find the attitude in a frame, for the frame's own update to start from.

    Parameters
    ----------
    filter_ : Filter
        Scenario.
    belief : Belief or None
        What is known of the calibration; None at the start.
    stars : Stars
        One frame.

    Returns
    -------
    belief : Belief
        Wide in attitude, linearised where the frame fits best; the frame is not used up.
    stars : Stars
        The same frame, the sigma of stars that do not fit infinite.

    Raises
    ------
    AcquisitionError
        Where fewer than MIN_STARS agree.
    """
    known = filter_.begin(np.eye(3)) if belief is None else belief
    estimate, pitch_mm = known.estimate, filter_.detector.pitch_mm
    usable = np.flatnonzero(np.isfinite(stars.sigma))
    r_s = camera.unproject(stars.uv[usable], estimate.intrinsics, pitch_mm)
    # What the camera may do to the place of a star; a shift of all stars changes no angle.
    _, _, H = camera.linearize(r_s, estimate.intrinsics, pitch_mm)
    spread = np.linalg.norm(H[..., 2:] * known.sigma[LENS][2:], axis=(-2, -1)).max(initial=0.0)
    wrong_px = 6.0 * spread + 10.0 * stars.sigma[usable].max(initial=0.0)
    agreeing = agree(stars.u_i[usable], r_s, wrong_px * pitch_mm / estimate.intrinsics[2])
    if agreeing.sum() < MIN_STARS:
        raise AcquisitionError(f'{agreeing.sum()} of {len(stars.sigma)} stars agree with the '
                               f'catalogue, {MIN_STARS} are needed for an attitude')
    fix, _ = Rotation.align_vectors(r_s[agreeing], stars.u_i[usable][agreeing])
    C_gi = estimate.C_sg.T @ fix.as_matrix()
    start = filter_.begin(C_gi) if belief is None else filter_.reacquired(belief, C_gi)
    trusted = np.zeros(len(stars.sigma), dtype=bool)
    trusted[usable[agreeing]] = True
    return _fit(filter_, start, stars, trusted)


def agree(u_i: Array, r_s: Array, tolerance: float) -> Mask:
    """Tell which stars keep half of their angles to the others that do.

    Parameters
    ----------
    u_i, r_s : (n, 3) array
        Unit vectors to the stars: catalogue, in i, and measured, in s.
    tolerance : float
        Difference allowed between a measured and a catalogue angle [rad].

    Returns
    -------
    agreeing : (n,) bool array
    """
    same = np.abs(_angles(u_i) - _angles(r_s)) <= tolerance
    agreeing = np.ones(len(u_i), dtype=bool)
    while True:
        others = same[:, agreeing].sum(axis=1) - 1      # less the star's angle to itself
        stay = agreeing & (2 * others >= agreeing.sum() - 1)
        if (stay == agreeing).all():
            return stay
        agreeing = stay


def _angles(unit: Array) -> Array:
    """Return the angle of each pair, (n, n) [rad], accurate at small angles."""
    chord = np.linalg.norm(unit[:, None] - unit[None, :], axis=-1)
    return 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))


def _fit(filter_: Filter, start: Belief, stars: Stars, trusted: Mask) -> tuple[Belief, Stars]:
    """Relinearise where the frame fits best; leave out the stars that do not fit."""
    while True:
        frame = stars._replace(sigma=np.where(trusted, stars.sigma, np.inf))
        belief = start
        for _ in range(_ITERATIONS):
            update = filter_.update(belief, frame, gated=False)
            fitted = update.belief.estimate
            step = fitted.minus(belief.nominal)
            # The error that the prior expects of the new linearisation point.
            belief = Belief(fitted, fitted.minus(start.nominal), start.root)
            if np.abs(step / SCALE).max() < _CONVERGED:
                break
        misfit = np.linalg.norm(np.where(trusted[:, None], update.residual, 0.0), axis=-1)
        misfit = misfit / frame.sigma
        worst = int(np.argmax(misfit))
        if misfit[worst]**2 <= filter_.gate or trusted.sum() <= MIN_STARS:
            return belief if filter_.feedback else start, frame
        trusted = trusted.copy()
        trusted[worst] = False
