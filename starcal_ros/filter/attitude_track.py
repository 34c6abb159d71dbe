# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The attitude between frames: integrated from the last update, at each gyro sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.filter import arithmetic
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import EPSILON, PHI, SCALE
from starcal_ros.filter.track_reference import Attained
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples


class AttitudeTrack(NamedTuple):
    """The integrated attitude at gyro stamps.

    Attributes
    ----------
    stamp_ns : (n,) int64 array
        Stamps.
    C_gi : (n, 3, 3) array
        Attitude.
    covariance : (n, 3, 3) array
        Of the attitude error, in i [rad^2].
    rate : (n, 3) array
        Angular velocity without bias, in g [rad/s].
    """

    stamp_ns: Ints
    C_gi: Array
    covariance: Array
    rate: Array

    @classmethod
    def empty(cls) -> AttitudeTrack:
        """Return no attitude."""
        return cls(np.empty(0, np.int64), np.empty((0, 3, 3)), np.empty((0, 3, 3)),
                   np.empty((0, 3)))


class _Frame(NamedTuple):
    """What the integration goes on from: the frame, and the root of what it left."""

    stamp_ns: int
    root: Array
    drift: Array


class AttitudeTracker:
    """Integrates from each update onwards, each gyro sample once."""

    def __init__(self, filter_: Filter, period_ns: float) -> None:
        self.filter = filter_
        self._period_ns = period_ns
        self._given_ns = np.iinfo(np.int64).min
        self._frame: _Frame | None = None

    def advance(self, belief: Belief, frame_ns: int, gyro: GyroSamples, until_ns: int
                ) -> AttitudeTrack:
        """Return the attitude at the samples that have not been given yet.

        Parameters
        ----------
        belief : Belief
            After the last frame.
        frame_ns : int
            Stamp of that frame.
        gyro : GyroSamples
            From the last sample at or before the frame on, or from an earlier one.
        until_ns : int
            Stamp before which the samples must lie.
        """
        first, last = np.searchsorted(
            gyro.stamp_ns, [max(frame_ns, self._given_ns + 1), until_ns]).tolist()
        if first >= last:
            return AttitudeTrack.empty()
        estimate = belief.estimate
        if self._frame is None or self._frame.stamp_ns != frame_ns:
            states = belief.whole_root
            self._frame = _Frame(frame_ns, states, estimate.C_gi.T @ states[EPSILON])
            self._reached = Attained(np.array([frame_ns]), estimate.C_gi[None],
                                     np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1))
        gain = estimate.augmentation.gain(estimate.augmented)
        attained = arithmetic.integrate(
            gyro, first, last, self._reached, estimate.bias, gain, self._period_ns)
        self._reached = attained.last
        self._given_ns = int(attained.stamp_ns[-1])
        root, elapsed = self._frame.root, np.asarray(
            (attained.stamp_ns - frame_ns) * NS, np.float64)
        bent = np.zeros((last - first, 3, root.shape[1]))
        for state, _, among in estimate.augmentation.errors():
            slope = state.integrated(attained.turn)
            if slope is not None:
                bent += estimate.C_gi.T @ (slope @ root[among])
        variance = (self.filter.walk**2 * elapsed + self.filter.density[0]**2 * elapsed**3 / 3.0
                    + (self.filter.gap_acceleration * attained.gap_turn)**2)
        return AttitudeTrack(
            attained.stamp_ns, attained.C_gi,
            arithmetic.spread(root[PHI], self._frame.drift, bent, elapsed, variance),
            attained.rate)

    def latest(self, belief: Belief, frame_ns: int, gyro: GyroSamples) -> tuple[int, Array]:
        """Return the integrated attitude C_gi, (3, 3), at the last gyro sample, and its stamp.

        Parameters
        ----------
        belief, frame_ns, gyro
            As for `advance`; that of the frame where no sample is later.
        """
        estimate = belief.estimate
        if not len(gyro) or gyro.stamp_ns[-1] <= frame_ns:
            return frame_ns, estimate.C_gi
        last = int(gyro.stamp_ns[-1])
        pieces = preintegration.cut(gyro, np.array([frame_ns, last]), self._period_ns)
        gain = estimate.augmentation.gain(estimate.augmented)
        return last, preintegration.track(estimate.C_gi, pieces, estimate.bias, gain)[-1]

    def rate_covariance(self, belief: Belief | None) -> Array:
        """Return the covariance of a rate, (3, 3) [rad^2/s^2]: of a reading, and of the bias.

        Of the noise alone before anything is believed.
        """
        noise = np.eye(3) * (self.filter.walk**2 / (self._period_ns * NS))
        if belief is None:
            return noise
        root = belief.root[EPSILON] * SCALE[EPSILON, None]
        return noise + root @ root.T
