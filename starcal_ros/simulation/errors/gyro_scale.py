# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Scale factor errors and misalignment of the gyro triad.

Model
-----
::

    omega_m = (I + M) omega + ...,    M = [[s_x  xy  xz]
                                           [yx  s_y  yz]                       (G.2)
                                           [zx  zy  s_z]]

    s_x s_y s_z              1      scale factor errors
    xy xz yx yz zx zy        rad    xy: what the x gyro sees of a rate about the y axis

First order, as the errors in I + M of an inertial instrument are usually stated. A common turn of
the three axes (xy = -yx and so on) is a misalignment here, not a part of the mounting.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.config.truth import TrueGyroConfig
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC

_PPM = 1e-6


def scale_error(gyro: TrueGyroConfig) -> Array:
    """Return M, (3, 3)."""
    M = np.diag(gyro.scale_factor_ppm) * _PPM
    M[~np.eye(3, dtype=bool)] = np.array(gyro.misalignment_arcsec) * ARCSEC
    return M
