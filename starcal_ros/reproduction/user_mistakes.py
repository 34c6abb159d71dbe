# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes that users make, and what ``starcal check`` is to say of them.

Each row of `ROWS` spoils the messages of a recording, or what is stated of it, in one way
(`fault_injection`); `mistake_trial` tries a row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.filter.belief import Nominal
from starcal_ros.messages.conventions import C_os
from starcal_ros.reproduction.fault_injection import (Spoil, Statement, arrived, as_stated,
                                                      both_stamps, bursts, centroids, frame_stamps,
                                                      from_boot, frozen, gyro_stamps, jittered,
                                                      mixed, mounted, noisy, nothing, numbers,
                                                      rates, repeated, saying, scattered,
                                                      stated_sigma, w_first, walking)


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
    spoil: Spoil = nothing
    stated: Statement = as_stated
    value: tuple[float, ...] = ()
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[int, int, int] = (1, 2, 3)

    def true(self, before: Nominal) -> Nominal:
        """Return the truth behind the messages that are spoilt."""
        P = np.sign(self.axes)[:, None] * np.eye(3)[np.abs(self.axes) - 1]
        return replace(before, C_sg=before.C_sg @ P.T,
                       bias=P @ before.bias + np.array(self.bias) * DEG_PER_HOUR)


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
    Mistake('quaternion w first', (MOUNTING,), stated=w_first),
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
    Mistake('frames jitter by 3 ms', ('scatter of the stamps',), jittered, value=(3.0,)),
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
    Mistake('messages state 0.1 px', (NOISE,), stated_sigma, value=(0.05,)),
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
    Mistake('readings published twice', ('repeated readings',), repeated),
    Mistake('readings frozen for 10 s', ('frozen',), frozen),
    Mistake('readings all zero', ('all zero',), rates(lambda r: 0.0 * r)),
    Mistake('readings saturated at 0.4 deg/s', ('saturated',),
            rates(lambda r: np.clip(r, -0.4 / _DEG, 0.4 / _DEG))),
    Mistake('readings in bursts of ten', ('bursts',), bursts),
    Mistake('readings stamped on arrival', ('irregular stamps',), arrived),
    Mistake('gyro in TAI', ('clocks',), gyro_stamps(lambda s: 37.0 + 0.0 * s), value=(-37.0,)),
    Mistake('gyro in another time zone', ('clocks',), gyro_stamps(lambda s: 3600.0 + 0.0 * s),
            value=(-3600.0,)),
    Mistake('gyro stamped since boot', ('clocks',), from_boot),
    Mistake('both stamped since boot', ('no UTC',), both_stamps(lambda begin: 10**10 - begin)),
    Mistake('stars not identified', ('unidentified stars',),
            numbers(lambda ids, rng: 0 * ids)),
    Mistake('numbers of another catalogue', ('unknown numbers',),
            numbers(lambda ids, rng: ids + 200_000)),
    Mistake('10 % wrong numbers', ('wrong numbers',), numbers(mixed), value=(0.1,)),
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
