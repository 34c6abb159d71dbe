# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The lens model of still images: as stated, or the one that predicts them best."""

from __future__ import annotations

from starcal_ros import calibration
from starcal_ros.calibration import lens_bundle, lens_choice, residual_tests
from starcal_ros.calibration.bundle_start import identified
from starcal_ros.calibration.lens_bundle import LensBundle, LensStart
from starcal_ros.calibration.lens_choice import LensChoice
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import lenses
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.workflows.still_images.table import StillImages

AUTO = 'auto'
"""To choose by cross-validation."""
CHOICES = (*lenses.NAMES, AUTO)

_SUSPICIOUS = frozenset((residual_tests.LENS, residual_tests.CELLS, residual_tests.REJECTIONS))
_REFUSED = 0.05         # share of the stars from which the lens model is looked at


def begin(start: LensStart, scenario: Scenario) -> CameraMethod:
    """Begin the method of a scenario, or the bundle adjustment of another lens model."""
    if isinstance(start.lens, Tan2018Lens):
        return calibration.begin(scenario)
    return LensBundle(scenario, start)


def compare(images: StillImages, scenario: Scenario) -> LensChoice | None:
    """Compare all lens models; None where images have too few stars for any.

    Parameters
    ----------
    images : StillImages
        Those that take part in the fit.
    scenario : Scenario
        What is known of the camera.
    """
    spots = identified(images.frames, StarDirections(scenario).of(images.frames))
    if not len(spots.frame):
        return None
    return lens_choice.choose(
        spots, [lens_bundle.start_of(name, scenario) for name in lenses.NAMES],
        star_gate(scenario.estimator))


def is_doubtful(found: Consistency, refused: float) -> bool:
    """Tell whether residuals, or a share of stars outside the gate, speak against the lens."""
    return refused > _REFUSED or any(each.name in _SUSPICIOUS for each in found.failed)
