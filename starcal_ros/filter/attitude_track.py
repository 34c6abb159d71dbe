# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The attitude between frames: integrated from the last update, at each gyro sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import EPSILON, PHI, SCALE
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


class _Reached(NamedTuple):
    """How far the integration from a frame has come, and the root of what the frame left."""

    frame_ns: int
    stamp_ns: int
    C_gi: Array
    gap_turn: float
    turn: Array
    states: Array


class AttitudeTracker:
    """Integrates from each update onwards, each gyro sample once."""

    def __init__(self, filter_: Filter, period_ns: float) -> None:
        self.filter = filter_
        self._period_ns = period_ns
        self._given_ns = np.iinfo(np.int64).min
        self._reached: _Reached | None = None

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
        estimate = belief.estimate
        reached = self._reached
        if reached is None or reached.frame_ns != frame_ns:
            reached = _Reached(frame_ns, frame_ns, estimate.C_gi, 0.0, np.zeros(3),
                               belief.whole_root)
        first, last = np.searchsorted(
            gyro.stamp_ns, [max(frame_ns, self._given_ns + 1), until_ns]).tolist()
        samples = gyro[first:last]
        if not len(samples):
            return AttitudeTrack.empty()
        self._given_ns = int(samples.stamp_ns[-1])
        pieces = preintegration.cut(
            gyro, np.array([reached.stamp_ns, self._given_ns]), self._period_ns)
        gain = estimate.augmentation.gain(estimate.augmented)
        C_gi = preintegration.track(reached.C_gi, pieces, estimate.bias, gain)
        # A sample at the stamp from which the integration goes on is there without a step.
        ends = np.concatenate(([reached.stamp_ns], pieces.end_ns))
        C_gi = np.concatenate((reached.C_gi[None], C_gi))
        gap_turn = reached.gap_turn + np.concatenate(([0.0], np.cumsum(pieces.gap_turn)))
        turns = (pieces.rate - estimate.bias) @ gain.T * pieces.dt[:, None]
        turn = reached.turn + np.concatenate((np.zeros((1, 3)), np.cumsum(turns, axis=0)))
        states = reached.states
        self._reached = _Reached(
            frame_ns, self._given_ns, C_gi[-1], float(gap_turn[-1]), turn[-1], states)
        rows = np.searchsorted(ends, samples.stamp_ns)
        elapsed = (samples.stamp_ns - frame_ns)[:, None, None] * NS
        root = states[PHI] + elapsed * (estimate.C_gi.T @ states[EPSILON])
        for state, _, among in estimate.augmentation.errors():
            slope = state.integrated(turn[rows])
            if slope is not None:
                root = root + estimate.C_gi.T @ (slope @ states[among])
        spread = (self.filter.walk**2 * elapsed + self.filter.density[0]**2 * elapsed**3 / 3.0
                  + (self.filter.gap_acceleration * gap_turn[rows, None, None])**2)
        return AttitudeTrack(samples.stamp_ns, C_gi[rows],
                             root @ np.swapaxes(root, -1, -2) + spread * np.eye(3),
                             (samples.rate - estimate.bias) @ gain.T)

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
