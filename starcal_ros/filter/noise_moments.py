# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How the noise of the gyro that tells a rate goes together with the errors of the attitude.

What goes with the rate, a time offset or a scale factor, is regressed on what the gyro read. Its
noise n is in the turn up to the frame as well, so that the score of such an effect has a mean, and
information in it is feigned (errors in the variables): for a coarse gyro the first draws the
estimate away and the second holds it where it is, by more sigmas the longer the run.

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
