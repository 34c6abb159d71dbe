# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Optional state: the pixel phase, how centroids depend on where in a pixel a star falls.

Eq. (P.1) of `core.pixel_phase`, at the predicted place of each star: the measured one has noise in
it that the wave makes part of itself, which draws the amplitudes by a tenth. As long as a
prediction is not good to a part of a pixel its stars tell nothing of them. What a move of the
predicted place does to the wave is neglected: 2 pi of the amplitude times the move.
"""

from __future__ import annotations

from starcal_ros.core import pixel_phase
from starcal_ros.core.arrays import Array
from starcal_ros.filter.optional_state import OptionalState


class PixelPhase(OptionalState):
    """Amplitudes of sine and cosine along u and v, four numbers [px]."""

    key = 'pixel_phase_sigma_px'
    names = tuple(f'phase_{name}_px' for name in pixel_phase.NAMES)
    scale = 1e-3

    def displaced(self, uv_raster: Array, sigma: Array) -> Array:
        """Return the waves of each star."""
        return pixel_phase.waves(uv_raster, sigma)
