# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From parameters to the objects of the core: detector, camera, mounting, observer."""

from __future__ import annotations

import dataclasses

import numpy as np

from starcal_ros.config.estimator import EstimatorConfig, ProcessNoiseConfig, SigmaConfig
from starcal_ros.config.instrument import CameraConfig, MountingConfig, ObserverConfig
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.config.truth import TrueCameraConfig, TrueObserverConfig
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS, Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.distributions import chi2_ppf_of_two
from starcal_ros.sky.apparent import Observer
from starcal_ros.sky.refraction import Site

_KINDS = (3, 3, 2, 1, 1, 1, 1, 1)       # calibrated states of each kind that a SigmaConfig has


def detector(camera: CameraConfig) -> Detector:
    """Return the pixels of a camera."""
    return Detector(camera.width, camera.height, camera.pixel_pitch_mm)


def intrinsics(camera: CameraConfig, instead: TrueCameraConfig | None = None) -> Array:
    """Return the intrinsics, (7,); what `instead` states replaces the nominal values."""
    values = []
    for name in ('principal_point_px', 'focal_length_mm', 'distortion'):
        value = getattr(instead, name, None)
        values.append(getattr(camera, name) if value is None else value)
    return np.hstack(values).astype(float)


def mounting_matrix(mounting: MountingConfig) -> Array:
    """Return C_sg, (3, 3); the identity where the mounting is not stated."""
    if mounting.quaternion_xyzw is not None:
        q = np.array(mounting.quaternion_xyzw)
        return rotation.to_matrix(q / np.linalg.norm(q))
    return rotation.from_fixed_angles(np.radians(mounting.fixed_angles_deg or (0.0, 0.0, 0.0)))


def observer(config: ObserverConfig, instead: TrueObserverConfig | None = None) -> Observer:
    """Return who looks at the sky; what `instead` states replaces the nominal values."""
    values = {}
    for item in dataclasses.fields(config):
        value = getattr(instead, item.name, None)
        values[item.name] = getattr(config, item.name) if value is None else value
    at, height_m, pressure_hpa, temperature_c = (values.pop(f'site_{name}') for name in (
        'deg', 'height_m', 'pressure_hpa', 'temperature_c'))
    site = None if at is None else Site(at[0], at[1], height_m, pressure_hpa, temperature_c)
    return Observer(**values, site=site)


def nominal_camera(scenario: Scenario, known: CameraEstimate | None = None) -> CameraEstimate:
    """Return the camera that a method begins with: the nominal one and its initial sigmas.

    What is `known` from other frames stands in its place. Intrinsics that ``intrinsics.estimate``
    does not list are taken for certain.
    """
    if known is None:
        covariance = np.diag(of_intrinsics(scenario.estimator.initial_sigma)**2)
        known = CameraEstimate(intrinsics(scenario.camera), covariance, 0, 0)
    free = np.isin(INTRINSICS, scenario.intrinsics.estimate)
    covariance = np.where(np.outer(free, free), known.covariance, 0.0)
    return dataclasses.replace(known, covariance=covariance)


def own_focal_sigma_mm(scenario: Scenario) -> float:
    """Return by how much the focal length of a frame may be its own [mm]; 0 where none has one.

    Raises
    ------
    ConfigError
        Where the method has but one camera.
    """
    chosen = scenario.intrinsics
    if 'f' not in chosen.free:
        return 0.0
    if chosen.method != 'bundle' or 'f' not in chosen.estimate:
        raise ConfigError('intrinsics.free: got f, needs intrinsics.method bundle and f in '
                          'intrinsics.estimate')
    return scenario.estimator.initial_sigma.focal_length_mm


def with_camera(scenario: Scenario, values: Array) -> Scenario:
    """Return a scenario with other intrinsics, (7,), as its nominal ones."""
    u0, v0, f, *distortion = values.tolist()
    return scenario.replace({'camera.principal_point_px': (u0, v0), 'camera.focal_length_mm': f,
                             'camera.distortion': tuple(distortion)})


def of_intrinsics(config: SigmaConfig | ProcessNoiseConfig) -> Array:
    """Return what is stated for the intrinsics, (7,), in their units (and per root hour)."""
    return of_calibrated(config)[6:]


def of_calibrated(config: SigmaConfig | ProcessNoiseConfig) -> Array:
    """Return what is stated for the 13 calibrated states, in human units (and per root hour)."""
    return np.repeat(dataclasses.astuple(config), _KINDS)


def star_gate(estimator: EstimatorConfig) -> float:
    """Return the chi-square, two degrees of freedom, up to which a star passes the gate."""
    return chi2_ppf_of_two(estimator.gate_probability)


def true_time_offset_s(scenario: Scenario) -> float:
    """Return by how much the simulators stamp frames late [s]."""
    offset = scenario.truth.star_tracker.time_offset_s
    return scenario.star_tracker.time_offset_s if offset is None else offset
