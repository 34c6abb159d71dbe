# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Instruments to begin a parameter file with: what their class has, and what is known of it.

Each states sigmas that its class can be relied on for before any data: a MEMS gyro switches on
with a bias that nobody knows to 0.1 deg/h. Numbers of the instrument itself are examples, to be
replaced by those of a data sheet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.config.shipped import config_file


@dataclass(frozen=True)
class Preset:
    """An instrument: one line of what it is, why its numbers are what they are, and these."""

    title: str
    text: str
    values: Mapping[str, Any]


def _sigmas(group: str, bias: float, angles: float, point: float, focal: float,
            *distortion: float) -> dict[str, float]:
    names = ('gyro_bias_deg_h', 'fixed_angles_arcsec', 'principal_point_px', 'focal_length_mm',
             'k1', 'k2', 'p1', 'p2')
    return {f'estimator.{group}.{name}': value
            for name, value in zip(names, (bias, angles, point, focal, *distortion))}


_NAVIGATION = Preset(
    'star tracker and navigation-grade gyros (Tan et al. 2018)',
    'The instrument of the paper, with its truth and its rotations: what tan2018.yaml holds.', {})

_FOG = Preset(
    'star tracker and tactical fibre-optic gyros, on a satellite',
    'Angular random walk and bias of a fibre-optic gyro of some 1 deg/h; a mounting that is known '
    'to a quarter of a degree after launch, a camera that was calibrated on the ground and has '
    'since been shaken and cooled. The velocity is that of the Earth: an orbit adds 5 arcsec of '
    'aberration, see observer.velocity.', {
        'camera.width': 2048, 'camera.height': 2048, 'camera.pixel_pitch_mm': 0.0055,
        'camera.focal_length_mm': 40.0, 'mounting.fixed_angles_deg': (0.0, 0.0, 0.0),
        'gyro.rate_hz': 100.0, 'gyro.arw_deg_sqrt_h': 0.02, 'gyro.largest_rate_deg_s': 200.0,
        'star_tracker.rate_hz': 4.0, 'star_tracker.exposure_s': 0.1,
        'star_tracker.centroid_sigma_px': 0.08, 'star_tracker.limiting_magnitude': 6.5,
        'observer.velocity': 'geocentre',
        **_sigmas('initial_sigma', 3.0, 900.0, 20.0, 0.2, 3e-4, 3e-6, 3e-5, 3e-5),
        **_sigmas('tolerance', 0.03, 10.0, 0.2, 1e-3, 2e-6, 5e-8, 1e-6, 1e-6),
        'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 0.02})

_MEMS = Preset(
    'MEMS gyros and a machine-vision camera, hand-mounted',
    'A MEMS gyro switches on with a bias of hundreds of deg/h, which then wanders by a few; its '
    'scale factors and axes are off by a part in a thousand, so they are estimated '
    '(augment.gyro_matrix_sigma_ppm), and the mounting can not be told from them by more than '
    '0.7 of their sigma. The focal length of a lens is the engraved one to a few per cent, the '
    'mounting is known to a degree or two.', {
        'camera.width': 1936, 'camera.height': 1216, 'camera.pixel_pitch_mm': 0.00586,
        'camera.focal_length_mm': 25.0, 'mounting.fixed_angles_deg': (0.0, 0.0, 0.0),
        'gyro.rate_hz': 200.0, 'gyro.arw_deg_sqrt_h': 0.15, 'gyro.largest_rate_deg_s': 400.0,
        'star_tracker.rate_hz': 2.0, 'star_tracker.exposure_s': 0.2,
        'star_tracker.centroid_sigma_px': 0.1, 'star_tracker.limiting_magnitude': 6.0,
        'observer.velocity': 'geocentre',
        **_sigmas('initial_sigma', 500.0, 5400.0, 40.0, 0.6, 5e-4, 5e-6, 1e-4, 1e-4),
        **_sigmas('tolerance', 2.0, 600.0, 1.0, 5e-3, 1e-5, 2e-7, 5e-6, 5e-6),
        'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 3.0,
        'estimator.augment.gyro_matrix_sigma_ppm': 3000.0})

_CUBESAT = Preset(
    'star camera of a CubeSat, with MEMS gyros',
    'A small lens before small pixels. Launch may shift the lens by some pixels and the mounting '
    'by some tenths of a degree. The gyro is estimated as of the preset mems. The orbit aberrates '
    'the stars by 5 arcsec: its five numbers are an example of a sun-synchronous one and must be '
    'replaced by yours.', {
        'camera.width': 2592, 'camera.height': 1944, 'camera.pixel_pitch_mm': 0.0022,
        'camera.focal_length_mm': 16.0, 'mounting.fixed_angles_deg': (0.0, 0.0, 0.0),
        'gyro.rate_hz': 50.0, 'gyro.arw_deg_sqrt_h': 0.15, 'gyro.largest_rate_deg_s': 400.0,
        'star_tracker.rate_hz': 2.0, 'star_tracker.exposure_s': 0.1,
        'star_tracker.centroid_sigma_px': 0.15, 'star_tracker.limiting_magnitude': 5.8,
        'observer.velocity': 'orbit', 'observer.altitude_km': 500.0,
        'observer.inclination_deg': 97.4, 'observer.raan_deg': 0.0,
        'observer.argument_of_latitude_deg': 0.0, 'observer.epoch_utc': '2026-07-01T00:00:00',
        **_sigmas('initial_sigma', 200.0, 1800.0, 30.0, 0.15, 1e-3, 3e-5, 1e-4, 1e-4),
        **_sigmas('tolerance', 2.0, 600.0, 1.0, 3e-3, 3e-5, 2e-6, 1e-5, 1e-5),
        'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 3.0,
        'estimator.augment.gyro_matrix_sigma_ppm': 3000.0})

_DSLR = Preset(
    'DSLR on a tripod: the camera alone, without gyros',
    'For starcal intrinsics and bootstrap, of frames in a recording; a folder of photographs '
    'needs no parameter file. The engraved focal length is good to a few per cent, the centre of '
    'the lens to a fraction of a millimetre. On a tripod the sky turns by 15 arcsec a second, '
    'which is what motion states; the groups of the gyro mean nothing.', {
        'camera.width': 6000, 'camera.height': 4000, 'camera.pixel_pitch_mm': 0.0039,
        'camera.focal_length_mm': 50.0, 'mounting.fixed_angles_deg': (0.0, 0.0, 0.0),
        'star_tracker.rate_hz': 0.1, 'star_tracker.exposure_s': 2.0,
        'star_tracker.centroid_sigma_px': 0.3, 'star_tracker.smear': False,
        'star_tracker.limiting_magnitude': 7.0,
        'motion.axes': ('y',), 'motion.angles_deg': (60.0,), 'motion.rate_deg_s': 0.0041781,
        'motion.acceleration_deg_s2': 0.01, 'motion.dwell_s': 0.0,
        'observer.velocity': 'geocentre',
        **_sigmas('initial_sigma', 0.1, 600.0, 100.0, 2.0, 3e-4, 5e-7, 2e-5, 2e-5),
        **_sigmas('tolerance', 0.05, 300.0, 2.0, 0.01, 2e-6, 1e-8, 1e-6, 1e-6),
        'intrinsics.method': 'bundle'})

PRESETS = {'t18': _NAVIGATION, 'fog': _FOG, 'mems': _MEMS, 'cubesat': _CUBESAT, 'dslr': _DSLR}
"""By the names that ``starcal config new`` takes."""


def scenario(name: str) -> Scenario:
    """Return the scenario of a preset.

    Raises
    ------
    ConfigError
        Where there is none of this name.
    """
    if name not in PRESETS:
        raise ConfigError(f'no preset {name!r}; there are {", ".join(PRESETS)}')
    if name == 't18':
        return parameter_file.load(config_file('tan2018.yaml'))
    return Scenario().replace(PRESETS[name].values)
