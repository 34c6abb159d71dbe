# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the filter believes: nominal values, their expected error and its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from starcal_ros.core import kalman, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.filter.augmentation import NONE, Augmentation
from starcal_ros.filter.states import EPSILON, LENS, N_STATES, PHI, PSI, SCALE, THETA


@dataclass(frozen=True)
class Nominal:
    """What is believed: the values that the filter's errors are errors of.

    Attributes
    ----------
    C_gi : (..., 3, 3) array
        Attitude, i to g.
    bias : (..., 3) array
        Gyro bias [rad/s].
    C_sg : (..., 3, 3) array
        Mounting, g to s.
    intrinsics : (..., 7) array
        Camera, as in `starcal_ros.core.camera`.
    augmented : (..., m) array
        Values of the optional states that are on.
    reading : (..., 3) array
        The gyro's reading at the stamp, bias included [rad/s]; optional states may need it.
    augmentation : Augmentation
        Which optional states are on.
    steady : (..., 3) array
        Rate of g in which noise of the gyro does not show; zero where all may be noise [rad/s].
    by_noise : (..., m) array
        Information on each scaled error of the optional states that such noise feigned.
    moments : (..., 2, 3, 3) array
        Of `NoiseMoments`, after the frame before.
    """

    C_gi: Array
    bias: Array
    C_sg: Array
    intrinsics: Array
    augmented: Array = field(default_factory=lambda: np.empty(0))
    reading: Array = field(default_factory=lambda: np.zeros(3))
    augmentation: Augmentation = NONE
    steady: Array = field(default_factory=lambda: np.zeros(3))
    by_noise: Array = field(default_factory=lambda: np.zeros(()))
    moments: Array = field(default_factory=lambda: np.zeros((2, 3, 3)))

    @classmethod
    def stacked(cls, runs: Sequence[Nominal]) -> Nominal:
        """Return the values of some runs of one filter as those of a batch."""
        return cls(**{name: _stacked([getattr(run, name) for run in runs])
                      for name in cls.names()}, augmentation=runs[0].augmentation)

    def of_run(self, run: int | slice) -> Nominal:
        """Return the values of one run of a batch, or of some."""
        return Nominal(**{name: getattr(self, name)[run] for name in self.names()},
                       augmentation=self.augmentation)

    @classmethod
    def joined(cls, batches: Sequence[Nominal]) -> Nominal:
        """Return the values of all runs of some batches of one filter as those of one."""
        return cls(**{name: np.concatenate([getattr(batch, name) for batch in batches])
                      for name in cls.names()}, augmentation=batches[0].augmentation)

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of all the arrays."""
        return [part.name for part in fields(cls) if part.name != 'augmentation']

    @property
    def C_si(self) -> Array:
        """Attitude of the star tracker, (..., 3, 3), i to s."""
        return self.C_sg @ self.C_gi

    def without(self, error: Array) -> Nominal:
        """Return the values freed of an error (..., 16 + m), its attitude part theta."""
        turn = rotation.exp(-np.stack((error[..., THETA], error[..., PSI])))
        C_sg = rotation.orthonormalized(turn[1] @ self.C_sg)
        C_gi = rotation.orthonormalized(np.swapaxes(C_sg, -1, -2) @ turn[0] @ self.C_si)
        return self.set_to(C_gi, self.bias - error[..., EPSILON], C_sg,
                           self.intrinsics - error[..., LENS], error)

    def at(self, C_gi: Array, reading: Array, steady: Array) -> Nominal:
        """Return these values with the attitude, the reading and the rate of another time."""
        return Nominal(C_gi, self.bias, self.C_sg, self.intrinsics, self.augmented, reading,
                       self.augmentation, steady, self.by_noise, self.moments)

    def moved(self, C_gi: Array, bias: Array, C_sg: Array, intrinsics: Array, reading: Array
              ) -> Nominal:
        """Return T18's states at some other times, (m, ...) arrays; all else as it is here."""
        kept = (np.broadcast_to(part, (len(bias), *part.shape)) for part in (
            self.augmented, self.steady, self.by_noise, self.moments))
        augmented, steady, by_noise, moments = kept
        return Nominal(C_gi, bias, C_sg, intrinsics, augmented, reading, self.augmentation,
                       steady, by_noise, moments)

    def set_to(self, C_gi: Array, bias: Array, C_sg: Array, intrinsics: Array, error: Array
               ) -> Nominal:
        """Return these values freed of an error, those of T18's states being known already."""
        augmented = self.augmented
        if self.augmentation.on:
            augmented = np.concatenate([
                state.freed(augmented[..., place], error[..., among], self.C_sg)
                for state, place, among in self.augmentation.errors()], axis=-1)
        return Nominal(C_gi, bias, C_sg, intrinsics, augmented, self.reading,
                       self.augmentation, self.steady, self.by_noise, self.moments)

    def minus(self, truth: Nominal) -> Array:
        """Return the error (..., 16 + m) of these values, its attitude part theta."""
        augmented = [
            state.error(self.augmented[..., place], truth.augmented[..., place], self.C_sg)
            for state, place in self.augmentation.places]
        return np.concatenate((
            rotation.log(self.C_si @ np.swapaxes(truth.C_si, -1, -2)),
            self.bias - truth.bias,
            rotation.log(self.C_sg @ np.swapaxes(truth.C_sg, -1, -2)),
            self.intrinsics - truth.intrinsics, *augmented), axis=-1)


@dataclass(frozen=True)
class Belief:
    """Nominal values, the error expected of them, and the covariance of that error.

    Attributes
    ----------
    nominal : Nominal
        Values.
    error : (..., n) array
        Expected error of the n = 16 + m values, its attitude part theta; zero with feedback.
    root : (..., n, n) array
        Root of the error covariance, each state in units of SCALE, the attitude part theta.
    """

    nominal: Nominal
    error: Array
    root: Array

    @classmethod
    def stacked(cls, runs: Sequence[Belief]) -> Belief:
        """Return what some runs of one filter believe as a batch."""
        return cls(Nominal.stacked([run.nominal for run in runs]),
                   _stacked([run.error for run in runs]), _stacked([run.root for run in runs]))

    @classmethod
    def joined(cls, batches: Sequence[Belief]) -> Belief:
        """Return what all runs of some batches of one filter believe as one batch."""
        return cls(Nominal.joined([batch.nominal for batch in batches]),
                   np.concatenate([batch.error for batch in batches]),
                   np.concatenate([batch.root for batch in batches]))

    def of_run(self, run: int | slice) -> Belief:
        """Return what one run of a batch believes, or some."""
        return Belief(self.nominal.of_run(run), self.error[run], self.root[run])

    @property
    def estimate(self) -> Nominal:
        """The best values: the nominal ones less their expected error."""
        return self.nominal.without(self.error) if self.error.any() else self.nominal

    @property
    def whole_root(self) -> Array:
        """Root of the covariance, (..., n, n), in the filter's units, the attitude part phi."""
        root = self.root * self.nominal.augmentation.scale[:, None]
        C_is = np.swapaxes(self.nominal.C_si, -1, -2)
        root[..., PHI, :] = C_is @ (root[..., THETA, :] - root[..., PSI, :])
        for state, place, among in self.nominal.augmentation.errors():
            root[..., among, :] = state.outer(
                root[..., among, :], self.nominal.augmented[..., place], self.nominal.C_sg)
        return root

    @property
    def state_root(self) -> Array:
        """Root of the covariance of T18's states, (..., 16, 16), in the filter's units."""
        return kalman.marginal(self.whole_root, N_STATES)

    @property
    def covariance(self) -> Array:
        """Covariance of T18's states, (..., 16, 16), in the filter's units."""
        root = self.state_root
        return root @ np.swapaxes(root, -1, -2)

    @property
    def sigma(self) -> Array:
        """Standard deviation of T18's states, (..., 16), in the filter's units."""
        return kalman.sigma_of(self.state_root)

    @property
    def augmented_sigma(self) -> Array:
        """Standard deviation of the augmented states, (..., m), in the filter's units."""
        return np.linalg.norm(self.whole_root[..., N_STATES:, :], axis=-1)

    @property
    def tracker_sigma(self) -> Array:
        """Standard deviation of theta, (..., 3): the attitude of the star tracker [rad]."""
        return SCALE[THETA] * np.linalg.norm(self.root[..., THETA, :], axis=-1)

    @property
    def told_by_noise(self) -> Array:
        """Part of what is known of each optional state that the gyro's noise feigned, (..., m)."""
        variance = np.sum(self.root[..., N_STATES:, :]**2, axis=-1)
        return np.asarray(self.nominal.by_noise * variance)

    @property
    def is_finite(self) -> bool:
        """Whether all that is believed is a number."""
        now = self.nominal
        # A sum of numbers is a number, as long as they are not as large as numbers can be.
        return bool(np.isfinite(sum(part.sum() for part in (
            self.root, self.error, now.C_gi, now.C_sg, now.bias, now.intrinsics, now.augmented))))

    def nees(self, truth: Nominal) -> Array:
        """Return the normalised estimation error squared, (...), of n degrees of freedom."""
        error = self.estimate.minus(truth) / self.nominal.augmentation.scale
        return np.sum(np.linalg.solve(self.root, error[..., None])**2, axis=(-2, -1))


def _stacked(parts: list[Array]) -> Array:
    """Return arrays of one shape as `numpy.stack` does, which looks at each of them twice."""
    shape = parts[0].shape
    return np.concatenate(parts).reshape(len(parts), *shape) if shape else np.array(parts)
