# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images of the simulated star tracker: from the true sky, camera and motion to counts.

Model
-----
Electrons of a pixel, and the counts that it gives ::

    e = Poisson(sum over stars of N m) + Poisson(hot) + Normal(b, b + r^2),   e <= full well (R.1)
    N = Z 10^(-0.4 Hp) T,   b = (sky + dark) T
    counts = round(e / gain + offset), 0 to saturation

    m          part of a star's light in the pixel (`starcal_ros.core.psf`), along its true trail
    Z, T       e/s, s    electrons a second of a star of Hp 0, exposure
    b, r       e         electrons of sky and dark current, noise of the readout

The shot noise of sky and dark current is drawn together with that of the readout, as a normal
distribution of the same variance: a Poisson number for each of a million pixels would take three
times as long as all the rest. What is lost is its skewness, b / (b + r^2)^(3/2), 0.6 % here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.image import ImageConfig
from starcal_ros.config.models import true_time_offset_s
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import psf
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.simulation.star_images import instants_ns
from starcal_ros.simulation.star_view import StarView
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky.catalog import Catalog

Image = NDArray[np.uint16]

_REACH = 5.0            # sigmas of the spot that are drawn: all but 1e-6 of its light
_NODES = np.array(instants_ns(1.0)) * 1e-9
_FROM_NODES = np.linalg.inv(np.vander(_NODES))


class Renderer:
    """A detector that turns trails of light into counts.

    Parameters
    ----------
    config : ImageConfig
        Spot, noise, gain.
    detector : Detector
        Its pixels.
    exposure_s : float
        Exposure [s].
    rng : np.random.Generator
        Draws hot pixels at once, and the noise of each frame.
    """

    def __init__(self, config: ImageConfig, detector: Detector, exposure_s: float,
                 rng: np.random.Generator) -> None:
        self._config, self._detector, self._exposure_s = config, detector, exposure_s
        self._rng = rng
        self._hot = rng.choice(detector.width * detector.height, config.hot_pixels, replace=False)
        self._hot_electrons = (config.hot_electrons_s * exposure_s
                               * rng.standard_exponential(config.hot_pixels))
        self._background = exposure_s * (config.sky_electrons_s + config.dark_electrons_s)

    def electrons(self, magnitude: Array) -> Array:
        """Return the mean electrons of stars of a magnitude, N of Eq. (R.1)."""
        config = self._config
        return (config.zero_point_electrons_s * self._exposure_s
                * 10.0 ** (-0.4 * np.asarray(magnitude)))

    def light(self, trail: Array, magnitude: Array) -> Array:
        """Return the mean electrons (height, width) of the light of stars, without a background.

        Parameters
        ----------
        trail : (5, n, 2) array
            Places at the `instants_ns`, from the centre of the detector [px].
        magnitude : (n,) array
            Hp.
        """
        detector, sigma = self._detector, self._config.psf_sigma_px
        image = np.zeros((detector.height, detector.width))
        reach = int(np.ceil(_REACH * sigma)) + 1
        electrons = self.electrons(magnitude)
        for k, nodes in enumerate(np.swapaxes(trail + detector.centre_raster, 0, 1)):
            first = np.maximum(np.rint(nodes.min(axis=0)).astype(int) - reach, 0)
            last = np.minimum(np.rint(nodes.max(axis=0)).astype(int) + reach + 1,
                              image.shape[::-1])
            if np.any(first >= last):
                continue
            length = float(np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum())
            t, weight = psf.points(psf.count(length, sigma))
            uv = np.vander(t, len(nodes)) @ (_FROM_NODES @ nodes)
            p_u, p_v = (psf.profile(np.arange(a, b + 1) - 0.5 - at[:, None], sigma)
                        for a, b, at in zip(first, last, uv.T))
            image[first[1]:last[1], first[0]:last[0]] += (
                p_v.T @ (electrons[k] * weight[:, None] * p_u))
        return image

    def counts(self, light: Array) -> Image:
        """Return the image that the detector reads where this light falls, Eq. (R.1)."""
        config, rng = self._config, self._rng
        noise = np.sqrt(self._background + config.read_noise_electrons**2)
        electrons = rng.standard_normal(light.shape, dtype=np.float32)
        electrons *= np.float32(noise)
        electrons += np.float32(self._background)
        flat, lit = electrons.ravel(), np.flatnonzero(light)
        flat[lit] += rng.poisson(light.ravel()[lit])
        flat[self._hot] += rng.poisson(self._hot_electrons)
        np.minimum(electrons, np.float32(config.full_well_electrons), out=electrons)
        electrons *= np.float32(1.0 / config.gain_electrons)
        electrons += np.float32(config.offset_counts + 0.5)
        return np.clip(electrons, 0, config.saturation_counts, out=electrons).astype(np.uint16)


class ImageSimulator:
    """The images of one run.

    Parameters
    ----------
    scenario : Scenario
        Exposure, observer, true time offset of the stamps.
    config : ImageConfig
        What the images look like.
    truth : Truth
        Camera, mounting and attitude.
    stars : Catalog
        The sky; those down to the limiting magnitude of the images are drawn.
    rng : np.random.Generator
        Its own stream.
    """

    def __init__(self, scenario: Scenario, config: ImageConfig, truth: Truth, stars: Catalog,
                 rng: np.random.Generator) -> None:
        self._config, self._detector, self._rng = config, truth.detector, rng
        self._stars = stars.brighter_than(config.limiting_magnitude)
        self._view = StarView(scenario, truth, self._stars)
        self._exposure_s = scenario.star_tracker.exposure_s
        self._late_ns = round(true_time_offset_s(scenario) * 1e9)
        self._renderer = Renderer(config, truth.detector, self._exposure_s, rng)

    def image(self, stamp_ns: int) -> Image:
        """Return the image (height, width) of a frame, mono16, top row first."""
        middle_ns = np.array([stamp_ns - self._late_ns])
        frame, star, u_i = self._view.near(middle_ns)
        trail = self._view.trail(middle_ns, frame, u_i)
        magnitude = self._stars.magnitude[star]
        if self._config.false_magnitude is not None:
            trail = np.concatenate((trail, self._false_trail()), axis=1)
            magnitude = np.append(magnitude, self._config.false_magnitude)
        return self._renderer.counts(self._renderer.light(trail, magnitude))

    def _false_trail(self) -> Array:
        """Return a steady motion (5, 1, 2) through a random place in a random direction."""
        size = np.array([self._detector.width, self._detector.height])
        middle = size * (self._rng.random(2) - 0.5)
        direction = 2.0 * np.pi * self._rng.random()
        step = (self._config.false_rate_px_s * self._exposure_s
                * np.array([np.cos(direction), np.sin(direction)]))
        return (middle + _NODES[:, None] * step)[:, None]
