# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether a camera that was calibrated alone is to be believed.

consistent
    No test of `residual_tests` fails, and every sigma is inside its tolerance where there is one.
not yet
    A sigma is outside its tolerance, nothing could be tested, or the estimate is what was assumed:
    the focal length, or all that is estimated, has more than `ASSUMED` of the variance that it
    had before the data.
inconsistent
    A test fails: the sigmas are not to be believed, however small they are.

A recording is tested with `FRAMES` of its frames at most, evenly spread, and `STARS` of their
stars, so that a test costs the same however long it is. Where the camera may walk
(``estimator.process_noise``) each run of frames gets a camera of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from starcal_ros.calibration import held_camera, residual_tests
from starcal_ros.calibration.held_camera import HeldFit
from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import detector, of_intrinsics, own_focal_sigma_mm, star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS, INTRINSICS_KEYS
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.statistic import gated_nis
from starcal_ros.core.verdict_words import INCONSISTENT, NOT_YET
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import StarDirections

CONSISTENT = 'consistent'
FRAMES, STARS = 400, 12000
"""Of a recording that are tested, at most."""

UNIDENTIFIED = ('the stars are not identified and the method leaves no residuals: with bundle, or '
                'with catalogue numbers, they are tested')
ASSUMED = 0.5
"""Part of the variance before the data; what has more of it left was told by that more than by
the stars."""
LEAST_STARS = 5
"""Of a frame that is tested: of fewer, those that are left out can not be told."""
NO_FRAME = f'no frame has {LEAST_STARS} identified stars'
NO_FIT = 'the stars have no attitude with which this camera sees them'

_ADVICE = {
    residual_tests.LEVEL: 'the centroids do not have the stated sigma, or move between frames in '
                          'a way that no attitude explains, such as refraction',
    residual_tests.LENS: 'the lens has terms that the model lacks',
    residual_tests.CELLS: 'stars are displaced in parts of the detector: look at the residual map',
    residual_tests.PHASE: 'the centroids depend on where in a pixel a star falls',
    residual_tests.TIME: 'the camera changes from frame to frame: focus, stabiliser, temperature, '
                         'or an aberration of the stars that is left out (--aberration; '
                         'observer.velocity)',
    residual_tests.IMAGES: 'the images are not of one camera, each has a focal length of its own '
                           'or another principal point: autofocus, stabiliser, zoom',
    residual_tests.AIR: 'the air is not that of the time and the site that were stated: '
                        '--utc-offset or --epoch, --site',
    residual_tests.AGREEMENT: 'these stars ask for another camera: wrong weights, or what the '
                              'method began with is wrong',
    residual_tests.SCATTER_CELLS: 'the noise depends on the place: state a sigma for each star',
    residual_tests.SCATTER_MAGNITUDE: 'the noise depends on the brightness: state a sigma for '
                                      'each star',
    residual_tests.SCATTER_SIGMA: 'the stars of least sigma, on which the camera hangs, scatter '
                                  'more than their sigmas say, or less: state them anew',
    residual_tests.HELD_OUT: 'the camera does not hold for images that took no part',
    residual_tests.REJECTIONS: 'most likely the identification, or the nominal camera, is wrong'}
"""What a failed test suggests; those of the filter speak for themselves."""


@dataclass(frozen=True)
class CameraVerdict:
    """What a camera is worth.

    Attributes
    ----------
    consistency : Consistency
        Tests of its residuals.
    tolerance : dict
        Largest sigma of each intrinsic that is enough, by its key; empty where none is stated.
    outside : tuple of str
        Keys of the intrinsics whose sigma is outside.
    assumed : tuple of str
        Keys of the intrinsics of which the stars tell less than was assumed beforehand.
    is_prior : bool
        Whether the focal length, or all that is estimated, is among them.
    about_lens : str
        What other lens models say, where they were tried.
    """

    consistency: Consistency
    tolerance: Mapping[str, float]
    outside: tuple[str, ...]
    assumed: tuple[str, ...] = ()
    is_prior: bool = False
    about_lens: str = ''

    @property
    def word(self) -> str:
        """`CONSISTENT`, `NOT_YET` or `INCONSISTENT`."""
        if self.consistency.failed:
            return INCONSISTENT
        return NOT_YET if self.outside or self.is_prior or self.consistency.why else CONSISTENT

    @property
    def advice(self) -> str:
        """What to do, or to look at."""
        failed = self.consistency.failed
        said = [*dict.fromkeys(_ADVICE[each.name] for each in failed if each.name in _ADVICE)]
        # With the air of another time no lens is what it seems.
        if failed and self.about_lens and all(each.name != residual_tests.AIR for each in failed):
            said.insert(0, self.about_lens)
        if self.assumed:
            said.append(
                ('the estimate is what was assumed before the data: ' if self.is_prior else '')
                + f'the stars tell less of {", ".join(self.assumed)} than what was assumed')
        if self.outside and not failed:
            said.append('more frames, turned about the line of sight and with stars all over the '
                        'field, for ' + ', '.join(self.outside))
        return '; '.join(said) or self.consistency.why

    @property
    def summary(self) -> str:
        """One sentence."""
        failed = self.consistency.failed
        if failed:
            return f'{INCONSISTENT}: ' + '; '.join(each.sentence for each in failed)
        return self.word if self.word == CONSISTENT else f'{self.word}: {self.advice}'

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        found = self.consistency
        return {
            'verdict': self.word, 'converged': self.word == CONSISTENT,
            'consistency': [{**each._asdict(), 'passed': each.passed}
                            for each in found.statistics],
            'variance_factor': {'centroids': found.centroid_factor,
                                **dict(zip(INTRINSICS_KEYS, found.camera_factors))},
            **({'tolerance': dict(self.tolerance)} if self.tolerance else {}),
            'assumed': list(self.assumed), 'advice': self.advice}


def judge(found: Consistency, estimate: CameraEstimate, scenario: Scenario) -> CameraVerdict:
    """Return the verdict on the camera of a recording, with the tolerances of a scenario."""
    tolerance = dict(zip(INTRINSICS_KEYS, of_intrinsics(scenario.estimator.tolerance).tolist()))
    outside = tuple(key for key, sigma in zip(INTRINSICS_KEYS, estimate.sigma)
                    if sigma > tolerance[key])
    return CameraVerdict(found, tolerance, outside,
                         *of_prior(estimate, of_intrinsics(scenario.estimator.initial_sigma),
                                   INTRINSICS, dict(zip(INTRINSICS, INTRINSICS_KEYS))))


def of_prior(estimate: CameraEstimate, before: Array, names: tuple[str, ...],
             keys: Mapping[str, str]) -> tuple[tuple[str, ...], bool]:
    """Return what of a camera the prior tells more than the stars do, `assumed` and `is_prior`.

    Parameters
    ----------
    estimate : CameraEstimate
    before : (p,) array
        Sigmas before any star was seen.
    names : tuple of str
        The parameters of the lens model.
    keys : mapping
        What each of them is called, in the order to tell them.
    """
    free = estimate.sigma > 0.0
    still = free & (estimate.sigma**2 > ASSUMED * before**2)
    named = [name for name, is_still in zip(names, still) if is_still]
    return (tuple(key for name, key in keys.items() if name in named),
            'f' in named or bool(named) and len(named) == int(free.sum()))


def of_frames(frames: Frames, estimate: CameraEstimate, scenario: Scenario,
              most_stars: int = STARS) -> Consistency:
    """Test a camera with identified stars of a recording; as `held`."""
    fitted = held(frames, estimate, scenario, most_stars)
    if isinstance(fitted, str):
        return Consistency(why=fitted)
    walk = of_intrinsics(scenario.estimator.process_noise)[estimate.sigma > 0.0]
    return residual_tests.consistency(
        fitted.stars, estimate, detector(scenario.camera),
        gated_nis(scenario.estimator.gate_probability), walks=bool(walk.any()))


def held(frames: Frames, estimate: CameraEstimate, scenario: Scenario, most_stars: int = STARS
         ) -> HeldFit | str:
    """Return frames with the camera held, or why there is nothing to fit.

    Parameters
    ----------
    frames : Frames
        All, or some that are spread evenly; of too many stars frames are passed over.
    estimate : CameraEstimate
    scenario : Scenario
        Sigmas, observer, gate, process noise.
    most_stars : int
        That are looked at; one frame at least.
    """
    if not (frames.catalog_id > 0).any():
        return UNIDENTIFIED
    stars = len(frames.catalog_id)
    if stars > most_stars:
        frames = frames.take(np.linspace(
            0, len(frames) - 1, max(1, len(frames) * most_stars // stars)).astype(int))
    found = StarDirections(scenario).of(frames)
    counts = np.bincount(frames.frame_index, np.isfinite(found.sigma), len(frames))
    enough = counts >= LEAST_STARS
    if not enough.any():
        return NO_FRAME
    # The gate counts in the scale of the residuals, of which an attitude takes its share.
    mean = float(counts[enough].mean())
    gate = star_gate(scenario.estimator) * 2.0 * mean / (2.0 * mean - 3.0)
    try:
        fitted = held_camera.fit(
            frames.take(enough), found.take(enough[frames.frame_index]), estimate.intrinsics,
            Tan2018Lens(scenario.camera.pixel_pitch_mm), gate, own_focal_sigma_mm(scenario))
    except np.linalg.LinAlgError:
        fitted = None
    return NO_FIT if fitted is None else fitted
