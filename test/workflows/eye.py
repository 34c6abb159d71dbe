# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A true camera that makes still images of the sky."""

from PIL import Image
from astropy.io import fits
import numpy as np

from starcal_ros.config.image import ImageConfig
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.utc import unix_ns
from starcal_ros.messages.conventions import from_camera_info
from starcal_ros.simulation.render import Renderer
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places
from starcal_ros.sky.refraction import refracted
from starcal_ros.workflows.still_images import calibration, opencv_camera

EPOCH = '2026-03-05T22:10:00'
PIXELS = Detector(640, 480, calibration.PITCH_MM)
TRUE = dict(zip(opencv_camera.KEYS, (2431.0, 327.0, 231.5, -0.12, 0.4, -6e-4, 9e-4)))
"""15 deg across."""
FOV = '15.5'


def intrinsics(f_px, u0_px, v0_px, k1, k2, p1, p2):
    """Return the project's camera of OpenCV's."""
    return from_camera_info(np.array([f_px, 0, u0_px, 0, f_px, v0_px, 0, 0, 1]),
                            np.array([k1, k2, p1, p2, 0]), PIXELS)


class Camera:
    """The true camera, that makes pictures of the sky."""

    def __init__(self, observer=Observer('barycentre'), site=None, seed=1, true=TRUE,
                 least_cosine=0.98, **config):
        self.stars, self.rng = catalog.load(8.0), np.random.default_rng(seed)
        self.stamp_ns = unix_ns(EPOCH)
        self.u_i = apparent_places(
            self.stars, np.arange(len(self.stars)), [self.stamp_ns], [len(self.stars)], observer)
        self.vacuum = self.u_i
        if site is not None:
            self.u_i = refracted(self.u_i, np.full(len(self.u_i), self.stamp_ns), site)
        self.intrinsics, self.least_cosine = intrinsics(**true), least_cosine
        self.renderer = Renderer(ImageConfig(full_well_electrons=5e4, **config), PIXELS, 0.3,
                                 self.rng)

    def towards(self, direction=None):
        """Return the counts of an image of the sky about a direction, or about any."""
        return self.counts(*self.stars_towards(direction))

    def stars_towards(self, direction=None):
        """Return places from the centre and magnitudes of stars about a direction, or any."""
        C_si = rotation.exp(3.0 * self.rng.standard_normal(3))
        if direction is not None:
            axis = np.cross(C_si[2], direction)
            angle = np.arctan2(np.linalg.norm(axis), C_si[2] @ direction)
            C_si = C_si @ rotation.exp(angle * axis / np.linalg.norm(axis)).T
        r_s = self.u_i @ C_si.T
        ahead = r_s[:, 2] > self.least_cosine
        uv = camera.project(r_s[ahead], self.intrinsics, PIXELS.pitch_mm)
        return uv, self.stars.magnitude[ahead]

    def counts(self, uv, magnitude):
        """Return the counts of an image of some stars."""
        return self.renderer.counts(self.renderer.light(np.repeat(uv[None], 5, axis=0),
                                                        magnitude))


def save(path, counts, date_obs=None):
    """Write counts as PNG or, with a time, as FITS."""
    if path.suffix == '.png':
        Image.fromarray(counts).save(path)
    else:
        unit = fits.PrimaryHDU(counts[::-1])
        if date_obs:
            unit.header['DATE-OBS'] = date_obs
        unit.writeto(path)
