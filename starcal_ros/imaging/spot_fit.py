# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Places of spots by least squares: the spot of a star, integrated over pixels, fitted to each.

Model
-----
Counts about a spot, less the background, and their variance ::

    d = F m(u, v, s^2) + b + noise,    V = noise^2 + F m / gain                     (C.1)

    m       part of the star's light in a pixel (`starcal_ros.spot`), the trail that of the frame
    s^2     px^2           variance of the spot, near that of the frame: lenses are not all even
    F, b    counts         light of the star, what is left of the background
    gain    electrons a count

(u, v, F, b) of all spots at once by Gauss and Newton, weights 1 / V from the fit, not from the
data, whose noise would bias them. The covariance is the inverse of J' V^-1 J: where the model
holds, it is the Cramer-Rao bound, so the estimator is as good as any.

What the shape of a spot differs from the frame's is one more such step, with columns for its
second moments: by the heat equation, the derivative by the variance of a Gaussian is half of
the second derivative by its place                                                  (C.2)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros import spot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST_PIXELS = 9               # that a fit needs
_LEAST_SIGMA = 0.3              # px, of a spot
_FARTHEST_PX = 1.5              # from the middle of the stamp, where a fit may end
_WIDTH_PART = 0.3               # of the frame's variance, what a star's differs by, 1 sigma
_TINY = 1e-30
_ROUND = 0.15                   # second moments along and across differ less: no trail


class Shape(NamedTuple):
    """What the spots of a frame look like: sigma of a spot at rest, and its trail (2,) [px]."""

    sigma: float
    trail: Array

    @classmethod
    def of_moments(cls, moments: Array) -> Shape:
        """Return the shape with second moments (2, 2) of its light [px^2]."""
        (across, along), axes = np.linalg.eigh(moments)
        if along < (1.0 + _ROUND) * across:
            return cls(max(np.sqrt((across + along) / 2.0), _LEAST_SIGMA), np.zeros(2))
        return cls(max(np.sqrt(across), _LEAST_SIGMA),
                   np.sqrt(12.0 * (along - across)) * axes[:, 1])

    def after(self, found: Fit) -> Shape:
        """Return the shape that spots fitted with this one have in common."""
        if not self.trail.any():
            return Shape.of_moments(self.moments + np.median(found.moments[found.good], axis=0))
        return Shape(max(np.sqrt(np.median(found.width[found.good])), _LEAST_SIGMA),
                     self.trail + np.median(found.trail[found.good], axis=0))

    @property
    def moments(self) -> Array:
        """Second moments (2, 2) of the light [px^2]."""
        return self.sigma**2 * np.eye(2) + np.outer(self.trail, self.trail) / 12.0

    @property
    def half(self) -> int:
        """Pixels on each side of the middle one that hold nearly all of the light."""
        return int(np.ceil(2.5 * self.sigma + np.abs(self.trail).max() / 2.0 + 0.5))


class Stamps(NamedTuple):
    """Square cuttings of an image about n spots.

    Attributes
    ----------
    middle : (n, 2) int64 array
        Column and row of the middle pixel.
    counts : (n, k, k) array
        Counts over the background, rows first.
    valid : (n, k, k) bool array
        Pixels of the image that are not saturated.
    noise : (n,) array
        Standard deviation of a pixel without stars [counts].
    saturated, cut : (n,) bool array
        Stamps with a saturated pixel, and those that reach out of the image.
    """

    middle: NDArray[np.int64]
    counts: Array
    valid: Mask
    noise: Array
    saturated: Mask
    cut: Mask

    @classmethod
    def of(cls, counts: NDArray[np.float32], saturated: Mask, noise: NDArray[np.float32],
           uv_raster: Array, half: int) -> Stamps:
        """Cut an image about some places, `half` pixels on each side of the nearest one."""
        middle = np.rint(uv_raster).astype(np.int64)
        reach = np.arange(-half, half + 1)
        u, v = middle[:, 0, None] + reach, middle[:, 1, None] + reach
        height, width = counts.shape
        inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
        at = np.clip(v, 0, height - 1)[:, :, None], np.clip(u, 0, width - 1)[:, None, :]
        full = saturated[at] & inside
        return cls(middle, counts[at].astype(float), inside & ~full,
                   noise[middle[:, 1], middle[:, 0]].astype(float), full.any(axis=(1, 2)),
                   ~inside.all(axis=(1, 2)))

    def take(self, rows: NDArray[np.int64]) -> Stamps:
        """Return some of the stamps."""
        return Stamps(self.middle[rows], self.counts[rows], self.valid[rows], self.noise[rows],
                      self.saturated[rows], self.cut[rows])


class Fit(NamedTuple):
    """Fitted spots.

    Attributes
    ----------
    offset : (n, 2) array
        Place from the middle of the stamp [px].
    covariance : (n, 2, 2) array
        Of the place [px^2].
    flux : (n,) array
        Light of the star [counts].
    width : (n,) array
        Variance of the spot at rest [px^2].
    trail : (n, 2) array
        Trail less the frame's, where that has one [px].
    moments, moments_sigma : (n, 2, 2), (n,) array
        Second moments less the frame's, and their standard deviation from noise alone [px^2].
    shot : (n,) array
        Variance of the pixels beyond the noise, a count of light: 1 / gain, measured [counts].
    good : (n,) bool array
        The fit came to an end near the middle of the stamp.
    """

    offset: Array
    covariance: Array
    flux: Array
    width: Array
    trail: Array
    moments: Array
    moments_sigma: Array
    shot: Array
    good: Mask


def fit(stamps: Stamps, offset: Array, shape: Shape, gain: float, photons: bool,
        iterations: int = 4) -> Fit:
    """Return the spots of a shape that fit the stamps best, Eq. (C.1).

    Parameters
    ----------
    stamps : Stamps
        Cuttings, k = 2 `shape.half` + 1.
    offset : (n, 2) array
        Where to begin, from the middle of each stamp [px].
    shape : Shape
        The frame's.
    gain : float
        Electrons a count.
    photons : bool
        Weigh pixels by V, and not evenly.
    iterations : int
        Of Gauss and Newton.
    """
    spots = _Spots(stamps, shape, offset, np.zeros(len(offset)), np.zeros(len(offset)),
                   np.full(len(offset), shape.sigma**2))
    # Light and background first, at the place given; then all, with weights that follow.
    terms = spots.terms(gain, photons)
    spots = spots.moved(_solve(terms.columns[..., :2], terms.residual, terms.weight)[0])
    for _ in range(iterations):
        terms = spots.terms(gain, photons)
        spots = spots.moved(_solve(terms.columns, terms.residual, terms.weight)[0])
    terms = spots.terms(gain, photons)
    _, inverse = _solve(terms.columns, terms.residual, terms.weight)
    # The weights need not be 1 / V: the covariance of any weighted fit.
    part = (inverse @ np.swapaxes(terms.columns * terms.weight[..., None], -1, -2))
    covariance = (part * terms.variance[:, None, :]) @ np.swapaxes(part, -1, -2)

    # A residual has the variance V (1 - h), h what its pixel takes part in its own fit.
    pixel = slice(None, -1)
    valid, square = terms.weight[:, pixel] > 0.0, terms.residual[:, pixel]**2
    free = valid * np.maximum(1.0 - np.einsum('npi,nip->np', terms.columns, part)[:, pixel], 0.0)
    light = free * terms.light
    shot = (np.sum(valid * square - free * stamps.noise[:, None]**2, axis=1)
            / np.maximum(light.sum(axis=1), 1.0))
    # A shape that is not quite the star's scatters more than the noise: then that is the noise.
    freedom = np.maximum(free.sum(axis=1), 1.0)
    excess = np.sum(valid * square / terms.variance[:, pixel], axis=1) / freedom
    excess = np.where(excess > 1.0 + 3.0 * np.sqrt(2.0 / freedom), excess, 1.0)

    residual, weight = terms.residual[:, pixel], terms.weight[:, pixel]
    trail = np.zeros_like(offset)
    if shape.trail.any():
        trail = _solve(np.concatenate((terms.columns[:, pixel], terms.trail_columns), axis=-1),
                       residual, weight)[0][:, 5:]
    step, wide = _solve(terms.shape_columns, residual, weight)
    moments = (np.stack((step[:, 4], step[:, 5], step[:, 5], step[:, 6]), -1).reshape(-1, 2, 2)
               + (spots.width - shape.sigma**2)[:, None, None] * np.eye(2))
    spread = np.sqrt((wide[:, 4, 4] + wide[:, 6, 6]) / 2.0)
    good = ((valid.sum(axis=1) >= _LEAST_PIXELS) & (spots.flux > 0.0)
            & (np.abs(spots.offset) <= _FARTHEST_PX).all(axis=1))
    return Fit(spots.offset, excess[:, None, None] * covariance[:, 2:4, 2:4], spots.flux,
               spots.width, trail, moments, spread, shot, good)


class _Terms(NamedTuple):
    """One step of Gauss and Newton: pixels, and one more row that holds the width to the frame's.

    `columns` are the derivatives by light, background, u, v and width; `shape_columns`, without
    the last row, have the three second moments in place of the width, `trail_columns` are those
    by the trail alone.
    """

    columns: Array
    residual: Array
    weight: Array
    variance: Array
    light: Array
    shape_columns: Array
    trail_columns: Array


class _Spots(NamedTuple):
    """Spots on their stamps, and what they are believed to be."""

    stamps: Stamps
    shape: Shape
    offset: Array
    flux: Array
    base: Array
    width: Array

    def moved(self, step: Array) -> _Spots:
        """Return the spots after a step (n, 2 or 5), which is kept within bounds."""
        flux, base = self.flux + step[:, 0], self.base + step[:, 1]
        if step.shape[1] == 2:
            return self._replace(flux=flux, base=base)
        width = np.clip(self.width + step[:, 4], 0.5 * self.width, 2.0 * self.width)
        return self._replace(flux=flux, base=base, width=width,
                             offset=self.offset + np.clip(step[:, 2:4], -1.0, 1.0))

    def terms(self, gain: float, photons: bool) -> _Terms:
        """Return the terms of the next step."""
        stamps, n = self.stamps, len(self.flux)
        image = _images(self.offset, self.shape.trail, np.sqrt(self.width),
                        stamps.counts.shape[1] // 2)
        flux = self.flux[:, None]
        light = np.maximum(flux * image.m, 0.0)
        even = np.broadcast_to(stamps.noise[:, None]**2, light.shape)
        variance = even + light / gain
        weight = stamps.valid.reshape(n, -1) / (variance if photons else even)
        one, uu, vv = np.ones_like(light), flux * image.m_uu / 2.0, flux * image.m_vv / 2.0
        common = [image.m, one, flux * image.m_u, flux * image.m_v]
        hold = np.zeros((n, 1, 5))
        hold[..., 4] = 1.0
        frame = self.shape.sigma**2
        loose = np.full((n, 1), (_WIDTH_PART * frame)**2)
        return _Terms(
            np.concatenate((np.stack([*common, uu + vv], axis=-1), hold), axis=1),
            np.hstack((stamps.counts.reshape(n, -1) - flux * image.m - self.base[:, None],
                       frame - self.width[:, None])),
            np.hstack((weight, 1.0 / loose)), np.hstack((variance, loose)), light,
            np.stack([*common, uu, flux * image.m_uv, vv], axis=-1),
            np.stack([flux * image.m_trail_u, flux * image.m_trail_v], axis=-1))


class _Images(NamedTuple):
    """Part of a star's light in each pixel (n, k * k); its derivatives by u, v and the trail."""

    m: Array
    m_u: Array
    m_v: Array
    m_uu: Array
    m_uv: Array
    m_vv: Array
    m_trail_u: Array
    m_trail_v: Array


def _images(offset: Array, trail: Array, sigma: Array, half: int) -> _Images:
    t, weight = spot.points(spot.count(float(np.linalg.norm(trail)), float(np.median(sigma))))
    edges = np.arange(-half, half + 2) - 0.5 - (
        offset[:, :, None] + trail[:, None] * t)[..., None]             # (n, 2, points, k + 1)
    s = sigma[:, None, None, None]
    slopes = (spot.profile(edges, s), *spot.profile_slopes(edges, s))
    in_u = [slope[:, 0] for slope in slopes]
    in_v = [np.swapaxes(weight[:, None] * slope[:, 1], -1, -2) for slope in slopes]

    def product(of_v: Array, of_u: Array) -> Array:
        return (of_v @ of_u).reshape(len(offset), -1)

    return _Images(product(in_v[0], in_u[0]), product(in_v[0], in_u[1]), product(in_v[1], in_u[0]),
                   product(in_v[0], in_u[2]), product(in_v[1], in_u[1]), product(in_v[2], in_u[0]),
                   product(in_v[0] * t, in_u[1]), product(in_v[1] * t, in_u[0]))


def _solve(columns: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """Return the weighted least squares solution (n, c) and its covariance (n, c, c)."""
    weighted = np.swapaxes(columns * weight[..., None], -1, -2)
    A = weighted @ columns
    # Scaled to a diagonal of 1, plus a little: a spot without pixels then takes no step.
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(A, axis1=-2, axis2=-1), _TINY))
    unit = A * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(A.shape[-1])
    covariance = np.linalg.inv(unit) * scale[:, :, None] * scale[:, None, :]
    return (covariance @ (weighted @ residual[..., None]))[..., 0], covariance
