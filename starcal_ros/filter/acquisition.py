# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Attitude from the stars of one frame alone, wrong stars left out.

1. Each pair of stars gives an attitude, and each attitude finds more or fewer of the other stars
   where they were measured, within what the camera may be wrong by. The attitude that finds the
   most wins; a star with a wrong number is not among them.
2. Those stars give the attitude: Wahba's problem, scipy's solution.
3. A fit that lets go of what misses by more than most sorts out wrong stars that are not far
   off.
4. The frame is fitted from there by Gauss-Newton (an iterated Kalman update), because first
   errors of many pixels are too large for one linear step; the worst star is left out until
   every residual lies inside the gate.

An attitude is believed if at least half of the stars, and three, are left in the end.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from starcal_ros.core import camera, robust
from starcal_ros.core.arrays import Mask
from starcal_ros.core.consensus import consensus
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import LENS
from starcal_ros.measurements.samples import Stars

MIN_STARS = 3
"""Stars that must agree before an attitude is believed."""

_ITERATIONS = 10
_ROBUST_ITERATIONS = 30
_WIDTH = 2.0            # of the robust weight: twice what most miss by halves it twice
_CONVERGED = 0.01       # step, in units of the filter's scale, below which Gauss-Newton stops


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
        Where fewer than MIN_STARS, or than half of the stars, agree.
    """
    known = filter_.begin(np.eye(3)) if belief is None else belief
    estimate, pitch_mm = known.estimate, filter_.detector.pitch_mm
    usable = np.flatnonzero(np.isfinite(stars.sigma))
    r_s = camera.unproject(stars.uv[usable], estimate.intrinsics, pitch_mm)
    # What the camera may do to the place of a star; a shift of all stars changes no angle.
    _, _, H = camera.linearize(r_s, estimate.intrinsics, pitch_mm)
    spread = np.linalg.norm(H[..., 2:] * known.sigma[LENS][2:], axis=(-2, -1)).max(initial=0.0)
    wrong_px = 6.0 * spread + 10.0 * stars.sigma[usable].max(initial=0.0)
    agreeing = consensus(stars.u_i[usable], r_s, wrong_px * pitch_mm / estimate.intrinsics[2])
    _require(int(agreeing.sum()), len(usable))
    fix, _ = Rotation.align_vectors(r_s[agreeing], stars.u_i[usable][agreeing])
    C_gi = estimate.C_sg.T @ fix.as_matrix()
    start = filter_.begin(C_gi) if belief is None else filter_.reacquired(belief, C_gi)
    trusted: Mask = np.zeros(len(stars.sigma), dtype=bool)
    trusted[usable[agreeing]] = True
    trusted = _resist(filter_, start, stars, trusted)
    _require(int(trusted.sum()), len(usable))
    belief, frame = _fit(filter_, start, stars, trusted)
    _require(int(np.isfinite(frame.sigma).sum()), len(usable))
    return belief, frame


def _require(agreeing: int, usable: int) -> None:
    needed = max(MIN_STARS, (usable + 1) // 2)
    if agreeing < needed:
        raise AcquisitionError(f'{agreeing} of {usable} stars agree with the catalogue, '
                               f'{needed} are needed for an attitude')


def _resist(filter_: Filter, start: Belief, stars: Stars, trusted: Mask) -> Mask:
    """Fit with weights that resist what misses by more than most; return what is then near.

    The scale of the weights (`core.robust`) is the median miss: wrong stars that are not far off
    would pull the plain fit to them.
    """
    belief, scale = start, stars.sigma
    for _ in range(_ROBUST_ITERATIONS):
        uv, _, _ = filter_.predict_centroids(belief.nominal, stars.u_i)
        miss = np.linalg.norm(uv - stars.uv, axis=-1)
        scale = np.maximum(robust.scale_of(miss[trusted]), stars.sigma)
        sigma = np.where(trusted, scale * robust.sigma_factor(miss, scale, _WIDTH), np.inf)
        update = filter_.update(belief, stars._replace(sigma=sigma), gated=False)
        fitted = update.belief.estimate
        step = fitted.minus(belief.nominal)
        belief = Belief(fitted, fitted.minus(start.nominal), start.root)
        if np.abs(step / filter_.scale).max() < 10.0 * _CONVERGED:
            break
    uv, _, _ = filter_.predict_centroids(belief.nominal, stars.u_i)
    return trusted & (np.linalg.norm(uv - stars.uv, axis=-1) <= 6.0 * scale)


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
            if np.abs(step / filter_.scale).max() < _CONVERGED:
                break
        misfit = np.linalg.norm(np.where(trusted[:, None], update.residual, 0.0), axis=-1)
        misfit = misfit / frame.sigma
        worst = int(np.argmax(misfit))
        if misfit[worst]**2 <= filter_.gate or trusted.sum() <= MIN_STARS:
            return belief if filter_.feedback else start, frame
        trusted = trusted.copy()
        trusted[worst] = False
