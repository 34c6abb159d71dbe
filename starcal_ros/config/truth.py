# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameter group ``truth``: the true values, and the errors that no estimator models.

Two kinds of parameter. One that may be left out (``| None``) stands in place of the nominal value
of the same name. The others are errors, each off by default; its text says what it does, and the
module of ``simulation/`` named with it says how.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from starcal_ros.config.instrument import MountingConfig
from starcal_ros.config.parameter import Spec

Floats = tuple[float, ...]


@dataclass(frozen=True)
class TrueCameraConfig:
    """The camera that the simulators use; what is left out is as the nominal camera."""

    focal_length_mm: Annotated[float | None, Spec('Focal length', 'mm', 0.1, 1e5)] = None
    principal_point_px: Annotated[Floats | None, Spec(
        'Principal point u0, v0', 'px', -1e4, 1e4, 2)] = None
    distortion: Annotated[Floats | None, Spec(
        'Distortion k1, k2, p1, p2', 'mm^-2, mm^-4, mm^-1, mm^-1', -1.0, 1.0, 4)] = None


@dataclass(frozen=True)
class MountingDriftConfig:
    """How the mounting wanders about the true one (`mounting_drift`)."""

    sigma_arcsec: Annotated[float, Spec(
        'Standard deviation of the drift about each axis of the star tracker, 0 is off',
        'arcsec', 0.0, 3600.0)] = 0.0
    time_constant_s: Annotated[float, Spec(
        'Time constant of the drift, a first-order Gauss-Markov process', 's', 10.0, 1e7)
    ] = 3600.0


@dataclass(frozen=True)
class TrueGyroConfig:
    """The gyro that the simulators use."""

    bias_deg_h: Annotated[Floats | None, Spec(
        'Bias at the start of the run', 'deg/h', -1e6, 1e6, 3)] = None
    arw_deg_sqrt_h: Annotated[float | None, Spec(
        'Angular random walk', 'deg/sqrt(h)', 0.0, 100.0)] = None
    scale_factor_ppm: Annotated[Floats, Spec(
        'Scale factor error of the x, y, z gyro (gyro_scale)', 'ppm', -1e5, 1e5, 3)
    ] = (0.0, 0.0, 0.0)
    misalignment_arcsec: Annotated[Floats, Spec(
        'Misalignment xy, xz, yx, yz, zx, zy, where xy is what the x gyro sees of a rate about y '
        '(gyro_scale)', 'arcsec', -2e4, 2e4, 6)] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bias_random_walk_deg_h_sqrt_h: Annotated[float, Spec(
        'Random walk of the bias of each gyro, 0 is off (bias_walk)', 'deg/h/sqrt(h)', 0.0, 1e6)
    ] = 0.0


@dataclass(frozen=True)
class TrueStarTrackerConfig:
    """The star tracker that the simulators use."""

    centroid_sigma_px: Annotated[float | None, Spec(
        'Standard deviation of a centroid, each axis; the messages state the nominal one',
        'px', 0.0, 100.0)] = None
    time_offset_s: Annotated[float, Spec(
        "Stamp of a frame minus the middle of its exposure in the gyro's time: a positive stamp "
        'is late', 's', -10.0, 10.0)] = 0.0
    smear: Annotated[bool, Spec(
        'Stars trail while the exposure lasts: a centroid is the mean of the moving image, and '
        'its noise grows along the trail (smear)')] = False
    misidentified_fraction: Annotated[float, Spec(
        "Part of the stars that get their nearest neighbour's number (misidentification)",
        '', 0.0, 1.0)] = 0.0
    hot_pixels_per_frame: Annotated[int, Spec(
        'False spots in each frame, always at the same places (hot_pixels)', '', 0, 200)] = 0


@dataclass(frozen=True)
class TrueObserverConfig:
    """Who looks at the sky in truth; what is left out is as the nominal observer."""

    velocity: Annotated[str | None, Spec(
        'Whose velocity aberrates the stars', choices=('barycentre', 'geocentre', 'orbit'))
    ] = None
    altitude_km: Annotated[float | None, Spec(
        'Circular orbit: altitude', 'km', 100.0, 1e6)] = None
    inclination_deg: Annotated[float | None, Spec(
        'Circular orbit: inclination', 'deg', 0.0, 180.0)] = None
    raan_deg: Annotated[float | None, Spec(
        'Circular orbit: right ascension of the ascending node', 'deg', -360.0, 360.0)] = None
    argument_of_latitude_deg: Annotated[float | None, Spec(
        'Circular orbit: argument of latitude at the epoch', 'deg', -360.0, 360.0)] = None
    epoch_utc: Annotated[str | None, Spec('Circular orbit: epoch, ISO 8601')] = None


@dataclass(frozen=True)
class TruthConfig:
    """What the simulators use in place of the nominal values, and the errors they add."""

    camera: TrueCameraConfig = field(default_factory=TrueCameraConfig)
    mounting: MountingConfig = field(default_factory=MountingConfig)
    mounting_drift: MountingDriftConfig = field(default_factory=MountingDriftConfig)
    gyro: TrueGyroConfig = field(default_factory=TrueGyroConfig)
    star_tracker: TrueStarTrackerConfig = field(default_factory=TrueStarTrackerConfig)
    observer: TrueObserverConfig = field(default_factory=TrueObserverConfig)
