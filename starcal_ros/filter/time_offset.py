# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Optional state: the time offset of the star tracker.

Model
-----
A frame stamped t shows the sky of t + tau; tau is positive where frames are stamped early. With
the rate omega_s, in s, of the gyro at the frame's stamp ::

    r_s = exp(-[omega_s tau x]) C_sg C_gi r_i,    d r_s / d tau = -omega_s x r_s       (A.4)

The rate is taken as constant over tau: at an angular acceleration alpha that misses
alpha tau^2 / 2, 0.4 arcsec for 0.5 deg/s^2 and 20 ms. The derivatives of omega_s by b, Psi and M
are neglected: each is the part omega tau, 1e-4 for 0.5 deg/s and 10 ms, of what the same state
does over an interval.

The rate is one in which noise does not show (`rate_noise.steady`), most often the mean over the
interval since the frame before. What noise n it has left is in the turn up to the frame as well,
and in the prediction by ``-n tau``. On average it adds b to the score ``-(A omega_s)' S^-1 z``,
and information that is none (`rate_noise`) ::

    b = -q^2 tr(A' S^-1 A U) + I tau,      I = q^2 tr(A' S^-1 A G)                     (A.6)
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.filter.hypotheses import TIME
from starcal_ros.filter.optional_state import Drawn, Looked, OptionalState
from starcal_ros.filter.rate_noise import NoiseMoments


class TimeOffset(OptionalState):
    """tau, one number [s]."""

    key = 'time_offset_sigma_s'
    names = ('tau_s',)
    effects = (TIME,)

    def looked(self, values: Array, C_sg: Array, rate_g: Array) -> Looked:
        """Return how far the star tracker turns in tau, and its rate (A.4)."""
        omega_s = (C_sg @ rate_g[..., None])[..., 0]
        return Looked(rotation.exp(-values * omega_s), -omega_s[..., None])

    def drawn(self, N: Array, T: Array, moments: NoiseMoments, values: Array) -> Drawn:
        """Return b and I of (A.6)."""
        along, none = (np.trace(N @ moment, axis1=-2, axis2=-1)[..., None]
                       for moment in (moments.turned, moments.noise))
        return Drawn(none * values - along, none)
