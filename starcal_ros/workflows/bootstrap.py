# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From a camera known to a tenth, and unidentified stars, to the 16 states.

Each step begins with what the last one knows, and none sees a frame that an earlier one has
learnt from: what the covariances promise stays true. The recording is divided accordingly ::

    first quarter    self-calibration of the tracked spots: interstar (S24, SCOC freed of its
                     bias), then the bundle of the same spots, from there or from the nominal
                     camera, whichever fits better
    second quarter   identification, then angular distances (W19, fully weighted)
    second half      identification, then the 16-state filter (T18)

The bias that is taken from SCOC follows from the stated sigmas. Where these are rough, as those of
trails in images, which are longer than wide, it can be wrong by many sigmas; a self-calibration
that the bundle contradicts is therefore left out, and said to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from starcal_ros import calibration
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.calibration.methods import predicted_centroid
from starcal_ros.calibration.methods.bundle import Bundle
from starcal_ros.config.models import detector, nominal_camera, observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.distributions import chi2_ppf
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.progress import Progress
from starcal_ros.filter.states import LENS
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.identifier import Identifier
from starcal_ros.measurements.frame_rotations import from_gyro as _turns
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.document import CalibrationError
from starcal_ros.results.result import no_attitude

FOCAL_ERROR = 0.1
"""Part of the focal length by which the nominal one may be wrong."""


_SELF = {'intrinsics.method': 'interstar', 'intrinsics.interstar_equations': 'SCOC'}
_ANGLES = {'intrinsics.method': 'angular_distance', 'intrinsics.weighting': 'full'}
_AGREE = 0.9999         # chance that two cameras of the same stars are not called contradictory


class Step(NamedTuple):
    """What one step of the chain gave.

    Attributes
    ----------
    name : str
    camera : CameraEstimate
        After the step.
    """

    name: str
    camera: CameraEstimate


@dataclass(frozen=True)
class Chain:
    """What came of a recording.

    Attributes
    ----------
    steps : tuple of Step
        In order, the first what is known beforehand.
    frames : Frames
        Those of the second quarter and the second half, with the numbers found.
    calibrator : Calibrator
        The filter after the last frame.
    notices : tuple of str
        What a user should know.
    progress : Progress
        How the filter went.
    """

    steps: tuple[Step, ...]
    frames: Frames
    calibrator: Calibrator
    notices: tuple[str, ...]
    progress: Progress


def bootstrap(gyro: GyroSamples, frames: Frames, scenario: Scenario,
              on_progress: Callable[[float], None] = lambda part: None) -> Chain:
    """Calibrate a recording whose stars bear no numbers.

    Parameters
    ----------
    gyro : GyroSamples
        All samples, in the order of recording.
    frames : Frames
        All frames; numbers of stars in them are ignored.
    scenario : Scenario
        The nominal focal length may be wrong by FOCAL_ERROR.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    CalibrationError
        Where a step gives nothing to go on with.
    """
    frames = replace(frames, catalog_id=np.zeros_like(frames.catalog_id))
    n = len(frames)
    first, second, rest = frames[:n // 4], frames[n // 4:n // 2], frames[n // 2:]
    scenario = scenario.replace({'estimator.initial_sigma.focal_length_mm':
                                 FOCAL_ERROR * scenario.camera.focal_length_mm})
    steps = [Step('nominal', nominal_camera(scenario))]
    notices: list[str] = []

    def run(begun: CameraMethod, part: Frames) -> CameraEstimate | None:
        begun.add_gyro(gyro)
        begun.add_frames(part)
        return begun.estimate()

    def step(name: str, begun: CameraMethod, part: Frames, found: CameraEstimate | None
             ) -> CameraEstimate:
        notices.extend(f'{name}: {text}' for text in begun.take_notices())
        if found is None:
            raise CalibrationError(f'{name}: no camera from {len(part)} frames with '
                                   f'{len(part.catalog_id)} stars')
        steps.append(Step(name, found))
        return found

    nominal = steps[0].camera
    interstar = calibration.start(scenario.replace(_SELF), nominal)
    angles = run(interstar, first)
    on_progress(0.1)
    # The same frames again: begun there, but not believed a second time.
    starts = [nominal] if angles is None else [
        nominal, replace(nominal, intrinsics=angles.intrinsics)]
    bundles = [Bundle(scenario, known) for known in starts]
    cameras = [run(bundle, first) for bundle in bundles]
    on_progress(0.25)
    best = int(np.argmin([bundle.misfit for bundle in bundles]))
    seen = cameras[best]
    if seen is None or angles is not None and _agree(angles, seen):
        step('self-calibration', interstar, first, angles)
    else:
        notices.append('self-calibration by interstar angles '
                       + ('says nothing' if angles is None else 'contradicts the bundle')
                       + ': left out')
    camera = step('bundle of the spots', bundles[best], first, seen)
    numbered = identify(gyro, Frames.concatenate((second, rest)), camera, scenario,
                        lambda part: on_progress(0.25 + 0.45 * part))
    second = numbered[:len(second)]
    distances = calibration.start(scenario.replace(_ANGLES), camera)
    camera = step('angular distances', distances, second, run(distances, second))
    on_progress(0.75)
    calibrator = predicted_centroid.begin(scenario, camera)
    calibrator.add_gyro(gyro)
    calibrator.add_frames(numbered[len(second):])
    progress = Progress((frame.stamp_ns, frame.belief.sigma) for frame in calibrator.process())
    belief = calibrator.belief
    if belief is None:
        raise CalibrationError(no_attitude(calibrator))
    steps.append(Step('16 states', CameraEstimate(
        belief.estimate.intrinsics, belief.covariance[LENS, LENS], calibrator.counts.frames,
        calibrator.counts.stars)))
    notices += [f'16 states: {text}' for text in calibrator.take_notices()]
    on_progress(1.0)
    return Chain(tuple(steps), numbered, calibrator, tuple(notices), progress)


def _agree(camera: CameraEstimate, better: CameraEstimate) -> bool:
    """Tell whether two cameras differ by no more than their covariances allow."""
    free = better.sigma > 0.0
    away = (camera.intrinsics - better.intrinsics)[free]
    covariance = (camera.covariance + better.covariance)[np.ix_(free, free)]
    scale = np.sqrt(np.diag(covariance))
    away /= scale
    return bool(away @ np.linalg.solve(covariance / np.outer(scale, scale), away)
                < chi2_ppf(_AGREE, free.sum()))


def identify(gyro: GyroSamples, frames: Frames, camera: CameraEstimate, scenario: Scenario,
             on_progress: Callable[[float], None] = lambda part: None) -> Frames:
    """Return the frames with the catalogue numbers of their stars, 0 for an unidentified one.

    Parameters
    ----------
    gyro : GyroSamples
        They carry the attitude from frame to frame.
    frames : Frames
        With increasing stamps.
    camera : CameraEstimate
        As far as it is known.
    scenario : Scenario
        Mounting, bias, observer.
    on_progress : callable
        Called with the part done, 0 to 1.
    """
    identifier = Identifier(CameraGuess(detector(scenario.camera), camera.intrinsics,
                                        camera.covariance), observer(scenario.observer))
    from_gyro = _turns(gyro, frames, scenario)
    catalog_id, flux = np.zeros_like(frames.catalog_id), 10.0**(-0.4 * frames.magnitude)
    for k, (stamp_ns, turn) in enumerate(zip(frames.stamp_ns.tolist(), from_gyro)):
        rows = slice(frames.first[k], frames.first[k + 1])
        found = identifier.identify(frames.uv_raster[rows], flux[rows], stamp_ns, turn,
                                    frames.sigma[rows])
        if found is not None:
            catalog_id[rows] = found.catalog_id
        if k % 100 == 0:
            on_progress(k / len(frames))
    return replace(frames, catalog_id=catalog_id)
