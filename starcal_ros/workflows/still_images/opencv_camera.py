# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera of still images in OpenCV's forward model.

f, u0, v0 in raster pixels, k1, k2, p1, p2, or the coefficients of another lens model, without
unit.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import pixel_phase
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses import PLUMB_BOB
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.phased import PhasedLens
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.units import DEG
from starcal_ros.messages.conventions import camera_info

KEYS = ('f_px', 'u0_px', 'v0_px', 'k1', 'k2', 'p1', 'p2')
"""The intrinsics in results; p1 and p2 are OpenCV's."""
IN_OURS = ('f', 'u0', 'v0', 'k1', 'k2', 'p2', 'p1')
"""The same, as `starcal_ros.core.camera` calls them."""
WIDEST_PINHOLE_DEG, WIDEST_DEG = 120.0, 300.0
"""Fields of view across the width; what is wider than the first is a fisheye."""


def keys(lens: LensModel) -> tuple[str, ...]:
    """Return the parameters of a lens model in results, as KEYS has those of the five terms."""
    if isinstance(lens, PhasedLens):
        return (*keys(lens.optics), *(f'{name}_px' for name in pixel_phase.NAMES))
    return KEYS if lens.name == PLUMB_BOB else (*KEYS[:3], *lens.parameters[3:])


def in_ours(lens: LensModel) -> tuple[str, ...]:
    """Return the same, as the lens model calls them."""
    if isinstance(lens, PhasedLens):
        return (*in_ours(lens.optics), *pixel_phase.NAMES)
    return IN_OURS if lens.name == PLUMB_BOB else (*IN_OURS[:3], *lens.parameters[3:])


def from_estimate(estimate: CameraEstimate, scenario: Scenario, lens: LensModel | None = None
                  ) -> tuple[Array, Array]:
    """Return a camera as results have it, (p,) in the order of `keys`, and its covariance.

    Parameters
    ----------
    estimate : CameraEstimate
    scenario : Scenario
        Pixels.
    lens : LensModel, optional
        What the camera is; T18's where it is not said.
    """
    lens = lens or Tan2018Lens(scenario.camera.pixel_pitch_mm)
    order = [lens.parameters.index(name) for name in in_ours(lens)]
    values = estimate.intrinsics.copy()
    J = np.eye(len(values))
    if lens.name == PLUMB_BOB:
        values[:7], J[:7, :7] = _plumb_bob(values[:7], scenario)
        return values, J @ estimate.covariance @ J.T
    values[:2] += detector(scenario.camera).centre_raster
    return values[order], estimate.covariance[np.ix_(order, order)]


def _plumb_bob(intrinsics: Array, scenario: Scenario) -> tuple[Array, Array]:
    """Return the camera of T18 in the order of KEYS, (7,), and its derivatives."""
    info = camera_info(intrinsics, detector(scenario.camera))
    f, (k1, k2, p1, p2, _) = intrinsics[2], info.D
    J = np.zeros((7, 7))
    J[0, 2], J[1, 0], J[2, 1] = 1.0 / scenario.camera.pixel_pitch_mm, 1.0, 1.0
    J[3, 3], J[4, 4], J[5, 6], J[6, 5] = f**2, f**4, f, f
    J[3:, 2] = 2.0 * k1 / f, 4.0 * k2 / f, p1 / f, p2 / f
    return np.array([info.K[0], info.K[2], info.K[5], k1, k2, p1, p2]), J


def focal_length_of_field(fov_deg: float, width: int) -> float:
    """Return the focal length of a field of view across the width, of a fisheye if so wide [px].

    Raises
    ------
    ConfigError
        Where no camera has such a field.
    """
    check_field(fov_deg)
    if fov_deg > WIDEST_PINHOLE_DEG:
        return width / (fov_deg * DEG)
    return 0.5 * width / float(np.tan(0.5 * fov_deg * DEG))


def check_field(fov_deg: float) -> None:
    """Raise ConfigError where no camera has such a field of view across the width."""
    if not 0.0 < fov_deg <= WIDEST_DEG:
        raise ConfigError(f'field of view: got {fov_deg:g} deg, needs more than 0, at most '
                          f'{WIDEST_DEG:g}, of a fisheye beyond {WIDEST_PINHOLE_DEG:g}')
