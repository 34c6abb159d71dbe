# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a frame is expected to be: predicted centroids, their derivatives, their trails.

Centroids depend on the errors of `error_state` as T18 Eq. 23 and 24 say.

While an exposure T lasts a star trails over the detector, with the rate omega_s of the camera at
the stamp over ``l = H_s omega_s T``. Its photons spread by that beside the spot's own sigma s, so
that the noise of a centroid grows along the trail (`simulation.errors.smear`) ::

    w ~ N(0, sigma^2 (I + l l' / (12 s^2)))                                            (E.2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.filter import arithmetic, reference
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.curvature import Curvature
from starcal_ros.filter.optional_state import OptionalState
from starcal_ros.filter.reference import times
from starcal_ros.filter.states import SCALE, THETA
from starcal_ros.measurements.samples import Stars


@dataclass(frozen=True)
class MeasurementModel:
    """The model of a frame.

    Attributes
    ----------
    detector : Detector
    cos_field : float
        Cosine of the angle from the boresight up to which a star may be predicted.
    trail_s : float
        T / (s sqrt(12)) of Eq. (E.2) [s/px]; zero where stars are taken not to trail.
    curvature : Curvature
        What the linear model leaves out.
    """

    detector: Detector
    cos_field: float
    trail_s: float
    curvature: Curvature

    @property
    def trails(self) -> bool:
        """Whether stars are taken to trail while the camera turns."""
        return self.trail_s > 0.0

    def predict(self, nominal: Nominal, u_i: Array) -> tuple[Array, Array, Mask]:
        """Return the predicted centroids and their derivatives by the states (T18 Eq. 24).

        Parameters
        ----------
        nominal : Nominal
            Values to predict from.
        u_i : (..., n, 3) array
            Apparent places.

        Returns
        -------
        uv : (..., n, 2) array
            Predicted centroids, without what optional states displace measured ones by [px].
        H : (..., n, 2, 16 + m) array
            d uv / d error, its attitude part theta.
        in_view : (..., n) bool array
            False for a star that lies well outside the field of view; its row means nothing.
        """
        return reference.predict(*self.seen(nominal), nominal.intrinsics, u_i,
                                 self.detector.pitch_mm, self.cos_field)

    def whitened(self, nominal: Nominal, H: Array, z: Array) -> tuple[Array, Array]:
        """Return derivatives and residuals of centroids in which their noise has no direction.

        Parameters
        ----------
        nominal : Nominal
            Values, with the reading at the stamp.
        H : (..., n, 2, 16 + m) array
            From `predict`.
        z : (..., n, 2) array
            Of the centroids [px].

        Returns
        -------
        H, z : arrays
            See `reference.whitened`.
        """
        if not self.trails:
            return H, z
        return reference.whitened(H, z, self.trail(nominal, H[..., THETA]))

    def trail(self, nominal: Nominal, H_s: Array) -> Array:
        """Return l / (s sqrt(12)), (..., n, 2), of Eq. (E.2), from H_s (..., n, 2, 3)."""
        return times(H_s, self.turn_of_exposure(nominal)[..., None, :])

    def turn_of_exposure(self, nominal: Nominal) -> Array:
        """Return omega_s T / (s sqrt(12)), (..., 3), of Eq. (E.2) [rad/px]."""
        rate_g = nominal.reading - nominal.bias
        if nominal.augmentation.on:
            rate_g = times(nominal.augmentation.gain(nominal.augmented), rate_g)
        return times(nominal.C_sg, rate_g) * self.trail_s

    @staticmethod
    def seen(nominal: Nominal) -> tuple[Array, Array, Array]:
        """Return the C_si of a frame, what the optional states turn it by, and their slopes."""
        size = nominal.augmentation.size
        slopes = np.zeros((*nominal.C_gi.shape[:-2], 3, size))
        shift: Array = np.eye(3)
        if size:
            for state, place, _ in nominal.augmentation.errors():
                looked = state.looked(nominal.augmented[..., place], nominal.C_sg,
                                      nominal.steady)
                if looked is not None:
                    slopes[..., place] = shift @ looked.slope
                    shift = shift @ looked.C
        return shift @ nominal.C_si, shift, slopes

    def displaced(self, belief: Belief, stars: Stars) -> Array:
        """Return how measured centroids depend on the optional states, (..., n, 2, m)."""
        among = belief.nominal.augmentation
        direct = np.zeros((*stars.uv.shape, among.size))
        displacing = [(state, place) for state, place, _ in among.errors()
                      if type(state).displaced is not OptionalState.displaced]
        if not displacing:
            return direct
        uv, H, in_view = self.predict(belief.nominal, stars.u_i)
        uv = uv - times(H, belief.error[..., None, :])
        spread = (H * among.scale) @ belief.root[..., None, :, :]
        sigma = np.where(in_view, np.sqrt(0.5 * np.sum(spread**2, axis=(-2, -1))), np.inf)
        for state, place in displacing:
            direct[..., place] = state.displaced(uv + self.detector.centre_raster, sigma)
        return direct

    def left_out(self, belief: Belief, stars: Stars, C_si: Array, nothing: Array) -> Array:
        """Return what the linear model leaves out of each centroid, (..., n); most often nothing.

        Parameters
        ----------
        belief : Belief
            Before the frame.
        stars : Stars
        C_si : (..., 3, 3) array
            From `seen`.
        nothing : (..., n) array
            What is returned where nothing is left out.
        """
        nominal, curvature = belief.nominal, self.curvature
        runs = arithmetic.LeadingAxes(belief.error.shape[:-1])
        if not arithmetic.bends(
                runs(C_si, 2), runs(stars.u_i, 2), runs(stars.sigma, 1), runs(belief.error, 1),
                runs(belief.root, 2), runs(nominal.intrinsics, 1), curvature.shift,
                curvature.second, curvature.largest, self.detector.pitch_mm, self.cos_field):
            return nothing
        r_s = stars.u_i @ np.swapaxes(C_si, -1, -2)
        in_view = reference.in_view(r_s, self.cos_field)
        usable = in_view & ~np.any(belief.error != 0.0, axis=-1, keepdims=True)
        return curvature.left_out(
            np.where(in_view[..., None], r_s, (0.0, 0.0, 1.0)), nominal.intrinsics,
            belief.root[..., reference.SEEN, :] * SCALE[reference.SEEN, None],
            np.where(usable, stars.sigma, np.inf))
