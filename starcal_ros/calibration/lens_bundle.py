# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment of identified stars with any lens model.

It begins without distortion. What a lens does beyond that may be a tenth of the field, so the
robust weight begins wide: a narrow one would keep the middle of the field and let the edge go for
wrong stars (graduated non-convexity; Blake and Zisserman, *Visual Reconstruction*, 1987). And the
low orders of the lens are fitted before the high ones, which would run away else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from starcal_ros.calibration.bundle_adjustment import Adjusted, adjust
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.calibration.bundle_start import attitudes, identified
from starcal_ros.config.models import detector, nominal_camera, own_focal_sigma_mm, star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import lenses, pixel_phase
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.phased import SIGMA_PX, PhasedLens
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.star_directions import StarDirections

_EARLY = ((0, (30.0,)), (2, (30.0,)), (4, (10.0,)))
"""Up to which power the lens is free at first, and widths of the robust weight."""
_EARLY_STEPS = 12       # there, for each width, at most
_WIDTHS = (10.0, 3.0)
"""Those with all of it free."""


class LensStart(NamedTuple):
    """A lens model, and what is known of its values before any star is seen.

    Attributes
    ----------
    lens : LensModel
    values : (p,) array
    covariance : (p, p) array
        Of their errors; zero for one that is held.
    own_f_sigma : float
        As for `bundle_adjustment.adjust`: where each frame has a focal length of its own.
    """

    lens: LensModel
    values: Array
    covariance: Array
    own_f_sigma: float = 0.0

    @property
    def free(self) -> int:
        """How many of its values are estimated."""
        return int(np.count_nonzero(np.diag(self.covariance)))


def start_of(name: str, scenario: Scenario, phase: bool = False) -> LensStart:
    """Return a lens model with the nominal focal length and principal point of a scenario.

    Of a model in pixels ``intrinsics.estimate`` holds u0, v0 and f where it leaves them out; its
    own coefficients are free.

    Parameters
    ----------
    name : str
        One of `lenses.NAMES`.
    scenario : Scenario
        Nominal camera and its initial sigmas.
    phase : bool
        Estimate the pixel phase, too.
    """
    if phase:
        optics = start_of(name, scenario)
        return LensStart(
            PhasedLens(optics.lens, detector(scenario.camera)),
            np.append(optics.values, np.zeros(len(pixel_phase.NAMES))),
            block_diag(optics.covariance, SIGMA_PX**2 * np.eye(len(pixel_phase.NAMES))))
    nominal, pitch_mm = nominal_camera(scenario), scenario.camera.pixel_pitch_mm
    own_mm = own_focal_sigma_mm(scenario)
    if name == lenses.PLUMB_BOB:
        return LensStart(Tan2018Lens(pitch_mm), nominal.intrinsics, nominal.covariance, own_mm)
    u0, v0, f_mm = nominal.intrinsics[:3].tolist()
    lens = lenses.in_pixels(name, detector(scenario.camera), f_mm / pitch_mm)
    sigma = np.concatenate((nominal.sigma[:3] / [1.0, 1.0, pitch_mm], lens.sigma))
    sigma[np.isin(lens.parameters, lens.held)] = 0.0
    return LensStart(lens, np.array([u0, v0, f_mm / pitch_mm, *0.0 * lens.sigma]),
                     np.diag(sigma**2), own_mm / pitch_mm)


def fit(spots: Observations, start: LensStart, gate: float) -> Adjusted:
    """Fit a camera and the attitudes to identified stars.

    Parameters
    ----------
    spots : Observations
        Of known direction.
    start : LensStart
    gate : float
        As for `bundle_adjustment.adjust`.

    Raises
    ------
    LinAlgError
        Where no camera like that can see them.
    """
    powers, values, freed = np.array(start.lens.powers), start.values, 0
    C_si = attitudes(spots, start.lens.unproject(spots.uv, values))
    for most, widths in _EARLY:
        free = powers <= most
        if free.sum() > freed:
            early = adjust(spots, values, C_si, np.empty((0, 3)), start.lens,
                           start.covariance * np.outer(free, free), gate, start.own_f_sigma,
                           widths, start.values, _EARLY_STEPS)
            values, C_si, freed = early.intrinsics, early.C_si, free.sum()
    return finish(spots, values, C_si, start, gate)


def finish(spots: Observations, values: Array, C_si: Array, start: LensStart, gate: float
           ) -> Adjusted:
    """Fit as `fit`, from values (p,) and attitudes (n, 3, 3) that are nearly right."""
    return adjust(spots, values, C_si, np.empty((0, 3)), start.lens, start.covariance, gate,
                  start.own_f_sigma, _WIDTHS, start.values)


class LensBundle:
    """The bundle adjustment of a lens model in pixels, as a method that calibrates the camera.

    Parameters
    ----------
    scenario : Scenario
        Observer, sigmas, gate.
    start : LensStart

    Attributes
    ----------
    own_f : (n, 2) array or None
        Focal length of each frame with stars enough, and its sigma (``intrinsics.free``) [px].
    """

    def __init__(self, scenario: Scenario, start: LensStart) -> None:
        self.own_f: Array | None = None
        self._start, self._gate = start, star_gate(scenario.estimator)
        self._directions = StarDirections(scenario)
        self._frames: list[Frames] = []
        self._notices = Notices()
        self.take_notices = self._notices.take

    def add_gyro(self, samples: GyroSamples) -> None:
        """Pass gyro samples over: each frame has an attitude of its own."""

    def add_frames(self, frames: Frames) -> None:
        """Take frames."""
        self._frames.append(frames)

    def estimate(self) -> CameraEstimate | None:
        """Adjust the camera to all frames so far; None while no frame has stars enough."""
        frames = Frames.concatenate(self._frames)
        spots = identified(frames, self._directions.of(frames, self._notices))
        if not len(spots.frame):
            return None
        try:
            adjusted = fit(spots, self._start, self._gate)
        except np.linalg.LinAlgError:
            return None
        self.own_f = adjusted.own_f
        return CameraEstimate(
            adjusted.intrinsics, adjusted.covariance, len(adjusted.C_si),
            int(adjusted.used.sum()))
