# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Half real: the camera and the centroids' noise of real images, motion and gyro simulated.

There is no public recording of a star camera with gyros. This comes nearest to the experiment of
T18 Sec. 4: the 16-state filter on what a real lens and real centroids do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.distributions import normal_cdf
from starcal_ros.filter import offline
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.history import History
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.measurements.samples import Frames
from starcal_ros.reproduction import real_images
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published.real_sky import calibrate
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.workflows.still_images.calibration import StillImageCamera

RUNS = 1
COLUMNS = ('set', 'state', 'unit', 'error', 'sigma', 'error/sigma')
NOTES = (
    'The camera is that of the bundle fit, the noise of each centroid one of its residuals, drawn '
    'at random; stars, motion and gyro are those of the scenario. The filter begins 1 % off in f, '
    'at the middle of the detector and without distortion.',
    'T18 Sec. 4 has reprojection errors of 0.0732 and 0.0909 px with its own camera. Here a '
    'centroid has a sigma of 0.10 and 0.14 px: no calibration can leave less than that.')
_PAPER_PX = (0.0732, 0.0909)
_REACH, _CELLS = 4.5, 45        # of the histograms [sigma]
_OFF = 1.01                     # nominal over true focal length


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Calibrate a simulated recording of each camera; the number of runs does not matter."""
    rows: list[tuple[str | float, ...]] = []
    panels = []
    values = {}
    for k, images in enumerate(real_images.SETS):
        found = calibrate(images, 'bundle')
        assert found is not None        # the reference method knows these images
        made = scenario_of(found, scenario)
        gyro = sensors.gyro(made)
        calibrator, history = offline.calibrate(
            gyro.next(gyro.count), frames_of(found, made), made)
        rows += [(images.name, *row) for row in _rows(calibrator, made)]
        values[images.name] = {'reprojection_rms_px': calibrator.reprojection_rms_px.tolist(),
                               'paper_px': list(_PAPER_PX), 'centroid_sigma_px': found.sigma_px}
        rows += [(images.name, f'reprojection {axis}', 'px', rms, found.sigma_px,
                  rms / found.sigma_px)
                 for axis, rms in zip('uv', calibrator.reprojection_rms_px.tolist())]
        panels += _histograms(images.name, history)
        on_progress((k + 1) / len(real_images.SETS))
    return Outcome('Half real: real cameras, simulated motion', COLUMNS, tuple(rows), NOTES,
                   tuple(panels), values)


def scenario_of(found: StillImageCamera, scenario: Scenario) -> Scenario:
    """Return the scenario with a real camera as its truth, of which little is known."""
    u0, v0, f, *distortion = found.estimate.intrinsics.tolist()
    known = found.scenario.flat()
    return scenario.replace({
        **{key: known[key] for key in ('camera.width', 'camera.height', 'camera.pixel_pitch_mm')},
        'camera.focal_length_mm': _OFF * f, 'camera.principal_point_px': (0.0, 0.0),
        'camera.distortion': (0.0, 0.0, 0.0, 0.0),
        'truth.camera.focal_length_mm': f, 'truth.camera.principal_point_px': (u0, v0),
        'truth.camera.distortion': tuple(distortion),
        'star_tracker.centroid_sigma_px': found.sigma_px,
        'truth.star_tracker.centroid_sigma_px': 0.0,
        'estimator.initial_sigma.principal_point_px': 50.0,
        'estimator.initial_sigma.focal_length_mm': 0.02 * f,
        'estimator.initial_sigma.k2': 1e-4})


def frames_of(found: StillImageCamera, made: Scenario) -> Frames:
    """Return the simulated frames, their centroids with the noise of the real ones."""
    tracker = sensors.star_tracker(made)
    frames = tracker.next(tracker.count)
    drawn = [part.adjusted.residual[part.adjusted.used] for part in (found.fit, found.heldout)
             if part is not None]
    pool = np.concatenate(drawn)
    pool = (pool - pool.mean(axis=0)) * (found.sigma_px / pool.std())
    rng = np.random.default_rng(made.simulation.seed)
    return replace(frames, uv_raster=frames.uv_raster
                   + pool[rng.integers(len(pool), size=len(frames.uv_raster))])


def _rows(calibrator: Calibrator, made: Scenario) -> list[tuple[str | float, ...]]:
    belief = calibrator.belief
    assert belief is not None
    truth = Truth.from_scenario(made)
    C_gi = truth.motion.attitude(np.array([calibrator.stamp_ns]))[0].T
    error = belief.estimate.minus(Nominal(C_gi, truth.bias, truth.C_sg, truth.intrinsics))
    return list(zip(STATE_NAMES[CALIBRATED], STATE_UNITS[CALIBRATED],
                    (error / UNIT)[CALIBRATED].tolist(),
                    (belief.sigma / UNIT)[CALIBRATED].tolist(),
                    (error / belief.sigma)[CALIBRATED].tolist()))


def _histograms(name: str, history: History) -> list[Panel]:
    edges = np.linspace(-_REACH, _REACH, _CELLS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    stars = history.stars
    scaled = (stars.residual / stars.sigma[:, None])[stars.accepted]
    return [Panel(f'{name}, {axis}', 'residual [sigma of the centroid]', 'stars', (
        Curve(middle, np.histogram(part, edges)[0].astype(float), style='bars'),
        Curve(middle, len(part) * np.diff(normal_cdf(edges)), 'Gaussian', 'limit')))
        for axis, part in zip('uv', scaled.T)]
