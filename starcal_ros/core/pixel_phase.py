# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The error of a centroid that depends on where in its pixel a star falls.

Model
-----
A method that takes its pixels for points draws a centroid towards their middle or their edge. Its
first harmonic, along each axis on its own ("S-curve"; Samaan et al., AAS 02-155, 2002) ::

    u_m = u + a sin 2 pi u + b cos 2 pi u,      v_m likewise                           (P.1)

in raster pixels. Where u is known with an error of its own, of the standard deviation sigma, the
mean of the sine over what u may be is ``g sin 2 pi u``, g = exp(-2 (pi sigma)^2).
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array

NAMES = ('su', 'cu', 'sv', 'cv')
"""Amplitudes of sine and cosine along u, and along v."""


def waves(uv_raster: Array, sigma: Array | float = 0.0) -> Array:
    """Return the derivatives of displacements by the four amplitudes, (..., n, 2, 4).

    Parameters
    ----------
    uv_raster : (..., n, 2) array
        Places, (0, 0) the centre of the top-left pixel [px].
    sigma : (..., n) array or float
        Standard deviation of each axis of these places [px].
    """
    out = np.zeros((*uv_raster.shape, 4))
    blurred = np.exp(-2.0 * (np.pi * np.asarray(sigma))**2)
    angle = 2.0 * np.pi * uv_raster
    for axis in range(2):
        out[..., axis, 2 * axis] = blurred * np.sin(angle[..., axis])
        out[..., axis, 2 * axis + 1] = blurred * np.cos(angle[..., axis])
    return out
