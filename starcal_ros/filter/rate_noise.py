# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The rate at a frame without what may be noise of the gyro, and what the noise left in it does.

What goes with the rate, a time offset or a scale factor, is regressed on what the gyro read. Its
noise n is in the turn up to the frame as well, so that the score of such an effect has a mean, and
information in it is feigned (errors in the variables): for a coarse gyro the first draws the
estimate away and the second holds it where it is, by more sigmas the longer the run. `steady`
gives a rate in which noise hardly shows; what is left of it `NoiseMoments` follows.

Model
-----
Let e be the error of the turn before a frame, ``z = A e + ...`` its innovation, n the noise of the
mean rate over the interval T, E what earlier noise has left in the response to the state, and
``F = P+ P^-1`` the part of a turn that a frame leaves, of its covariances after and before. With q
the angular random walk, ``E[n e'] = -q^2`` in s. In units of q^2, U_0 and G_0 after the frame
before ::

    U = E[(n + E) e']       = U_0 - 1,         U_0 <- (U_0 - (I - F) U) F'
    G = E[(n + E)(n + E)']  = G_0 + 1 / T,     G_0 <- F G_0 F' + (I - F)(I - F)' / T   (N.1)

The score of a state along the rate has the mean ``q^2 tr(N U)``, ``N = A' S^-1 A``, and
``q^2 tr(N G)`` is the information that noise feigns. T18's gyros make nothing of it: q^2 is small
beside their rates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Mask
from starcal_ros.measurements.preintegration import Preintegrated

_BEYOND = 4.0           # sigmas of an axis that noise does not reach: 1e-3 of the time


class NoiseMoments(NamedTuple):
    """U and G, (..., 3, 3) each, or those after a frame: (N.1)."""

    turned: Array
    noise: Array

    def before(self, goes: Mask, T: Array) -> NoiseMoments:
        """Return those before a frame, at the end of an interval.

        Parameters
        ----------
        goes : (...) bool array
            Whether there is a rate along which a score is taken.
        T : (...) array
            Length of the interval [s].
        """
        one, rate = np.eye(3), np.where(goes, 1.0, 0.0)
        return NoiseMoments(self.turned - one * rate[..., None, None],
                            self.noise + one * (rate / np.maximum(T, 1e-9))[..., None, None])

    def after(self, before: NoiseMoments, F: Array) -> NoiseMoments:
        """Return those after a frame that leaves F, (..., 3, 3), of a turn as it was."""
        K, F_T = np.eye(3) - F, np.swapaxes(F, -1, -2)
        fresh = before.noise - self.noise
        return NoiseMoments((self.turned - K @ before.turned) @ F_T,
                            F @ self.noise @ F_T + K @ fresh @ np.swapaxes(K, -1, -2))


def steady(gyro: Preintegrated, bias: Array, gain: Array, walk: float) -> Array:
    """Return the rate of g at the end of an interval, (..., 3) [rad/s].

    It is the mean over the interval where that is beyond noise, and the last reading in its place
    where it differs by more than noise does: a turn begins, or an acceleration. Else it is zero.

    Parameters
    ----------
    gyro : Preintegrated
    bias : (..., 3) array
        Present bias [rad/s].
    gain : (..., 3, 3) array
        The rate of g is ``gain @ (reading - bias)``.
    walk : float
        Angular random walk [rad/sqrt(s)].
    """
    variance = walk**2 / np.maximum(gyro.duration, 1e-9), walk**2 / gyro.covered
    parts = gyro.mean - bias, gyro.reading - gyro.mean
    mean, beside = (_beyond((gain @ part[..., None])[..., 0], noise)
                    for part, noise in zip(parts, variance))
    return mean + beside


def _beyond(rate: Array, variance: Array) -> Array:
    """Return what of a rate (..., 3) is beyond noise of a variance (...) of each axis."""
    square = np.sum(rate**2, axis=-1)
    part = 1.0 - _BEYOND**2 * variance / np.maximum(square, 1e-300)
    return rate * np.maximum(part, 0.0)[..., None]
