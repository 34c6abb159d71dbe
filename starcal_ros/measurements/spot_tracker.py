# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Follows star spots from frame to frame without knowing which stars they are.

Each frame, from the directions in which the nominal camera sees its spots:

1. The tracks are turned by the rotation expected since the frame before: that of the gyro, where
   it has reached the frame, or else the last one seen, carried on at a constant rate.
2. Every track and every spot within `WIDE` of it propose a shift; the shift with the most others
   near it wins. So the first step, a sudden slew and a focal length that is 10 % wrong are
   followed without being known. The rotation that best fits its proposers (Wahba's problem)
   corrects the expected one.
3. A track and a spot that have each other, and nothing else, within the gate are one star. What
   is ambiguous is left alone.

A track that finds no spot is carried on for `PATIENCE` frames. A spot without a track begins one;
that of a false spot ends soon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.config.models import detector, intrinsics, mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import DEG, DEG_PER_HOUR, NS
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.star_directions import StarDirections

WIDE = 1.5 * DEG
"""A spot may be this far from where it is expected: what a slew may turn between two frames."""
PATIENCE = 3
"""Frames for which a track lives without a spot."""

_GATE_PX = 3.0          # gate, at least
_GATE_SIGMAS = 8.0      # of the nominal centroid noise, for noise larger than that
_LEAST = 3              # tracks that must agree on a shift, and a quarter of those there are


class Followed(NamedTuple):
    """What became of the spots of some frames.

    Attributes
    ----------
    track : (n_spots,) int64 array
        Number of the track, the same for the same star; -1 where that is uncertain.
    turn : (n_frames, 3, 3) array
        C_s1s0 from the frame before, in the nominal camera; as expected where nothing was
        recognised.
    """

    track: Ints
    turn: Array


class SpotTracker:
    """The tracks of one star tracker.

    Parameters
    ----------
    scenario : Scenario
        Nominal camera, mounting, gyro and noise of a centroid.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._directions = StarDirections(scenario)
        self._intrinsics = intrinsics(scenario.camera)
        self._pitch_mm = detector(scenario.camera).pitch_mm
        gate = max(_GATE_PX, _GATE_SIGMAS * scenario.star_tracker.centroid_sigma_px)
        self._gate = gate * self._pitch_mm / scenario.camera.focal_length_mm
        self._C_sg = mounting_matrix(scenario.mounting)
        self._bias = np.array(scenario.gyro.bias_deg_h) * DEG_PER_HOUR
        self._period_ns = 1e9 / scenario.gyro.rate_hz
        self._last_ns = 0
        self._turn, self._dt = np.eye(3), 1.0           # the last one seen, and its time [s]
        self._w: Array = np.empty((0, 3))               # the tracks: direction at the last frame,
        self._number = np.empty(0, np.int64)            # number,
        self._missed: Ints = np.empty(0, np.int64)     # frames without a spot
        self._next = 0

    def follow(self, frames: Frames, gyro: GyroSamples | None = None) -> Followed:
        """Follow the spots through the next frames.

        Parameters
        ----------
        frames : Frames
            With increasing stamps, later than those before.
        gyro : GyroSamples, optional
            Readings up to the last of the frames or later; where they are missing the motion
            seen is carried on.
        """
        if not len(frames):
            return Followed(np.empty(0, np.int64), np.empty((0, 3, 3)))
        uv, _, measured = self._directions.centroids(frames)
        w_s = camera.unproject(np.where(measured[:, None], uv, 0.0), self._intrinsics,
                               self._pitch_mm)
        begin_ns = [self._last_ns] if len(self._number) else frames.stamp_ns[:1]
        cuts = np.concatenate((begin_ns, frames.stamp_ns))
        known, expected = self._turns(gyro, cuts)
        track = np.full(len(uv), -1)
        turn = np.empty((len(frames), 3, 3))
        for k, dt in enumerate((np.diff(cuts) * NS).tolist()):
            spots = np.arange(frames.first[k], frames.first[k + 1])
            spots = spots[measured[spots]]
            guess = expected[k] if known[k] else self._carried_on(dt)
            track[spots], turn[k] = self._step(w_s[spots], guess)
            if dt > 0.0:
                self._turn, self._dt = turn[k], dt
            self._last_ns = int(frames.stamp_ns[k])
        return Followed(track, turn)

    def _carried_on(self, dt: float) -> Array:
        """Return the turn in dt [s] at the rate of the last one."""
        if abs(dt - self._dt) < 1e-3 * dt:
            return self._turn
        return rotation.exp(rotation.log(self._turn) * (dt / self._dt))

    def _turns(self, gyro: GyroSamples | None, cuts_ns: Ints
               ) -> tuple[Mask, Array]:
        """Return where the gyro knows C_s1s0 between the stamps, and what it is, (n, 3, 3)."""
        if gyro is None:
            return np.zeros(len(cuts_ns) - 1, np.bool_), np.empty((len(cuts_ns) - 1, 0))
        turned = preintegration.preintegrate(gyro, cuts_ns, self._bias, self._period_ns)
        return turned.gap_turn == 0.0, self._C_sg @ turned.Delta @ self._C_sg.T

    def _step(self, w_s: Array, turn: Array) -> tuple[Ints, Array]:
        """Return the track of each spot of one frame, and the turn that they show."""
        carried = self._w @ turn.T
        shown = _correction(carried, w_s, 2.0 * self._gate)
        found: Ints = np.empty((0, 2), np.int64)
        taken: Mask = np.zeros(len(w_s), np.bool_)
        if shown is not None:
            turn, carried = shown @ turn, carried @ shown.T
            near = _apart(carried, w_s) < self._gate**2
            taken |= near.any(axis=0)
            sure = near & (near.sum(axis=0) == 1) & (near.sum(axis=1) == 1)[:, None]
            found = np.argwhere(sure)
        track = np.full(len(w_s), -1)
        track[found[:, 1]] = self._number[found[:, 0]]
        carried[found[:, 0]] = w_s[found[:, 1]]
        self._missed += 1
        self._missed[found[:, 0]] = 0
        new = np.flatnonzero(~taken)
        track[new] = np.arange(self._next, self._next + len(new))
        self._next += len(new)
        alive = self._missed <= PATIENCE
        self._w = np.concatenate((carried[alive], w_s[new]))
        self._number = np.concatenate((self._number[alive], track[new]))
        self._missed = np.concatenate((self._missed[alive], np.zeros(len(new), np.int64)))
        return track, turn


def _correction(carried: Array, w_s: Array, alike: float) -> Array | None:
    """Return the rotation that takes most of the tracks to spots, None where few agree.

    Parameters
    ----------
    carried : (n, 3) array
        Where the tracks are expected.
    w_s : (m, 3) array
        Where spots are.
    alike : float
        Shifts that differ less than this agree [rad].
    """
    track, spot = np.nonzero(_apart(carried, w_s) < WIDE**2)
    needed = max(_LEAST, min(len(carried), len(w_s)) // 4)
    if len(track) < needed:
        return None
    shift = w_s[spot] - carried[track]
    agree = _apart(shift, shift) < alike**2
    votes = agree.sum(axis=0)
    best = np.argmax(votes)
    if votes[best] < needed:
        return None
    chosen = agree[best]
    return rotation.wahba(w_s[spot[chosen]].T @ carried[track[chosen]])


def _apart(a: Array, b: Array) -> Array:
    """Return the squared distance of each of a (n, 3) from each of b (m, 3), (n, m)."""
    return (np.einsum('ni,ni->n', a, a)[:, None] + np.einsum('mi,mi->m', b, b)
            - 2.0 * a @ b.T)
