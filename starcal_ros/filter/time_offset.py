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

The noise n of that reading is in the turn up to the frame as well, so that on average it draws tau
along, with ``E[n theta'] = -q^2`` (`hypotheses.drawn`): of a score ``-(A omega_s)' S^-1 z`` by ::

    b = q^2 tr(A' S^-1 A)                                                              (A.6)
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.filter.optional_state import Looked, OptionalState


class TimeOffset(OptionalState):
    """tau, one number [s]."""

    key = 'time_offset_sigma_s'
    names = ('tau_s',)

    def looked(self, values: Array, C_sg: Array, rate_g: Array) -> Looked:
        """Return how far the star tracker turns in tau, and its rate (A.4)."""
        omega_s = (C_sg @ rate_g[..., None])[..., 0]
        return Looked(rotation.exp(-values * omega_s), -omega_s[..., None])

    def drawn(self, N: Array, noise: Array) -> Array:
        """Return b of (A.6)."""
        return noise[..., 0, None] * np.trace(N, axis1=-2, axis2=-1)[..., None]
