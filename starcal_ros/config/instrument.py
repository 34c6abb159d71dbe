# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is stated of the instrument: camera, mounting, gyro, star tracker, motion, observer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from starcal_ros.config.parameter import Spec

Floats = tuple[float, ...]
Strings = tuple[str, ...]


@dataclass(frozen=True)
class CameraConfig:
    """Nominal camera: what is believed before the calibration."""

    width: Annotated[int, Spec('Width of the detector', 'px', 16, 65536)] = 1024
    height: Annotated[int, Spec('Height of the detector', 'px', 16, 65536)] = 1024
    pixel_pitch_mm: Annotated[float, Spec('Pixel pitch', 'mm', 1e-5, 1.0)] = 0.00645
    focal_length_mm: Annotated[float, Spec('Focal length', 'mm', 0.1, 1e5)] = 25.5
    principal_point_px: Annotated[Floats, Spec(
        'Principal point from the centre of the detector: u0, v0', 'px', -1e4, 1e4, 2)
    ] = (0.0, 0.0)
    distortion: Annotated[Floats, Spec(
        'Distortion k1, k2, p1, p2', 'mm^-2, mm^-4, mm^-1, mm^-1', -1.0, 1.0, 4)
    ] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MountingConfig:
    """Nominal rotation from the gyro axes to the star tracker, given in one of two ways."""

    fixed_angles_deg: Annotated[Floats | None, Spec(
        'Fixed angles x, y, z of C_sg = Rz(z) Ry(y) Rx(x)', 'deg', -360.0, 360.0, 3)] = None
    quaternion_xyzw: Annotated[Floats | None, Spec(
        'Quaternion of C_sg (g to s), in place of the fixed angles', '', -1.0, 1.0, 4)] = None


@dataclass(frozen=True)
class GyroConfig:
    """Gyro triad."""

    rate_hz: Annotated[float, Spec('Sampling rate', 'Hz', 1.0, 1e4)] = 100.0
    bias_deg_h: Annotated[Floats, Spec('Bias', 'deg/h', -1e6, 1e6, 3)] = (0.0, 0.0, 0.0)
    arw_deg_sqrt_h: Annotated[float, Spec(
        'Angular random walk', 'deg/sqrt(h)', 0.0, 100.0)] = 0.001
    largest_rate_deg_s: Annotated[float, Spec(
        'Largest rate about an axis that the gyro can read; a reading beyond is no measurement '
        'and is dropped', 'deg/s', 1e-3, 1e5)] = 2000.0


@dataclass(frozen=True)
class StarTrackerConfig:
    """Star tracker."""

    rate_hz: Annotated[float, Spec('Frame rate', 'Hz', 0.01, 1000.0)] = 2.0
    exposure_s: Annotated[float, Spec('Exposure', 's', 0.0, 10.0)] = 0.18
    centroid_sigma_px: Annotated[float, Spec(
        'Standard deviation of a centroid, each axis; in a recording that states its own sigma '
        'for a star, that one counts', 'px', 0.0, 100.0)] = 0.05
    smear: Annotated[bool, Spec(
        'Stars trail while the exposure lasts, and the sigma of a centroid is that of a star at '
        'rest: its noise grows along the trail; false where that sigma holds the trail already, '
        'as that of the centroid_extractor does; taken for false where the data deny it beyond '
        'doubt')] = True
    least_sigma_px: Annotated[float, Spec(
        'Least standard deviation of a centroid that a recording is believed, where '
        'centroid_sigma_px is not less', 'px', 0.0, 100.0)] = 0.005
    time_offset_s: Annotated[float, Spec(
        "Stamp of a frame minus the middle of its exposure in the gyro's time, as far as it is "
        'known: a positive stamp is late. Frames are taken at their stamp less this', 's',
        -10.0, 10.0)] = 0.0
    largest_sigma_px: Annotated[float, Spec(
        'Largest standard deviation that a recording may state of a centroid; a star with more is '
        'unusable', 'px', 1e-3, 1e3)] = 100.0
    margin: Annotated[float, Spec(
        'How far beyond the edge of the detector a centroid may lie, in halves of the detector; '
        'a star further out is unusable', '', 0.0, 10.0)] = 0.1
    limiting_magnitude: Annotated[float, Spec(
        'Faintest star that is measured, Hp', 'mag', -2.0, 14.0)] = 6.0


@dataclass(frozen=True)
class MotionConfig:
    """Rotations about the gyro axes, one after the other and then from the start again."""

    axes: Annotated[Strings, Spec(
        'Axis of each rotation, gyro frame', choices=('x', 'y', 'z'))] = (
            'x', 'y', 'z', 'z', 'y', 'x')
    angles_deg: Annotated[Floats, Spec('Angle of each rotation', 'deg', -360.0, 360.0)] = (
        30.0, 30.0, 30.0, -30.0, -30.0, -30.0)
    rate_deg_s: Annotated[float, Spec('Slew rate', 'deg/s', 1e-3, 100.0)] = 0.5
    acceleration_deg_s2: Annotated[float, Spec(
        'Angular acceleration at both ends of a slew', 'deg/s^2', 1e-3, 1e4)] = 0.5
    dwell_s: Annotated[float, Spec('Rest before each rotation', 's', 0.0, 1e5)] = 30.0
    initial_quaternion_xyzw: Annotated[Floats, Spec(
        'Attitude at the start: quaternion of C_ig (gyro in icrf)', '', -1.0, 1.0, 4)] = (
            0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class ObserverConfig:
    """Where the camera is and how fast it moves: parallax, stellar aberration, refraction."""

    velocity: Annotated[str, Spec(
        'Whose velocity aberrates the stars', choices=('barycentre', 'geocentre', 'orbit'))
    ] = 'geocentre'
    altitude_km: Annotated[float, Spec('Circular orbit: altitude', 'km', 100.0, 1e6)] = 500.0
    inclination_deg: Annotated[float, Spec(
        'Circular orbit: inclination', 'deg', 0.0, 180.0)] = 97.4
    raan_deg: Annotated[float, Spec(
        'Circular orbit: right ascension of the ascending node', 'deg', -360.0, 360.0)] = 0.0
    argument_of_latitude_deg: Annotated[float, Spec(
        'Circular orbit: argument of latitude at the epoch', 'deg', -360.0, 360.0)] = 0.0
    epoch_utc: Annotated[str, Spec('Circular orbit: epoch, ISO 8601')] = '2026-07-01T00:00:00'
    site_deg: Annotated[Floats | None, Spec(
        'On the ground: latitude and longitude, north and east; stars are then seen through the '
        'air, at the time of their stamps. Left out, there is no air', 'deg', -360.0, 360.0, 2)
    ] = None
    site_height_m: Annotated[float, Spec('Height of the site', 'm', -500.0, 50000.0)] = 0.0
    site_pressure_hpa: Annotated[float | None, Spec(
        'Pressure at the site; left out, that of the standard atmosphere', 'hPa', 0.0, 1200.0)
    ] = None
    site_temperature_c: Annotated[float | None, Spec(
        'Temperature at the site, likewise', 'deg C', -100.0, 60.0)] = None
