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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from starcal_ros.config.parameter import Spec
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import ARCSEC

GROUP = 'gyro'
ORDER = 10
ON = {'scale 100 ppm': {'scale_factor_ppm': (100.0, 100.0, 100.0)},
      'misaligned 20"': {'misalignment_arcsec': (20.0,) * 6}}

_PPM = 1e-6

Floats = tuple[float, ...]


@dataclass(frozen=True)
class Config:
    """The elements of M."""

    scale_factor_ppm: Annotated[Floats, Spec(
        'Scale factor error of the x, y, z gyro (gyro_scale)', 'ppm', -1e5, 1e5, 3)
    ] = (0.0, 0.0, 0.0)
    misalignment_arcsec: Annotated[Floats, Spec(
        'Misalignment xy, xz, yx, yz, zx, zy, where xy is what the x gyro sees of a rate about y '
        '(gyro_scale)', 'arcsec', -2e4, 2e4, 6)] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def rate(scenario: Scenario) -> Callable[[Ints, Array], Array] | None:
    """Return the function that puts M on the rates, or None where M is zero."""
    M = matrix(scenario)
    if not M.any():
        return None
    return lambda _, omega: omega + (M @ omega[..., None])[..., 0]


def matrix(scenario: Scenario) -> Array:
    """Return M, (3, 3)."""
    gyro = scenario.truth.of(Config)
    M = np.diag(gyro.scale_factor_ppm) * _PPM
    M[~np.eye(3, dtype=bool)] = np.array(gyro.misalignment_arcsec) * ARCSEC
    return M
