# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The 16-state error filter on predicted star centroids (T18 Sec. 2.2).

States
------
Errors are estimate minus truth ::

    phi      0:3    attitude         C_gi_est = C_gi (I + [phi x]), phi in i   (T18 Eq. 7)
    epsilon  3:6    gyro bias        b_est - b
    Psi      6:9    fixed angles     C_sg_est = (I + [Psi x]) C_sg, Psi in s   (T18 Eq. 8)
    9:16            intrinsics       u0, v0, f, k1, k2, p1, p2

All that leaves this module is in these terms. Inside, the filter counts the attitude error of the
star tracker instead, ``C_si_est = (I + [theta x]) C_si``, to first order ::

    theta = Psi + C_si phi                                                             (E.1)

A frame sees theta alone, so what it can not see, Psi, stays one and the same direction however
the estimate moves. With phi that direction is ``phi = -C_is Psi``: it turns with every
correction of C_si, and errors of 600 arcsec then make the filter believe after a minute that it
knows Psi three times better than it does.

Model
-----
Over an interval in which the gyro turns by Delta, with ``C_s1s0 = C_sg Delta C_gs`` and J of
`preintegration` ::

    theta1 = C_s1s0 theta0 + (I - C_s1s0) Psi + C_s1s0 C_sg J epsilon + n       (T18 Eq. 22)
    predicted - measured centroid = H_s theta + H_lens delta - w               (T18 Eq. 23, 24)

    n  white, N^2 dt I whatever the motion;  w  centroid noise;  all else constant

T18's Eq. 17 has the opposite sign of phi' because its epsilon is the bias itself, which its
attitude is integrated with; here the estimated bias is taken off first.

Delta is composed for a reference, its first-order correction made for the present bias; where that
is larger than `LARGEST_CORRECTION` the caller composes afresh for what is believed (`strays`).
`measurement_model` says what a frame is expected to be, and how its noise grows along a trail.

With feedback the nominal values are corrected after each frame and the expected error returns to
zero, so the linear model stays valid from large initial errors; without it the filter is the
paper's open-loop one: the nominal values stay and the expected error grows.

States may also walk at random, as `process_noise` says, and those of `augmentation` may follow the
16; both are off by default.

Inside the filter each state is divided by its `SCALE`, so that the roots hold numbers of like
size. Every function takes leading batch axes.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from starcal_ros.config.models import (detector, intrinsics, mounting_matrix, of_calibrated,
                                       star_gate)
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, kalman
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.units import DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, SQRT_HOUR
from starcal_ros.filter import arithmetic, reference
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.curvature import Curvature
from starcal_ros.filter.measurement_model import MeasurementModel
from starcal_ros.filter.optional_state import Drawn
from starcal_ros.filter.rate_noise import NoiseMoments, steady
from starcal_ros.filter.reference import times
from starcal_ros.filter.states import CALIBRATED, N_STATES, SCALE, THETA, UNIT
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Stars

_FIELD = 1.5            # a star may be predicted this far out, in halves of the detector

SIGMA_ACQUIRED = 1.0 * DEG
"""Attitude sigma given to a first fix: wide against its error, so that the frame's own update,
and not the fix, is what the estimate knows."""

LARGEST_CORRECTION = 1e-4
"""Turn by which the present bias and gain may correct an interval to first order [rad]: what its
square leaves out is 5e-9 rad, 0.001 arcsec."""
MOST_BY_NOISE = 0.5
"""Part of what is known of an optional state that noise of the gyro feigned, at most."""


class Update(NamedTuple):
    """What one frame did.

    Attributes
    ----------
    belief : Belief
        After the frame.
    chi2 : (..., n) array
        Normalised innovation squared of each star, two degrees of freedom.
    accepted : (..., n) bool array
        Stars that passed the gate and were used.
    nis : (...) array
        Normalised innovation squared of all the stars used together.
    residual : (..., n, 2) array
        Measured minus predicted centroid after the update, linearised [px].
    spread : (...) array
        Largest predicted spread of a centroid that was used, in its sigmas.
    linear : (...) bool array
        Whether the linear model held.
    place : (..., n, 2) array
        Where the stars are on the detector: as predicted after the update, whose errors are not
        those of the innovation, unlike those of what was measured or predicted before [px].
    evidence : Evidence, optional
        What it said of the model, where asked for.
    drawn : (..., n) array, optional
        What the noise of the gyro added to the scores of the scaled errors on average, and was
        taken off; None where no state goes with the rate.
    """

    belief: Belief
    chi2: Array
    accepted: Mask
    nis: Array
    residual: Array
    spread: Array
    linear: Mask
    place: Array
    evidence: kalman.Evidence | None = None
    drawn: Array | None = None


class Filter:
    """The filter of one scenario: its constants, and the steps as functions of a `Belief`.

    Parameters
    ----------
    scenario : Scenario
        Nominal values and estimator options.
    covariance : (13, 13) array, optional
        Of the error of the nominal values, in place of the initial sigmas.
    """

    def __init__(self, scenario: Scenario, covariance: Array | None = None) -> None:
        options = scenario.estimator
        self.detector = detector(scenario.camera)
        self.walk = scenario.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR
        self.gap_acceleration = options.gap_acceleration_deg_s2 * DEG
        self.gate = star_gate(options)
        self.feedback = options.feedback
        self.taken_as_linear = not options.feedback         # as the paper's filter does
        self.augmentation = Augmentation.of(options.augment)
        self.start = Nominal(np.eye(3), np.array(scenario.gyro.bias_deg_h) * DEG_PER_HOUR,
                             mounting_matrix(scenario.mounting), intrinsics(scenario.camera),
                             np.zeros(self.augmentation.size),
                             by_noise=np.zeros(self.augmentation.size),
                             augmentation=self.augmentation)
        self.initial_sigma = np.concatenate((
            np.full(3, SIGMA_ACQUIRED), of_calibrated(options.initial_sigma) * UNIT[CALIBRATED],
            self.augmentation.initial_sigma(options.augment)))
        self.tolerance = of_calibrated(options.tolerance) * UNIT[CALIBRATED]
        self.density = of_calibrated(options.process_noise) * UNIT[CALIBRATED] / SQRT_HOUR
        self.scale = self.augmentation.scale
        self._start_root = np.diag(self.initial_sigma / self.scale)
        if covariance is not None:
            self._start_root[CALIBRATED, CALIBRATED] = kalman.root_of(
                covariance / np.outer(SCALE[CALIBRATED], SCALE[CALIBRATED]))
        field = camera.field_of_view(self.detector, self.start.intrinsics, _FIELD)
        tracker = scenario.star_tracker
        self.model = MeasurementModel(
            self.detector, float(np.cos(field.radius)),
            (tracker.exposure_s / (np.sqrt(12.0) * scenario.image.psf_sigma_px)
             if tracker.smear else 0.0), Curvature(self.detector, self.start.intrinsics))

    def begin(self, C_gi: Array) -> Belief:
        """Return the belief at the first frame, from an attitude (..., 3, 3) found in it."""
        batch, n, start = C_gi.shape[:-2], len(self.scale), self.start
        root = np.broadcast_to(self._start_root, (*batch, n, n))
        others = {name: getattr(start, name) for name in start.names() if name != 'C_gi'}
        nominal = Nominal(C_gi, **{
            name: np.broadcast_to(part, (*batch, *part.shape)) for name, part in others.items()},
            augmentation=self.augmentation)
        return Belief(nominal, np.zeros((*batch, n)), root)

    def reacquired(self, belief: Belief, C_gi: Array) -> Belief:
        """Return the belief with its attitude found afresh, the calibration kept."""
        estimate = belief.estimate
        known = np.swapaxes(belief.root[..., 3:, :], -1, -2)
        root = np.zeros_like(belief.root)
        root[..., 3:, 3:] = np.swapaxes(np.linalg.qr(known, mode='r'), -1, -2)
        root[..., THETA, THETA] = np.eye(3) * (SIGMA_ACQUIRED / SCALE[THETA])
        nominal = replace(estimate, C_gi=C_gi, moments=np.zeros_like(estimate.moments))
        return Belief(nominal, np.zeros_like(belief.error), root)

    def walking(self, density: Array) -> Filter:
        """Return the filter with further random walks, (13,) in units of SCALE per root second."""
        changed = copy(self)
        changed.density = np.hypot(self.density, density * SCALE[CALIBRATED])
        return changed

    def untrailed(self) -> Filter:
        """Return the filter for stars that do not trail."""
        changed = copy(self)
        changed.model = replace(self.model, trail_s=0.0)
        return changed

    def as_linear(self) -> Filter:
        """Return the filter that takes its model of a frame for exact, whatever is uncertain."""
        changed = copy(self)
        changed.taken_as_linear = True
        return changed

    def opened(self, belief: Belief, error: Array, columns: Array) -> Belief:
        """Return a belief freed of an error, its covariance opened.

        Parameters
        ----------
        belief : Belief
        error : (..., n) array
            Of the scaled states.
        columns : (..., n, k) array
            To be joined to the root of the covariance.
        """
        error = belief.error + error * belief.nominal.augmentation.scale
        nominal = belief.nominal
        if self.feedback:
            nominal, error = nominal.without(error), np.zeros_like(error)
        return Belief(nominal, error, kalman.predict(
            belief.root, np.eye(belief.root.shape[-1]), columns))

    def strays(self, nominal: Nominal, gyro: Preintegrated) -> Mask:
        """Tell whether an interval has to be composed afresh for what is believed, (...)."""
        if gyro.bias is None:
            return np.zeros(gyro.duration.shape, np.bool_)
        turn = np.linalg.norm(nominal.bias - gyro.bias, axis=-1) * gyro.duration
        if nominal.augmentation.needs_matrix:
            gain = nominal.augmentation.gain(nominal.augmented)
            turn = turn + np.linalg.norm(gain - gyro.gain, axis=(-2, -1)) * gyro.path
        return np.asarray(turn > LARGEST_CORRECTION)

    def propagate(self, belief: Belief, gyro: Preintegrated) -> Belief:
        """Carry a belief over the interval that the gyro accounts for (T18 Eq. 22).

        Parameters
        ----------
        belief : Belief
            At the beginning of the interval.
        gyro : Preintegrated
            With the derivative by the gyro matrix where `augmentation` needs it.
        """
        return self.propagated(belief, gyro)[0]

    def propagated(self, belief: Belief, gyro: Preintegrated) -> tuple[Belief, Array]:
        """Do as `propagate`, and return the transition of the scaled errors, (..., n, n), too."""
        nominal, batch = belief.nominal, belief.error.shape[:-1]
        d = nominal.bias - (nominal.bias if gyro.bias is None else gyro.bias)
        slopes = np.zeros((*batch, 3, nominal.augmentation.size))
        J_b = gyro.J[..., :3]
        if nominal.augmentation.on:
            d = times(gyro.gain, d)
        turn = times(J_b, d)
        for state, place, _ in nominal.augmentation.errors():
            turned = state.turned(gyro.J, d, nominal.augmented[..., place], nominal.C_sg,
                                  gyro.gain)
            if turned is not None:
                turn, J_b, slopes[..., place] = turn + turned.turn, turned.J_b, turned.J
        sigma = np.sqrt(self.walk**2 * gyro.duration
                        + (self.gap_acceleration * gyro.gap_turn)**2)
        runs = arithmetic.LeadingAxes(batch)
        after = arithmetic.propagate(
            runs(nominal.C_gi, 2), runs(nominal.C_sg, 2), runs(belief.error, 1),
            runs(belief.root, 2), runs(gyro.Delta, 2), runs(turn, 1), runs(J_b, 2),
            runs(slopes, 2), runs(sigma, 0), runs(gyro.duration, 0), self.density, self.scale)
        C_gi, error, root, Phi = (runs.back(part) for part in after)
        return Belief(nominal.at(C_gi, gyro.reading, self._steady(belief, gyro)), error, root), Phi

    def _steady(self, belief: Belief, gyro: Preintegrated) -> Array:
        """Return the rate of g at the end of an interval, for states that go with it, (..., 3).

        None where noise has told more of one than stars have: it would be seen in it for good.
        """
        nominal = belief.nominal
        if not self.augmentation.draws:
            return nominal.steady
        told = np.all(belief.told_by_noise < MOST_BY_NOISE, axis=-1, keepdims=True)
        return np.where(told, steady(
            gyro, nominal.bias, nominal.augmentation.gain(nominal.augmented), self.walk), 0.0)

    def update(self, belief: Belief, stars: Stars, gated: bool = True, judged: bool = False,
               gyro: Preintegrated | None = None) -> Update:
        """Correct a belief with a frame (T18 Eq. 23 to 26).

        Parameters
        ----------
        belief : Belief
            At the frame's stamp.
        stars : Stars
            The frame.
        gated : bool
            Guard against what does not fit: reject stars whose chi-square lies outside the gate,
            and believe the frame less for what the linear model leaves out (`curvature`; not
            without feedback, as the paper's filter).
        judged : bool
            Give the evidence.
        gyro : Preintegrated, optional
            The interval before it: what its noise does to optional states is taken out.
        """
        sight, left_out = self.model.seen(belief.nominal), np.zeros(stars.sigma.shape)
        if gated and not self.taken_as_linear:
            left_out = self.model.left_out(belief, stars, sight[0], left_out)
        found, uv = self._corrected(belief, stars, sight, left_out, self.gate if gated else np.inf)
        nominal = belief.nominal
        if self.feedback:
            nominal = nominal.set_to(found.C_gi, found.bias, found.C_sg, found.intrinsics,
                                     found.freed)
        corrected, said, drawn = Belief(nominal, found.error, found.root), None, None
        draws = gyro is not None and self.augmentation.draws
        if judged or draws:
            said = kalman.Evidence(found.z, found.H, found.M, found.L, found.root)
        if draws and gyro is not None and said is not None:
            corrected, drawn = self._undrawn(belief, corrected, said, gyro)
        return Update(corrected, found.chi2, found.accepted, found.nis, found.residual,
                      found.spread, np.asarray(~left_out.any(axis=-1)), uv - found.residual, said,
                      drawn)

    def _corrected(self, belief: Belief, stars: Stars, sight: tuple[Array, Array, Array],
                   left_out: Array, gate: float) -> tuple[reference.Corrected, Array]:
        """Return the correction by a frame, and its centroids (..., n, 2) as they are taken.

        Parameters
        ----------
        belief : Belief
        stars : Stars
        sight : tuple of array
            From `MeasurementModel.seen`.
        left_out : (..., n) array
            What the linear model leaves out of each centroid.
        gate : float
            Largest chi-square of a star.
        """
        nominal = belief.nominal
        runs = arithmetic.LeadingAxes(belief.error.shape[:-1])
        C_si, shift, slopes = sight
        trail = (self.model.turn_of_exposure(nominal) if self.model.trails
                 else np.zeros(nominal.bias.shape))
        direct = self.model.displaced(belief, stars)
        uv = stars.uv
        if nominal.augmentation.on:
            uv = uv - times(direct, nominal.augmented[..., None, :])
        after = arithmetic.correct(
            runs(nominal.C_gi, 2), runs(nominal.bias, 1), runs(nominal.C_sg, 2),
            runs(nominal.intrinsics, 1), runs(belief.error, 1), runs(belief.root, 2),
            runs(C_si, 2), runs(shift, 2), runs(slopes, 2), runs(trail, 1), runs(stars.u_i, 2),
            runs(uv, 2), runs(stars.sigma, 1), runs(left_out, 1), runs(direct, 3), self.scale,
            self.detector.pitch_mm, self.model.cos_field, gate, self.feedback)
        return reference.Corrected(*(runs.back(part) for part in after)), uv

    def noise(self, gyro: Preintegrated) -> Array:
        """Return what `hypotheses.drawn` needs to know of the noise of an interval, (..., 2)."""
        return self.walk**2 * np.stack(np.broadcast_arrays(gyro.share, gyro.duration), axis=-1)

    def _undrawn(self, before: Belief, after: Belief, said: kalman.Evidence, gyro: Preintegrated
                 ) -> tuple[Belief, Array]:
        """Take off an update what the noise of the gyro adds for states that go with the rate.

        Of ``P H' S^-1 z`` that part has the mean P b, b of `rate_noise`. Of what the covariance
        seems to lose by it nothing is known, and the score scatters by as much.
        """
        nominal = before.nominal
        old = NoiseMoments(*np.moveaxis(nominal.moments, -3, 0))
        moments = old.before(np.any(nominal.steady, axis=-1), gyro.duration)
        N, _ = said.explained(said.H[..., THETA] / SCALE[0])
        drawn = self.augmentation.drawn(
            self.walk**2 * N, np.asarray(gyro.duration), moments, nominal.augmented)
        P, P_after = (root @ np.swapaxes(root, -1, -2) for root in (before.root, after.root))
        opened, feigned = self._taken_off(after, drawn, P)
        left = np.swapaxes(np.linalg.solve(
            P[..., THETA, THETA], P_after[..., THETA, THETA]), -1, -2)
        return replace(opened, nominal=replace(
            opened.nominal, by_noise=nominal.by_noise + feigned,
            moments=np.stack(old.after(moments, left), axis=-3))), drawn.score

    def _taken_off(self, after: Belief, drawn: Drawn, P: Array) -> tuple[Belief, Array]:
        """Return a belief without what noise drew, and what information on a state was feigned.

        Parameters
        ----------
        after : Belief
            After the frame.
        drawn : Drawn
            By the noise, of the scaled errors.
        P : (..., n, n) array
            Their covariance before the frame.
        """
        feigned = drawn.information / (
            1.0 + drawn.information * np.diagonal(P, axis1=-2, axis2=-1))
        columns = (P * np.sqrt(2.0 * feigned)[..., None, :])[..., N_STATES:]
        return self.opened(after, -times(P, drawn.score), columns), feigned[..., N_STATES:]
