# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Attitude from the stars of one frame, wrong stars left out; and which of them agree.

A star's own gate holds as long as its prediction is about as certain as its centroid. Where no
attitude is known, or all stars may be off together (after a silence of the gyro, while the camera
is little known), the gate lets anything through. There the stars judge each other:

1. Each pair of stars gives an attitude, and each attitude finds more or fewer of the other stars
   where they were measured, within what the camera may be wrong by. The attitude that finds the
   most wins; a star with a wrong number is not among them.
2. Those stars give the attitude: Wahba's problem, scipy's solution.
3. A fit that lets go of what misses by more than most sorts out wrong stars that are not far
   off.
4. The frame is fitted from there by Gauss-Newton (an iterated Kalman update), because first
   errors of many pixels are too large for one linear step; stars leave, the worst first, until
   each lies inside the gate about where all others put it.

With r the residual of a star after the fit and M its derivatives by the states, both divided by
sigma and M for the covariance after the fit, what the others leave of it is ::

    chi2 = r' (I - M M')^-1 r                                                           (A.5)

The same finds the stars that agree on a turn which a certain prediction denies (`turned`).

An attitude is believed, and a frame used, if at least half of the stars, and three, are left in
the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from starcal_ros.core import camera, robust, rotation
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.consensus import consensus
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.filter.states import LENS
from starcal_ros.measurements.samples import Stars

MIN_STARS = 3
"""Stars that must agree before an attitude is believed."""
WIDE = 3.0
"""Predicted spread of a centroid, in its sigmas, from which on the stars judge each other."""
MOST_TORN = 0.75
"""Part of the stars that is used of a frame with an unseen turn, at most."""
TORN = 3.0
"""Their NIS over its degrees of freedom, at least."""

_LINEAR = 100.0         # turn that one step of the filter takes, in sigmas of a star
_ITERATIONS = 10
_ROBUST_ITERATIONS = 30
_PASSES = 20            # in which stars leave the fit
_WIDTH = 2.0            # of the robust weight: twice what most miss by halves it twice
_CONVERGED = 0.01       # step, in units of the filter's scale, below which Gauss-Newton stops
_LEAST = 1e-9           # part of a star that its own fit leaves, at least


class AcquisitionError(ValueError):
    """The stars of a frame give no attitude; the message says why."""


def acquire(filter_: Filter, belief: Belief | None, stars: Stars,
            reading: Array = np.zeros(3)) -> tuple[Belief, Stars]:
    """Find the attitude in a frame, for the frame's own update to start from.

    Parameters
    ----------
    filter_ : Filter
        Scenario.
    belief : Belief or None
        What is known of the calibration; None at the start.
    stars : Stars
        One frame.
    reading : (3,) array
        The gyro's reading at its stamp [rad/s]: how far the stars trail.

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
    known = replace(known, nominal=replace(known.nominal, reading=reading))
    C_gi, trusted = _look(filter_, known, stars)
    start = filter_.begin(C_gi) if belief is None else filter_.reacquired(belief, C_gi)
    start = replace(start, nominal=replace(start.nominal, reading=reading))
    found, frame = _fit(filter_, start, start, stars, trusted)
    return found if filter_.feedback else start, frame


def agreed(filter_: Filter, belief: Belief, stars: Stars) -> tuple[Belief, Stars]:
    """Judge the stars of a frame together.

    Parameters
    ----------
    filter_ : Filter
        Scenario.
    belief : Belief
        At the frame's stamp.
    stars : Stars
        The frame.

    Returns
    -------
    belief : Belief
        Linearised where the frame fits best; the frame is not used up.
    stars : Stars
        The same frame, the sigma of stars that do not fit infinite: of all where too few agree.
    """
    try:
        C_gi, trusted = _look(filter_, belief, stars)
        estimate = belief.estimate
        prior = Belief(estimate, np.zeros_like(belief.error), belief.root)
        turned = replace(estimate, C_gi=C_gi)
        at = Belief(turned, turned.minus(estimate), belief.root)
        found, frame = _fit(filter_, prior, at, stars, trusted)
    except AcquisitionError:
        return belief, stars._replace(sigma=np.full_like(stars.sigma, np.inf))
    return found if filter_.feedback else belief, frame


def is_torn(stars: Stars, update: Update) -> bool:
    """Tell whether the gates of the stars may have torn a frame apart.

    A turn that nobody saw puts all stars beside their gates alike, so that some of the good ones
    are rejected and the others are all off: stars that are wrong would leave the rest as it is.
    """
    used, usable = int(update.accepted.sum()), int(np.isfinite(stars.sigma).sum())
    return (usable >= MIN_STARS and used <= MOST_TORN * usable
            and (not used or bool(update.nis > TORN * 2 * used)))


def turned(filter_: Filter, belief: Belief, stars: Stars) -> Stars | None:
    """Return the stars that agree on a turn which the prediction denies; None for no such turn.

    Parameters
    ----------
    filter_ : Filter
        Scenario.
    belief : Belief
        At the frame's stamp, its prediction not wide.
    stars : Stars
        The frame.
    """
    now = belief.estimate
    try:
        C_gi, _ = _look(filter_, belief, stars)
    except AcquisitionError:
        return None
    turn = float(np.linalg.norm(rotation.log(now.C_sg @ C_gi @ now.C_si.T)))
    sigma = stars.sigma[np.isfinite(stars.sigma)].max()
    if turn > _LINEAR * sigma * filter_.detector.pitch_mm / now.intrinsics[2]:
        return None
    _, together = agreed(filter_, filter_.reacquired(belief, now.C_gi), stars)
    return together if np.isfinite(together.sigma).any() else None


def _look(filter_: Filter, known: Belief, stars: Stars) -> tuple[Array, Mask]:
    """Return the attitude C_gi, (3, 3), that most stars agree with, and which stars, (n,).

    Raises
    ------
    AcquisitionError
        Where fewer than MIN_STARS, or than half of the stars, agree.
    """
    estimate, pitch_mm = known.estimate, filter_.detector.pitch_mm
    usable = np.flatnonzero(np.isfinite(stars.sigma))
    r_s = camera.unproject(stars.uv[usable], estimate.intrinsics, pitch_mm)
    # What the camera may do to the place of a star; a shift of all stars changes no angle.
    _, H_s, H = camera.linearize(r_s, estimate.intrinsics, pitch_mm)
    spread = np.linalg.norm(H[..., 2:] * known.sigma[LENS][2:], axis=(-2, -1)).max(initial=0.0)
    smeared = np.hypot(1.0, np.linalg.norm(filter_.model.trail(estimate, H_s), axis=-1))
    wrong_px = 6.0 * spread + 10.0 * (smeared * stars.sigma[usable]).max(initial=0.0)
    agreeing = consensus(stars.u_i[usable], r_s, wrong_px * pitch_mm / estimate.intrinsics[2])
    _require(int(agreeing.sum()), len(usable))
    C_si = rotation.wahba(r_s[agreeing].T @ stars.u_i[usable][agreeing])
    trusted: Mask = np.zeros(len(stars.sigma), dtype=bool)
    trusted[usable[agreeing]] = True
    return estimate.C_sg.T @ C_si, trusted


def _fit(filter_: Filter, prior: Belief, at: Belief, stars: Stars, trusted: Mask
         ) -> tuple[Belief, Stars]:
    """Relinearise where a frame fits best; leave out the stars that do not fit.

    Parameters
    ----------
    filter_ : Filter
        Scenario.
    prior : Belief
        Before the frame, no error expected.
    at : Belief
        The same, linearised where the fit is to begin.
    stars : Stars
        The frame.
    trusted : (n,) bool array
        Stars to begin with.

    Returns
    -------
    belief, stars
        As from `agreed`.

    Raises
    ------
    AcquisitionError
        Where fewer than MIN_STARS, or than half of the stars, are left.
    """
    usable = int(np.isfinite(stars.sigma).sum())
    trusted = _resist(filter_, prior, at, stars, trusted)
    for _ in range(_PASSES):
        _require(int(trusted.sum()), usable)
        frame = stars._replace(sigma=np.where(trusted, stars.sigma, np.inf))
        belief, misfit = _relinearised(filter_, prior, at, frame)
        worst = float(misfit[trusted].max())
        if worst <= filter_.gate:
            return belief, frame
        # One that is far off displaces others: these stay for the next pass.
        trusted = trusted & (misfit <= max(filter_.gate, 0.25 * worst))
    raise AcquisitionError(f'the stars do not settle in {_PASSES} passes')


def _require(agreeing: int, usable: int) -> None:
    needed = max(MIN_STARS, (usable + 1) // 2)
    if agreeing < needed:
        raise AcquisitionError(f'{agreeing} of {usable} stars agree with the catalogue, '
                               f'{needed} are needed for an attitude')


def _resist(filter_: Filter, prior: Belief, at: Belief, stars: Stars, trusted: Mask) -> Mask:
    """Fit with weights that resist what misses by more than most; return what is then near.

    The scale of the weights (`core.robust`) is the median miss: wrong stars that are not far off
    would pull the plain fit to them.
    """
    belief, scale = at, stars.sigma
    for _ in range(_ROBUST_ITERATIONS):
        miss = _miss(filter_, belief.nominal, stars)
        scale = np.maximum(robust.scale_of(miss[trusted]), stars.sigma)
        sigma = np.where(trusted, scale * robust.sigma_factor(miss, scale, _WIDTH), np.inf)
        update = filter_.update(belief, stars._replace(sigma=sigma), gated=False)
        fitted = update.belief.estimate
        step = fitted.minus(belief.nominal)
        belief = Belief(fitted, fitted.minus(prior.nominal), prior.root)
        if np.abs(step / filter_.scale).max() < 10.0 * _CONVERGED:
            break
    return trusted & (_miss(filter_, belief.nominal, stars) <= 6.0 * scale)


def _miss(filter_: Filter, nominal: Nominal, stars: Stars) -> Array:
    uv, H, _ = filter_.model.predict(nominal, stars.u_i)
    return np.linalg.norm(filter_.model.whitened(nominal, H, uv - stars.uv)[1], axis=-1)


def _relinearised(filter_: Filter, prior: Belief, at: Belief, frame: Stars
                  ) -> tuple[Belief, Array]:
    """Return where a frame fits best, and the chi-square of Eq. (A.5) of each star, (n,)."""
    belief = at
    for _ in range(_ITERATIONS):
        update = filter_.update(belief, frame, gated=False)
        fitted = update.belief.estimate
        step = fitted.minus(belief.nominal)
        at_last = belief.nominal
        _, H, in_view = filter_.model.predict(at_last, frame.u_i)
        # The error that the prior expects of the new linearisation point.
        belief = Belief(fitted, fitted.minus(prior.nominal), prior.root)
        if np.abs(step / filter_.scale).max() < _CONVERGED:
            break
    H, residual = filter_.model.whitened(at_last, H, update.residual)
    M = (H * filter_.scale) @ update.belief.root / frame.sigma[:, None, None]
    left, turned = np.linalg.eigh(np.eye(2) - M @ np.swapaxes(M, -1, -2))
    r = np.einsum('nji,nj->ni', turned, residual) / frame.sigma[:, None]
    misfit = np.sum(r * r / np.maximum(left, _LEAST), axis=-1)
    return belief, np.where(in_view, misfit, np.inf)
