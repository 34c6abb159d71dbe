# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Places of spots by least squares: the spot of a star, integrated over pixels, fitted to each.

Model
-----
Counts about a spot, less the background, and their variance ::

    d = F m(u, v, s^2) + b + noise,    V = noise^2 + F m / gain                     (C.1)

    m       part of the star's light in a pixel (`core.psf`), the trail that of the frame
    s^2     px^2           variance of the spot, near that of the frame: lenses are not all even
    F, b    counts         light of the star, what is left of the background
    gain    electrons a count

(u, v, s^2, F, b) of all spots at once by Gauss and Newton. Where the gain is given, the weights
are 1 / V from the fit, not from the data, whose noise would bias them; the covariance is then the
Cramer-Rao bound: if the model holds, the estimator is as good as any. Where it is not, the weights
are even, which a spot that is not quite a Gaussian harms less; the covariance is that of such a
fit, with the gain that the scatter about it shows.

What the shape of a spot differs from the frame's is one more such step, with columns for its
second moments: by the heat equation, the derivative by the variance of a Gaussian is half of
the second derivative by its place                                                  (C.2)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core import psf
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.imaging.cutouts import Cutouts, Shape

_LEAST_PIXELS = 9               # that a fit needs
_FARTHEST_PX = 1.5              # from the middle of the cutout, where a fit may end; its sigma
_WIDTH_PART = 0.3               # of the frame's variance, what a star's differs by, 1 sigma
_TINY = 1e-30


class PsfFit(NamedTuple):
    """Fitted spots.

    Attributes
    ----------
    frame : Shape
        The shape that they were fitted with.
    offset : (n, 2) array
        Place from the middle of the cutout [px].
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
        The fit came to an end near the middle of the cutout, and is known to lie there.
    """

    frame: Shape
    offset: Array
    covariance: Array
    flux: Array
    width: Array
    trail: Array
    moments: Array
    moments_sigma: Array
    shot: Array
    good: Mask

    @property
    def shape(self) -> Shape:
        """The shape that the good ones have in common."""
        if not self.frame.trail.any():
            return Shape.of_moments(self.frame.moments
                                    + np.median(self.moments[self.good], axis=0))
        return Shape.bounded(float(np.median(self.width[self.good])),
                             self.frame.trail + np.median(self.trail[self.good], axis=0))


def fit(cutouts: Cutouts, offset: Array, shape: Shape, gain: float, photons: bool,
        iterations: int = 4) -> PsfFit:
    """Return the spots of a shape that fit the cutouts best, Eq. (C.1).

    Parameters
    ----------
    cutouts : Cutouts
        Cuttings, k = 2 `shape.half` + 1.
    offset : (n, 2) array
        Where to begin, from the middle of each cutout [px].
    shape : Shape
        The frame's.
    gain : float
        Electrons a count.
    photons : bool
        Weigh pixels by V, and not evenly.
    iterations : int
        Of Gauss and Newton.
    """
    zero = np.zeros(len(offset))
    spots = _FittedSpots(cutouts, shape, offset, zero, zero, zero + shape.sigma**2)
    # Light and background first, at the place given; then all, with weights that follow.
    terms = spots.terms(gain, photons)
    spots = spots.moved(_solve(terms.columns[..., :2], terms.residual, terms.weight)[0])
    for _ in range(iterations):
        terms = spots.terms(gain, photons)
        spots = spots.moved(_solve(terms.columns, terms.residual, terms.weight)[0])
    terms = spots.terms(gain, photons)
    covariance, shot, excess = _scatter(terms, cutouts.noise)
    trail, moments, moments_sigma = _shapes(terms, shape)
    valid = cutouts.valid.reshape(len(offset), -1).sum(axis=1)
    place = excess[:, None, None] * covariance[:, 2:4, 2:4]
    spread = np.linalg.eigvalsh(place)
    good = ((valid >= _LEAST_PIXELS) & (spots.flux > 0.0)
            & (np.abs(spots.offset) <= _FARTHEST_PX).all(axis=1)
            & (spread[:, 0] > 0.0) & (spread[:, 1] < _FARTHEST_PX**2))
    moments = moments + (spots.width - shape.sigma**2)[:, None, None] * np.eye(2)
    return PsfFit(shape, spots.offset, place, spots.flux, spots.width, trail, moments,
                  moments_sigma, shot, good)


class _Terms(NamedTuple):
    """One step of Gauss and Newton: p pixels, and a last row that holds the width to the frame's.

    `columns` (n, p + 1, 5) are the derivatives by light, background, u, v and width; `image` and
    `flux` are what they are made of.
    """

    columns: Array
    residual: Array
    weight: Array
    variance: Array
    image: _Image
    flux: Array


def _scatter(terms: _Terms, noise: Array) -> tuple[Array, Array, Array]:
    """Return covariance (n, 5, 5), shot noise and excess of the residuals (n,) of fitted spots."""
    columns, residual, weight, variance = terms[:4]
    _, inverse = _solve(columns, residual, weight)
    # The weights need not be 1 / V: the covariance of any weighted fit.
    part = inverse @ np.swapaxes(columns * weight[..., None], -1, -2)
    covariance = (part * variance[:, None, :]) @ np.swapaxes(part, -1, -2)
    # A residual has the variance V (1 - h), h what its pixel takes part in its own fit.
    free = (weight > 0.0) * np.maximum(1.0 - np.einsum('npi,nip->np', columns, part), 0.0)
    free, square = free[:, :-1], (np.where(weight > 0.0, residual, 0.0)**2)[:, :-1]
    bright = np.maximum(terms.flux * terms.image.part(), 0.0)
    light = free * bright
    shot = ((square - free * noise[:, None]**2).sum(axis=1) / np.maximum(light.sum(axis=1), 1.0))
    # Of few pixels a sum of squares is below its mean more often than not: the median of the
    # shots of all stars shall be that mean (Wilson and Hilferty 1931).
    pixels = light.sum(axis=1)**2 / np.maximum((light * bright).sum(axis=1), _TINY)
    shot /= (1.0 - 2.0 / (9.0 * np.maximum(pixels, 1.0)))**3
    # A shape that is not quite the star's scatters more than the noise: then that is the noise.
    freedom = np.maximum(free.sum(axis=1), 1.0)
    excess = np.sum(square / variance[:, :-1], axis=1) / freedom
    return covariance, shot, np.where(excess > 1.0 + 3.0 * np.sqrt(2.0 / freedom), excess, 1.0)


def _shapes(terms: _Terms, shape: Shape) -> tuple[Array, Array, Array]:
    """Return how trail (n, 2) and moments (n, 2, 2) differ, Eq. (C.2), and the sigma of these."""
    image, flux = terms.image, terms.flux
    columns, residual, weight = terms.columns[:, :-1], terms.residual[:, :-1], terms.weight[:, :-1]
    trail: Array = np.zeros((len(flux), 2))
    if shape.trail.any():
        by_trail = np.stack([flux * part for part in image.by_trail()], axis=-1)
        trail = _solve(np.concatenate((columns, by_trail), axis=-1), residual, weight)[0][:, 5:]
    by_moments = np.stack([flux * image.part(2, 0) / 2.0, flux * image.part(1, 1),
                           flux * image.part(0, 2) / 2.0], axis=-1)
    step, wide = _solve(np.concatenate((columns[..., :4], by_moments), axis=-1), residual, weight)
    return (trail, step[:, [4, 5, 5, 6]].reshape(-1, 2, 2),
            np.sqrt((wide[:, 4, 4] + wide[:, 6, 6]) / 2.0))


class _FittedSpots(NamedTuple):
    """Spots on their cutouts, and what they are believed to be."""

    cutouts: Cutouts
    shape: Shape
    offset: Array
    flux: Array
    base: Array
    width: Array

    def moved(self, step: Array) -> _FittedSpots:
        """Return the spots after a step (n, 2 or 5), which is kept within bounds."""
        flux, base = self.flux + step[:, 0], self.base + step[:, 1]
        if step.shape[1] == 2:
            return self._replace(flux=flux, base=base)
        width = np.clip(self.width + step[:, 4], 0.5 * self.width, 2.0 * self.width)
        return self._replace(flux=flux, base=base, width=width,
                             offset=self.offset + np.clip(step[:, 2:4], -1.0, 1.0))

    def terms(self, gain: float, photons: bool) -> _Terms:
        """Return the terms of the next step."""
        cutouts, n, flux = self.cutouts, len(self.flux), self.flux[:, None]
        image = _Image(self.offset, self.shape.trail, np.sqrt(self.width),
                       cutouts.counts.shape[1] // 2)
        light = image.part()
        even = np.broadcast_to(cutouts.noise[:, None]**2, light.shape)
        variance = even + np.maximum(flux * light, 0.0) / gain
        # The last row: the width is that of the frame, give or take a part of it.
        frame = self.shape.sigma**2
        loose = np.full((n, 1), (_WIDTH_PART * frame)**2)
        columns = np.zeros((n, light.shape[1] + 1, 5))
        columns[:, :-1, 0], columns[:, :-1, 1] = light, 1.0
        columns[:, :-1, 2], columns[:, :-1, 3] = flux * image.part(1, 0), flux * image.part(0, 1)
        columns[:, :-1, 4] = flux * (image.part(2, 0) + image.part(0, 2)) / 2.0
        columns[:, -1, 4] = 1.0
        residual = cutouts.counts.reshape(n, -1) - flux * light - self.base[:, None]
        weight = cutouts.valid.reshape(n, -1) / (variance if photons else even)
        return _Terms(columns, np.hstack((residual, frame - self.width[:, None])),
                      np.hstack((weight, 1.0 / loose)), np.hstack((variance, loose)), image, flux)


class _Image:
    """The part of the light of n stars in each pixel of their cutouts, and its derivatives."""

    def __init__(self, offset: Array, trail: Array, sigma: Array, half: int) -> None:
        self._t, weight = psf.points(
            psf.count(float(np.linalg.norm(trail)), float(np.median(sigma))))
        edges = np.arange(-half, half + 2) - 0.5 - (
            offset[:, :, None] + trail[:, None] * self._t)[..., None]   # (n, 2, points, k + 1)
        s = sigma[:, None, None, None]
        slopes = (psf.profile(edges, s), *psf.profile_slopes(edges, s))
        self._u = [slope[:, 0] for slope in slopes]
        self._v = [np.swapaxes(weight[:, None] * slope[:, 1], -1, -2) for slope in slopes]

    def part(self, by_u: int = 0, by_v: int = 0) -> Array:
        """Return the part of the light (n, k * k), differentiated by u and v so many times."""
        image = self._v[by_v] @ self._u[by_u]
        return image.reshape(len(image), -1)

    def by_trail(self) -> tuple[Array, Array]:
        """Return the derivatives by the two components of the trail."""
        by_u, by_v = (self._v[0] * self._t) @ self._u[1], (self._v[1] * self._t) @ self._u[0]
        return by_u.reshape(len(by_u), -1), by_v.reshape(len(by_v), -1)


def _solve(columns: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """Return the weighted least squares solution (n, c) and its covariance (n, c, c)."""
    weighted = np.swapaxes(columns * weight[..., None], -1, -2)
    A = weighted @ columns
    # Scaled to a diagonal of 1, plus a little: a spot without pixels then takes no step.
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(A, axis1=-2, axis2=-1), _TINY))
    unit = A * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(A.shape[-1])
    covariance = np.linalg.inv(unit) * scale[:, :, None] * scale[:, None, :]
    return (covariance @ (weighted @ residual[..., None]))[..., 0], covariance
