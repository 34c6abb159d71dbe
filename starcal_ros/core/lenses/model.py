# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a lens model is."""

from __future__ import annotations

from typing import Protocol

from starcal_ros.core.arrays import Array, Mask


class LensModel(Protocol):
    """A camera model: where on the detector a direction falls, and back.

    Its values are one array (..., p), in the order of `parameters`: ``u0, v0`` of the principal
    point [px from the centre of the detector], the focal length ``f``, then what is its own.
    Directions are in s of T18 Fig. 1; leading axes are batch axes.
    """

    @property
    def name(self) -> str:
        """What it is chosen by."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its values."""

    @property
    def powers(self) -> tuple[int, ...]:
        """Power of the distance from the axis that each value acts by, over the place itself."""

    @property
    def scale(self) -> Array:
        """What arithmetic divides the values by, (p,), so that it meets numbers of like size."""

    def project(self, r_s: Array, values: Array) -> Array:
        """Return the centroids (..., n, 2) [px] of directions r_s (..., n, 3)."""

    def unproject(self, uv: Array, values: Array) -> Array:
        """Return the unit directions r_s (..., n, 3) of centroids uv (..., n, 2) [px]."""

    def linearize(self, r_s: Array, values: Array) -> tuple[Array, Array, Array]:
        """Return centroids (..., n, 2) and their derivatives.

        Those by a rotation Psi, r_s -> (I + [Psi x]) r_s, are (..., n, 2, 3) [px/rad], those by
        the values (..., n, 2, p).
        """

    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions (..., 3) the model is made for, whatever its values."""
