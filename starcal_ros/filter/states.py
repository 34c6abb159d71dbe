# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The 16 states: their places, names, units and scales."""

from __future__ import annotations

import numpy as np

from starcal_ros.core import camera
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR

PHI, EPSILON, PSI, LENS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 16)
THETA = PHI                                     # the same three places inside the filter
N_STATES = 16
CALIBRATED = slice(3, 16)                       # all but the attitude
STATE_NAMES = ('phi_x', 'phi_y', 'phi_z', 'epsilon_x', 'epsilon_y', 'epsilon_z',
               'psi_x', 'psi_y', 'psi_z', *camera.INTRINSICS)
STATE_UNITS = (*('arcsec',) * 3, *('deg/h',) * 3, *('arcsec',) * 3, 'px', 'px', 'mm', 'mm^-2',
               'mm^-4', 'mm^-1', 'mm^-1')
UNIT = np.array([*(ARCSEC,) * 3, *(DEG_PER_HOUR,) * 3, *(ARCSEC,) * 3, *(1.0,) * 7])
"""One human unit (STATE_UNITS) of each state, in the unit that the filter counts in."""
SCALE = np.array([*(1e-5,) * 3, *(1e-8,) * 3, *(1e-5,) * 3, *camera.INTRINSICS_SCALE])
"""What the filter divides each state by, so that its roots hold numbers of like size."""
