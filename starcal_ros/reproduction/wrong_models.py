# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that the model does not fit, and what a calibration says of them.

Each row of `ROWS` makes one thing of a simulated recording wrong, by a setting of the simulators
or by what it does to their messages, and knows what is true at its end. A step happens half-way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR, NS
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import N_STATES, SCALE
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.result import word
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.workflows import live_run

Messages = tuple[GyroSamples, Frames]

_ORBIT_S = 5700.0
_DAY_NS = 86400 * 10**9


def _as_it_is(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
    return gyro, frames


def _nothing_moves(true: Nominal, since_s: float) -> Nominal:
    return true


@dataclass(frozen=True)
class WrongModel:
    """One thing that is wrong.

    Attributes
    ----------
    name : str
        What a table calls it.
    settings : mapping
        Of the simulators, by the name of the parameter.
    spoil : callable
        What is done to the messages.
    moved : callable
        What is true at the end, from what the simulators have, and the time since the first frame.
    stated : mapping
        Parameters that the estimator, too, is told.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    spoil: Callable[[GyroSamples, Frames, Truth], Messages] = _as_it_is
    moved: Callable[[Nominal, float], Nominal] = _nothing_moves
    stated: Mapping[str, Any] = field(default_factory=dict)


class Judged(NamedTuple):
    """What a calibration was, and what it said of itself.

    Attributes
    ----------
    calibrator : Calibrator
        At its end.
    error : (16,) array
        Errors of the states over their sigmas, theta in the place of the attitude.
    nees : float
        Of the 16 states.
    alarm_s : float
        When it first contradicted the model or told of a change, from the beginning; infinite
        for never.
    """

    calibrator: Calibrator
    error: Array
    nees: float
    alarm_s: float

    @property
    def word(self) -> str:
        """The verdict."""
        return word(self.calibrator)

    @property
    def failed(self) -> tuple[str, ...]:
        """Statistics that failed, the clearest first."""
        found = [each for each in self.calibrator.consistency.statistics() if not each.passed]
        return tuple(each.name for each in sorted(found, key=lambda each: -each.excess))


def run(model: WrongModel, scenario: Scenario, seed: int) -> Judged:
    """Simulate a scenario, make it wrong, calibrate it and judge the outcome."""
    scenario = scenario.replace({'simulation.seed': seed, **model.stated})
    spoilt = scenario.replace(dict(model.settings))
    truth = Truth.from_scenario(spoilt)
    gyro, tracker = sensors.gyro(spoilt), sensors.star_tracker(spoilt)
    seen = tracker.next(tracker.count)
    samples, frames = model.spoil(gyro.next(gyro.count), seen, truth)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(samples)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    tests, belief = calibrator.consistency, calibrator.belief
    assert belief is not None
    alarms = [stamp_ns for stamp_ns, statistics in tests.history
              if not all(each.passed for each in statistics)]
    alarms += [change.found_ns for change in tests.changes]
    last = int(np.searchsorted(frames.stamp_ns, calibrator.stamp_ns))
    true = model.moved(nominal(truth, int(seen.stamp_ns[last])),
                       float(seen.stamp_ns[last] - seen.stamp_ns[0]) * NS)
    error = belief.estimate.minus(true)[:N_STATES] / SCALE
    return Judged(calibrator, error / np.linalg.norm(belief.root[:N_STATES], axis=-1),
                  float(belief.nees(true)),
                  (min(alarms) - int(frames.stamp_ns[0])) * NS if alarms else np.inf)


# What is done to the messages


def late(ms: float) -> WrongModel:
    """Return frames that are stamped late."""
    return WrongModel(f'star stamps {ms:g} ms late',
                      {'truth.star_tracker.time_offset_s': 1e-3 * ms})


def fast_clock(ppm: float) -> WrongModel:
    """Return a clock of the gyro that is fast."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        since = gyro.stamp_ns - gyro.stamp_ns[0]
        return GyroSamples(gyro.stamp_ns + np.rint(since * 1e-6 * ppm).astype(np.int64),
                           gyro.rate), frames
    return WrongModel(f'gyro clock {ppm:g} ppm fast', spoil=spoil)


def other_date(name: str, shift_ns: Callable[[int], int]) -> WrongModel:
    """Return stamps, both of them, of another date."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        by = shift_ns(int(gyro.stamp_ns[0]))
        return (GyroSamples(gyro.stamp_ns + by, gyro.rate),
                replace(frames, stamp_ns=frames.stamp_ns + by))
    # Else a clock that counts from its start is no UTC, and its frames are dropped.
    return WrongModel(name, spoil=spoil, stated={'estimator.earliest_utc': '1970-01-01T00:00:00Z'})


def _after_half(stamp_ns: Ints, frames: Frames) -> Mask:
    return np.asarray(stamp_ns >= frames.stamp_ns[len(frames) // 2])


def bias_step(deg_h: float) -> WrongModel:
    """Return a bias of x that steps."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        rate = gyro.rate.copy()
        rate[_after_half(gyro.stamp_ns, frames), 0] += deg_h * DEG_PER_HOUR
        return GyroSamples(gyro.stamp_ns, rate), frames

    def moved(true: Nominal, since_s: float) -> Nominal:
        return replace(true, bias=true.bias + [deg_h * DEG_PER_HOUR, 0.0, 0.0])
    return WrongModel(f'bias step of {deg_h:g} deg/h', {}, spoil, moved)


def focal_step(um: float) -> WrongModel:
    """Return a focal length that steps."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        step = np.zeros(7)
        step[2] = 1e-3 * um
        after = _after_half(frames.stamp_ns, frames)[frames.frame_index]
        return gyro, replace(frames, uv_raster=np.where(
            after[:, None], _reprojected(frames, truth, truth.intrinsics + step),
            frames.uv_raster))

    def moved(true: Nominal, since_s: float) -> Nominal:
        intrinsics = true.intrinsics.copy()
        intrinsics[2] += 1e-3 * um
        return replace(true, intrinsics=intrinsics)
    return WrongModel(f'focal length step of {um:g} um', {}, spoil, moved)


def focal_orbit(part: float) -> WrongModel:
    """Return a focal length that follows the orbit."""
    def wave(since_s: Array | float) -> Array:
        return np.asarray(part * np.sin(2.0 * np.pi / _ORBIT_S * since_s))

    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        longer = np.zeros((len(frames.catalog_id), 7))
        longer[:, 2] = truth.intrinsics[2] * wave(
            (frames.stamp_ns - frames.stamp_ns[0]) * NS)[frames.frame_index]
        return gyro, replace(frames, uv_raster=_reprojected(
            frames, truth, truth.intrinsics + longer))

    def moved(true: Nominal, since_s: float) -> Nominal:
        intrinsics = true.intrinsics.copy()
        intrinsics[2] *= 1.0 + wave(since_s)
        return replace(true, intrinsics=intrinsics)
    return WrongModel(f'focal length +-{part:g} with the orbit', {}, spoil, moved)


def tracker_turned(arcsec: float) -> WrongModel:
    """Return a star tracker that turns on its mounting, about x, in a step."""
    R = rotation.exp(np.array([arcsec * ARCSEC, 0.0, 0.0]))

    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        after = _after_half(frames.stamp_ns, frames)[frames.frame_index]
        return gyro, replace(frames, uv_raster=np.where(
            after[:, None], _reprojected(frames, truth, truth.intrinsics, R), frames.uv_raster))

    def moved(true: Nominal, since_s: float) -> Nominal:
        return replace(true, C_sg=R @ true.C_sg)
    return WrongModel(f'mounting step of {arcsec:g} arcsec', {}, spoil, moved)


def gyros_turned(arcsec: float) -> WrongModel:
    """Return gyros that turn on their mounting, about x, in a step."""
    R = rotation.exp(np.array([arcsec * ARCSEC, 0.0, 0.0]))

    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        after = _after_half(gyro.stamp_ns, frames)
        return GyroSamples(gyro.stamp_ns, np.where(
            after[:, None], gyro.rate @ R.T, gyro.rate)), frames

    def moved(true: Nominal, since_s: float) -> Nominal:
        return replace(true, C_gi=R @ true.C_gi, C_sg=true.C_sg @ R.T)
    return WrongModel(f'gyros turned by {arcsec:g} arcsec', {}, spoil, moved)


def _reprojected(frames: Frames, truth: Truth, intrinsics: Array, R: Array = np.eye(3)) -> Array:
    """Return the centroids of another camera, (7,) or (n_stars, 7), turned by R."""
    middle, pitch_mm = truth.detector.centre_raster, truth.detector.pitch_mm
    r_s = camera.unproject(frames.uv_raster - middle, truth.intrinsics, pitch_mm) @ R.T
    if intrinsics.ndim > 1:
        return middle + camera.project(r_s[:, None], intrinsics, pitch_mm)[:, 0]
    return middle + camera.project(r_s, intrinsics, pitch_mm)


def displaced(stars: int, arcsec: float) -> WrongModel:
    """Return some stars that are not where the catalogue has them."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        uv = frames.uv_raster.copy()
        px = arcsec * ARCSEC * truth.intrinsics[2] / truth.detector.pitch_mm
        numbers, count = np.unique(frames.catalog_id, return_counts=True)
        often = numbers[np.argsort(-count, kind='stable')[:stars]]
        uv[np.isin(frames.catalog_id, often), 0] += px
        return gyro, replace(frames, uv_raster=uv)
    return WrongModel(f'{stars} stars displaced by {arcsec:g} arcsec', spoil=spoil)


def pixel_phase(px: float) -> WrongModel:
    """Return centroids that are drawn towards the middle of their pixel."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        return gyro, replace(frames, uv_raster=frames.uv_raster - px * np.sin(
            2.0 * np.pi * frames.uv_raster))
    return WrongModel(f'pixel-phase error of {px:g} px', spoil=spoil)


def silent(seconds: float, every_s: float) -> Callable[..., Messages]:
    """Return what lets the gyro be silent, time and again, from some minutes on."""
    def spoil(gyro: GyroSamples, frames: Frames, truth: Truth) -> Messages:
        since = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
        return gyro.take((since < every_s) | (since % every_s >= seconds)), frames
    return spoil


SMEAR = {'truth.star_tracker.smear': True}
ROWS = (
    late(5.0), late(2.0), fast_clock(10.0),
    other_date('both stamps from boot', lambda begin_ns: 10**10 - begin_ns),
    other_date('both stamps half a year off', lambda begin_ns: 183 * _DAY_NS),
    WrongModel('angular random walk 3 times the stated', {'truth.gyro.arw_deg_sqrt_h': 0.003}),
    WrongModel('angular random walk 10 times the stated', {'truth.gyro.arw_deg_sqrt_h': 0.01}),
    bias_step(1.0), bias_step(0.1), focal_step(5.0), tracker_turned(10.0), gyros_turned(10.0),
    WrongModel('gyro scale of 300 ppm', {'truth.gyro.scale_factor_ppm': (300.0,) * 3}),
    displaced(3, 8.0),
    WrongModel('centroid noise 3 times the stated',
               {'truth.star_tracker.centroid_sigma_px': 0.15}),
    WrongModel('centroid noise 0.6 of the stated',
               {'truth.star_tracker.centroid_sigma_px': 0.03}),
    pixel_phase(0.05), focal_orbit(1e-4),
    WrongModel('orbit believed at the geocentre', {'truth.observer.velocity': 'orbit'}),
    WrongModel('10 % wrong stars and 20 s of silence',
               {'truth.star_tracker.misidentified_fraction': 0.1}, silent(20.0, 600.0)),
)
"""What is tabulated. The angular random walk is that of config/tan2018.yaml, 0.001 deg/sqrt(h)."""
CLEAN = WrongModel('nothing')


def live(model: WrongModel, scenario: Scenario, folder: Path) -> str:
    """Return the verdict of the suite's nodes on a row that needs settings alone.

    Raises
    ------
    NodeError
        Where there is no ROS 2, or a node fails.
    """
    return live_run.last_verdict(live_run.run_live(
        scenario.replace({**model.settings, **model.stated}), folder))
