# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes that users make, and what ``starcal check`` says of them.

Each row of `ROWS` spoils the messages of a recording, or what is stated of it, in one way, so
that any recording will do whose truth is known: a simulated one, or one that others made. What the
check proposes is then adopted: parameters as they are, and, where a driver is to be mended, its
numbers by what the finding says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.checks.check import Checked, check
from starcal_ros.checks.finding import Finding, proposed
from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, NS
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import CALIBRATED, N_STATES, SCALE
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.conventions import C_os
from starcal_ros.results.result import word

Messages = tuple[GyroSamples, Frames]
Spoil = Callable[[GyroSamples, Frames, np.random.Generator], Messages]


@dataclass(frozen=True)
class KnownRecording:
    """A recording, what is rightly stated of it, and the truth at its end.

    Attributes
    ----------
    gyro, frames
        Its messages.
    scenario : Scenario
    truth : Nominal
        Attitude unknown: C_gi does not count.
    """

    gyro: GyroSamples
    frames: Frames
    scenario: Scenario
    truth: Nominal


def _nothing(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    return gyro, frames


def _as_stated(scenario: Scenario) -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    Attributes
    ----------
    name : str
    kinds : tuple of str
        Of the findings that are right; the first is the name of the mistake.
    spoil : callable
        What is done to the messages.
    stated : callable
        Parameters that are stated wrongly, by the right scenario.
    value : tuple of float
        What the first finding should have; nothing where it has no number.
    bias : (3,) tuple
        What is added to the true bias [deg/h].
    axes : (3,) tuple
        Which axis, from 1, negative where reversed, the readings have in place of x, y, z; only
        where the truth is then another mounting.
    """

    name: str
    kinds: tuple[str, ...]
    spoil: Spoil = _nothing
    stated: Callable[[Scenario], Mapping[str, Any]] = _as_stated
    value: tuple[float, ...] = ()
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[int, int, int] = (1, 2, 3)

    def true(self, before: Nominal) -> Nominal:
        """Return the truth behind the messages that are spoilt."""
        P = np.sign(self.axes)[:, None] * np.eye(3)[np.abs(self.axes) - 1]
        return replace(before, C_sg=before.C_sg @ P.T,
                       bias=P @ before.bias + np.array(self.bias) * DEG_PER_HOUR)


class Judgement(NamedTuple):
    """What became of one mistake in one recording.

    Attributes
    ----------
    checked : Checked
    right : bool
        Whether its first kind was found.
    wrong : tuple of str
        Kinds that were found and are not right.
    off : float
        Largest error of the value over its sigma, relative error where it states none; NaN for
        no value.
    before, after : float
        Largest error of a calibrated state over its sigma, without and with what is proposed; NaN
        where there is no result, or nothing that can be adopted.
    words : tuple of str
        The verdicts of both.
    """

    checked: Checked
    right: bool
    wrong: tuple[str, ...]
    off: float
    before: float
    after: float
    words: tuple[str, str]


def run(mistake: Mistake, source: KnownRecording, seed: int, calibrated: bool = True) -> Judgement:
    """Make a mistake, check, and calibrate without and with what is proposed."""
    gyro, frames = mistake.spoil(source.gyro, source.frames, np.random.default_rng(seed))
    stated = source.scenario.replace(dict(mistake.stated(source.scenario)))
    checked = check(gyro, frames, stated)
    first = [each for each in checked.findings if mistake.kinds and each.kind == mistake.kinds[0]]
    wrong = tuple(sorted({each.kind for each in checked.findings} - set(mistake.kinds)))
    truth = mistake.true(source.truth)
    before = after = np.nan
    words = ('-', '-')
    if calibrated:
        before, said = _errors(gyro, frames, stated, truth)
        words = (said, '-')
        if any(each.parameters or each.driver for each in checked.findings):
            gyro, frames = mended(gyro, frames, checked.findings)
            after, said = _errors(gyro, frames, proposed(stated, checked.findings), truth)
            words = (words[0], said)
    # The finding has the whole bias, not what was added.
    value = tuple((truth.bias / DEG_PER_HOUR).tolist()) if any(mistake.bias) else mistake.value
    return Judgement(checked, bool(first), wrong, _off(value, first), before, after, words)


def mended(gyro: GyroSamples, frames: Frames, findings: Iterable[Finding]) -> Messages:
    """Return messages as they would be of drivers that do what the findings say.

    What a parameter is proposed for is left to that.
    """
    for finding in findings:
        if finding.parameters:
            continue
        todo = finding.driver
        rate, uv, sigma = gyro.rate, frames.uv_raster, frames.sigma
        rate = rate * todo.get('rates_times', 1.0) @ np.array(
            todo.get('rates_matrix', np.eye(3))).T
        uv = uv + np.array(todo.get('centroids_plus_px', (0.0, 0.0)))
        sigma = sigma * todo.get('sigma_times', 1.0)
        stamp = frames.stamp_ns
        middle = (stamp[0] + stamp[-1]) // 2
        moved = 1e9 * todo.get('frame_stamps_plus_s', 0.0) + (stamp - middle) * todo.get(
            'frame_stamps_drift', 0.0)
        later = 1e9 * todo.get('gyro_stamps_plus_s', 0.0) + (gyro.stamp_ns - middle) * todo.get(
            'gyro_stamps_drift', 0.0)
        gyro = GyroSamples(gyro.stamp_ns + np.rint(later).astype(np.int64), rate)
        frames = replace(frames, stamp_ns=stamp + np.rint(moved).astype(np.int64), uv_raster=uv,
                         sigma=sigma)
    return gyro, frames


def _errors(gyro: GyroSamples, frames: Frames, scenario: Scenario, truth: Nominal
            ) -> tuple[float, str]:
    """Return the largest error of a calibrated state over its sigma, and the verdict."""
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    belief = calibrator.belief
    if belief is None:
        return np.nan, 'no attitude'
    estimate = belief.estimate
    # The attitude, and what is estimated beyond the 16 states, do not count.
    true = replace(truth, C_gi=estimate.C_gi, augmentation=estimate.augmentation,
                   augmented=estimate.augmented)
    error = estimate.minus(true)[:N_STATES] / SCALE
    sigma = np.linalg.norm(belief.root[:N_STATES], axis=-1)
    return float(np.abs(error / sigma)[CALIBRATED].max()), word(calibrator)


def _off(truth: tuple[float, ...], found: list[Finding]) -> float:
    """Return how far the last numbers of the first finding are from the truth."""
    if not truth or not found or not found[0].value:
        return np.nan
    value = np.array(found[0].value[-len(truth):])
    sigma = np.array(found[0].sigma[-len(truth):] or np.abs(truth))
    return float(np.abs((value - truth) / sigma).max())


# What is done to the messages


def rates(change: Callable[[Array], Array]) -> Spoil:
    """Return what changes all readings."""
    return lambda gyro, frames, rng: (GyroSamples(gyro.stamp_ns, change(gyro.rate)), frames)


def gyro_stamps(change: Callable[[Array], Array]) -> Spoil:
    """Return what moves the stamps of the gyro: by seconds, from the seconds since the first."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        since = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
        moved = np.rint(1e9 * change(since)).astype(np.int64)
        return GyroSamples(gyro.stamp_ns + moved, gyro.rate), frames
    return spoil


def frame_stamps(change: Callable[[Array], Array]) -> Spoil:
    """Return what moves the stamps of the frames, as `gyro_stamps`."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        since = (frames.stamp_ns - frames.stamp_ns[0]) * NS
        moved = np.rint(1e9 * change(since)).astype(np.int64)
        return gyro, replace(frames, stamp_ns=frames.stamp_ns + moved)
    return spoil


def centroids(change: Callable[[Array], Array]) -> Spoil:
    """Return what changes all centroids."""
    return lambda gyro, frames, rng: (gyro, replace(frames, uv_raster=change(frames.uv_raster)))


def numbers(change: Callable[[Ints, np.random.Generator], Ints]) -> Spoil:
    """Return what changes the catalogue numbers."""
    return lambda gyro, frames, rng: (gyro, replace(frames, catalog_id=change(
        frames.catalog_id, rng)))


def _period_s(gyro: GyroSamples) -> float:
    return float(np.median(np.diff(gyro.stamp_ns))) * NS


def noisy(arw_deg_sqrt_h: float) -> Spoil:
    """Return what adds an angular random walk to that of the gyros."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        more = np.sqrt(arw_deg_sqrt_h**2 - 1e-6)        # beside 0.001
        size = more * DEG_PER_SQRT_HOUR / np.sqrt(_period_s(gyro))
        return GyroSamples(gyro.stamp_ns, gyro.rate
                           + size * rng.standard_normal(gyro.rate.shape)), frames
    return spoil


def walking(deg_h_sqrt_h: float) -> Spoil:
    """Return what lets the bias walk, to end where it is."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        step = deg_h_sqrt_h * DEG_PER_HOUR * np.sqrt(_period_s(gyro) / 3600.0)
        walk = np.cumsum(step * rng.standard_normal(gyro.rate.shape), axis=0)
        return GyroSamples(gyro.stamp_ns, gyro.rate + walk - walk[-1]), frames
    return spoil


def scattered(more_px: float) -> Spoil:
    """Return what adds noise to the centroids."""
    return lambda gyro, frames, rng: (gyro, replace(
        frames, uv_raster=frames.uv_raster + more_px * rng.standard_normal(
            frames.uv_raster.shape)))


def _sigma(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    return gyro, replace(frames, sigma=np.full_like(frames.sigma, 0.1))


def _repeated(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    return GyroSamples(gyro.stamp_ns, np.repeat(gyro.rate[::2], 2, axis=0)[:len(gyro)]), frames


def _frozen(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    since = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
    stuck = (since > 100.0) & (since < 110.0)
    rate = np.where(stuck[:, None], gyro.rate[np.argmax(stuck)], gyro.rate)
    return GyroSamples(gyro.stamp_ns, rate), frames


def _bursts(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    last = np.minimum(np.arange(len(gyro)) // 10 * 10 + 9, len(gyro) - 1)
    return GyroSamples(gyro.stamp_ns[last] + np.arange(len(gyro)) % 10 * 20_000, gyro.rate), frames


def _arrived(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    late = np.rint(rng.exponential(4e6, len(gyro))).astype(np.int64)
    return GyroSamples(np.maximum.accumulate(gyro.stamp_ns + late)
                       + np.arange(len(gyro)), gyro.rate), frames


def _jittered(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    return gyro, replace(frames, stamp_ns=frames.stamp_ns + np.rint(
        3e6 * rng.standard_normal(len(frames))).astype(np.int64))


def _mixed(catalog_id: Ints, rng: np.random.Generator) -> Ints:
    wrong = rng.random(len(catalog_id)) < 0.1
    return np.where(wrong, rng.permutation(catalog_id), catalog_id)


def _both(change_ns: Callable[[int], int]) -> Spoil:
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        by = change_ns(int(gyro.stamp_ns[0]))
        return (GyroSamples(gyro.stamp_ns + by, gyro.rate),
                replace(frames, stamp_ns=frames.stamp_ns + by))
    return spoil


def _from_boot(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    return GyroSamples(gyro.stamp_ns - gyro.stamp_ns[0] + 10**10, gyro.rate), frames


# What is stated


def mounted(change: Callable[[Array], Array]) -> Callable[[Scenario], Mapping[str, Any]]:
    """Return what states another mounting."""
    return lambda scenario: {'mounting.quaternion_xyzw': tuple(rotation.to_quaternion(
        change(mounting_matrix(scenario.mounting))).tolist())}


def _w_first(scenario: Scenario) -> Mapping[str, Any]:
    x, y, z, w = scenario.mounting.quaternion_xyzw or (0.0, 0.0, 0.0, 1.0)
    return {'mounting.quaternion_xyzw': (w, x, y, z)}


def saying(**values: Any) -> Callable[[Scenario], Mapping[str, Any]]:
    """Return what states some parameters, their dots written as double underscores."""
    return lambda scenario: {key.replace('__', '.'): value for key, value in values.items()}


def _about(axis: int, deg: float) -> Array:
    return rotation.exp(np.radians(deg) * np.eye(3)[axis])


UNIT, MOUNTING, AXES = 'unit of the rates', 'mounting', 'axes of the gyro'
TIME, NOISE = 'time offset', 'centroid noise'
_DEG = float(np.degrees(1.0))
_MATRIX = np.array([[0.0, 3e-4, 0.0], [0.0, 0.0, -4e-4], [0.0, 0.0, 2e-4]])

ROWS = (
    Mistake('rates in deg/s', (UNIT,), rates(lambda r: r * _DEG), value=(_DEG,)),
    Mistake('rates converted from degrees twice', (UNIT,), rates(lambda r: r / _DEG),
            value=(1 / _DEG,)),
    Mistake('rates in deg/h', (UNIT,), rates(lambda r: r * _DEG * 3600.0),
            value=(_DEG * 3600.0,)),
    Mistake('rates in mrad/s', (UNIT,), rates(lambda r: r * 1e3), value=(1e3,)),
    Mistake('rates in rev/min', (UNIT,), rates(lambda r: r * 30.0 / np.pi),
            value=(30.0 / np.pi,)),
    Mistake('rates 1.5 times too large', (UNIT,), rates(lambda r: r * 1.5), value=(1.5,)),
    Mistake('mounting inverse', (MOUNTING,), stated=mounted(lambda C: C.T)),
    Mistake("mounting to ROS's optical frame", (MOUNTING,), stated=mounted(lambda C: C_os @ C)),
    Mistake('quaternion w first', (MOUNTING,), stated=_w_first),
    Mistake('mounting left out', (MOUNTING,), stated=mounted(lambda C: np.eye(3))),
    Mistake('mounting off by 2 deg about x', (MOUNTING,),
            stated=mounted(lambda C: _about(0, 2.0) @ C)),
    Mistake('mounting off by 60 deg about y', (MOUNTING,),
            stated=mounted(lambda C: _about(1, 60.0) @ C)),
    Mistake('mounting off by 90 deg about z', (MOUNTING,),
            stated=mounted(lambda C: _about(2, 90.0) @ C)),
    Mistake('gyro x and y swapped', (AXES,), rates(lambda r: r[:, [1, 0, 2]])),
    Mistake('gyro y and z swapped', (AXES,), rates(lambda r: r[:, [0, 2, 1]])),
    Mistake('gyro z reversed', (AXES,), rates(lambda r: r * [1.0, 1.0, -1.0])),
    Mistake('all gyros reversed', (AXES,), rates(lambda r: -r)),
    Mistake('gyros in the order y, z, x', (MOUNTING,), rates(lambda r: r[:, [1, 2, 0]]),
            axes=(2, 3, 1)),
    Mistake('gyro x and y reversed', (MOUNTING,), rates(lambda r: r * [-1.0, -1.0, 1.0]),
            axes=(-1, -2, 3)),
    Mistake('deg/s, and z reversed', (UNIT, AXES), rates(lambda r: r * [_DEG, _DEG, -_DEG])),
    Mistake('bias of 98, -20, 41 deg/h', ('bias',),
            rates(lambda r: r + np.array([98.0, -20.0, 41.0]) * DEG_PER_HOUR),
            bias=(98.0, -20.0, 41.0)),
    Mistake('bias of 1 deg/h about x', ('bias',),
            rates(lambda r: r + np.array([1.0, 0.0, 0.0]) * DEG_PER_HOUR), bias=(1.0, 0.0, 0.0)),
    Mistake('frames 5 ms early', (TIME,), frame_stamps(lambda s: -5e-3 + 0.0 * s), value=(5.0,)),
    Mistake('frames 2 ms late', (TIME,), frame_stamps(lambda s: 2e-3 + 0.0 * s), value=(-2.0,)),
    Mistake('frames 400 ms late', (TIME,), frame_stamps(lambda s: 0.4 + 0.0 * s),
            value=(-400.0,)),
    Mistake('frames 3 s late', (TIME,), frame_stamps(lambda s: 3.0 + 0.0 * s), value=(-3000.0,)),
    Mistake("frames stamped at the exposure's start", (TIME,),
            frame_stamps(lambda s: -0.09 + 0.0 * s), value=(90.0,)),
    Mistake("readings stamped at their interval's start", (TIME,),
            gyro_stamps(lambda s: -0.01 + 0.0 * s), value=(-10.0,)),
    Mistake('readings stamped in the middle', (TIME,), gyro_stamps(lambda s: -5e-3 + 0.0 * s),
            value=(-5.0,)),
    Mistake('gyro clock 20 ppm fast', ('drift of a clock',), gyro_stamps(lambda s: 20e-6 * s),
            value=(20.0,)),
    Mistake('gyro clock 200 ppm fast', ('drift of a clock',), gyro_stamps(lambda s: 200e-6 * s),
            value=(200.0,)),
    Mistake('frames step by 40 ms', ('step of a clock',),
            frame_stamps(lambda s: np.where(s > 0.55 * s[-1], 0.04, 0.0)), value=(-40.0,)),
    Mistake('frames jitter by 3 ms', ('scatter of the stamps',), _jittered, value=(3.0,)),
    Mistake('angular random walk 0.003', ('angular random walk',), noisy(3e-3), value=(3e-3,)),
    Mistake('angular random walk 0.01', ('angular random walk',), noisy(0.01), value=(0.01,)),
    Mistake('angular random walk 0.3', ('angular random walk', 'bias'), noisy(0.3),
            value=(0.3,)),
    Mistake('bias walks by 1 deg/h/sqrt(h)', ('random walk of the bias', 'bias'), walking(1.0),
            value=(1.0,)),
    Mistake('bias walks by 10 deg/h/sqrt(h)', ('random walk of the bias', 'bias'), walking(10.0),
            value=(10.0,)),
    Mistake('readings rounded to 2 deg/h', ('quantisation',),
            rates(lambda r: np.rint(r / 1e-5) * 1e-5)),
    Mistake('readings rounded to 20 deg/h', ('quantisation',),
            rates(lambda r: np.rint(r / 1e-4) * 1e-4)),
    Mistake('gyro scale 1000 ppm', ('gyro scale',), rates(lambda r: 1.001 * r), value=(1000.0,)),
    Mistake('gyro scale 100 ppm', ('gyro scale',), rates(lambda r: 1.0001 * r), value=(100.0,)),
    Mistake('misalignments of 300 ppm', ('gyro scale and misalignment',),
            rates(lambda r: r @ (np.eye(3) + _MATRIX).T)),
    Mistake('centroids scatter by 0.15 px', (NOISE,), scattered(float(np.sqrt(0.02))),
            value=(0.15,)),
    Mistake('messages state 0.1 px', (NOISE,), _sigma, value=(0.05,)),
    Mistake('pixel phase of 0.05 px', ('pixel phase',),
            centroids(lambda uv: uv - 0.05 * np.sin(2.0 * np.pi * uv)), value=(0.05,)),
    Mistake('centroids from the centre', ('centroids from the centre',),
            centroids(lambda uv: uv - 511.5)),
    Mistake('v counts upwards', ('mirrored image',),
            centroids(lambda uv: uv * [1.0, -1.0] + [0.0, 1023.0])),
    Mistake('u and v swapped', ('mirrored image',), centroids(lambda uv: uv[:, ::-1].copy())),
    Mistake('focal length of 16 mm stated', ('focal length', 'distortion'),
            stated=saying(camera__focal_length_mm=16.0), value=(25.6,)),
    Mistake('focal length of 50 mm stated', ('focal length', 'distortion'),
            stated=saying(camera__focal_length_mm=50.0), value=(25.6,)),
    Mistake('detector 1280 x 1024 stated', ('detector',), stated=saying(camera__width=1280),
            value=(1024.0, 1024.0)),
    Mistake('detector 640 x 480 stated', ('detector',),
            stated=saying(camera__width=640, camera__height=480), value=(1024.0, 1024.0)),
    Mistake('gyro.rate_hz 200', ('rate',), stated=saying(gyro__rate_hz=200.0), value=(100.0,)),
    Mistake('star_tracker.rate_hz 10', ('rate',), stated=saying(star_tracker__rate_hz=10.0),
            value=(2.0,)),
    Mistake('readings published twice', ('repeated readings',), _repeated),
    Mistake('readings frozen for 10 s', ('frozen',), _frozen),
    Mistake('readings all zero', ('all zero',), rates(lambda r: 0.0 * r)),
    Mistake('readings saturated at 0.4 deg/s', ('saturated',),
            rates(lambda r: np.clip(r, -0.4 / _DEG, 0.4 / _DEG))),
    Mistake('readings in bursts of ten', ('bursts',), _bursts),
    Mistake('readings stamped on arrival', ('irregular stamps',), _arrived),
    Mistake('gyro in TAI', ('clocks',), gyro_stamps(lambda s: 37.0 + 0.0 * s), value=(-37.0,)),
    Mistake('gyro in another time zone', ('clocks',), gyro_stamps(lambda s: 3600.0 + 0.0 * s),
            value=(-3600.0,)),
    Mistake('gyro stamped since boot', ('clocks',), _from_boot),
    Mistake('both stamped since boot', ('no UTC',), _both(lambda begin: 10**10 - begin)),
    Mistake('stars not identified', ('unidentified stars',),
            numbers(lambda ids, rng: 0 * ids)),
    Mistake('numbers of another catalogue', ('unknown numbers',),
            numbers(lambda ids, rng: ids + 200_000)),
    Mistake('10 % wrong numbers', ('wrong numbers',), numbers(_mixed), value=(0.1,)),
)
CLEAN = Mistake('nothing', ())

INSTRUMENTS: Mapping[str, Mapping[str, Any]] = {
    'as configured': {},
    'gyros of 0.1 deg/sqrt(h), 200 Hz': {
        'gyro.rate_hz': 200.0, 'gyro.arw_deg_sqrt_h': 0.1,
        'estimator.initial_sigma.gyro_bias_deg_h': 20.0,
        'truth.gyro.bias_deg_h': (12.0, -8.0, 15.0)},
    '1280 x 960, 16 mm, 4 Hz': {
        'camera.width': 1280, 'camera.height': 960, 'camera.pixel_pitch_mm': 0.00375,
        'camera.focal_length_mm': 16.0, 'truth.camera.focal_length_mm': 16.05,
        'star_tracker.rate_hz': 4.0, 'star_tracker.limiting_magnitude': 6.0},
    'narrow field, slow': {
        'camera.focal_length_mm': 60.0, 'truth.camera.focal_length_mm': 60.1,
        'star_tracker.limiting_magnitude': 7.5, 'star_tracker.rate_hz': 1.0,
        'gyro.rate_hz': 50.0, 'motion.rate_deg_s': 0.2,
        'motion.angles_deg': (10.0, 10.0, 10.0, -10.0, -10.0, -10.0)},
    'stars that trail': {
        'star_tracker.smear': True, 'star_tracker.exposure_s': 0.1, 'motion.rate_deg_s': 1.0}}
"""Instruments of which right recordings must give no finding."""
