# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The group ``estimator``: the 16-state filter and its options."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from starcal_ros.config.parameter import Spec

Floats = tuple[float, ...]
Strings = tuple[str, ...]
_TINY = 1e-12
ADAPTABLE = ('star_tracker.centroid_sigma_px', 'gyro.arw_deg_sqrt_h',
             'estimator.process_noise.gyro_bias_deg_h_sqrt_h')
"""Noise levels that may be estimated."""


@dataclass(frozen=True)
class SigmaConfig:
    """One standard deviation for each kind of calibrated state."""

    gyro_bias_deg_h: Annotated[float, Spec('Gyro bias', 'deg/h', _TINY, 1e6)]
    fixed_angles_arcsec: Annotated[float, Spec('Fixed angles', 'arcsec', _TINY, 1e6)]
    principal_point_px: Annotated[float, Spec('Principal point', 'px', _TINY, 1e4)]
    focal_length_mm: Annotated[float, Spec('Focal length', 'mm', _TINY, 1e4)]
    k1: Annotated[float, Spec('Distortion k1', 'mm^-2', _TINY, 1e3)]
    k2: Annotated[float, Spec('Distortion k2', 'mm^-4', _TINY, 1e6)]
    p1: Annotated[float, Spec('Distortion p1', 'mm^-1', _TINY, 1e3)]
    p2: Annotated[float, Spec('Distortion p2', 'mm^-1', _TINY, 1e3)]


@dataclass(frozen=True)
class ProcessNoiseConfig:
    """How fast each kind of calibrated state walks at random; 0 is a state that stays."""

    gyro_bias_deg_h_sqrt_h: Annotated[float, Spec(
        'Random walk of the gyro bias', 'deg/h/sqrt(h)', 0.0, 1e6, changeable=True)] = 0.0
    fixed_angles_arcsec_sqrt_h: Annotated[float, Spec(
        'Random walk of the fixed angles', 'arcsec/sqrt(h)', 0.0, 1e6, changeable=True)] = 0.0
    principal_point_px_sqrt_h: Annotated[float, Spec(
        'Random walk of the principal point', 'px/sqrt(h)', 0.0, 1e4, changeable=True)] = 0.0
    focal_length_mm_sqrt_h: Annotated[float, Spec(
        'Random walk of the focal length', 'mm/sqrt(h)', 0.0, 1e4, changeable=True)] = 0.0
    k1_sqrt_h: Annotated[float, Spec(
        'Random walk of k1', 'mm^-2/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    k2_sqrt_h: Annotated[float, Spec(
        'Random walk of k2', 'mm^-4/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    p1_sqrt_h: Annotated[float, Spec(
        'Random walk of p1', 'mm^-1/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    p2_sqrt_h: Annotated[float, Spec(
        'Random walk of p2', 'mm^-1/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0


@dataclass(frozen=True)
class AugmentConfig:
    """States appended to the 16; what is left out is taken as zero and not estimated."""

    gyro_matrix_sigma_ppm: Annotated[float | None, Spec(
        'Initial sigma of each element of M, the scale factors (diagonal) and misalignments of '
        'the gyros: they read (I + M) omega + bias', 'ppm', _TINY, 1e4)] = None
    time_offset_sigma_s: Annotated[float | None, Spec(
        'Initial sigma of tau, the time offset of the star tracker: a frame stamped t shows the '
        'sky of t + tau', 's', _TINY, 1.0)] = None
    pixel_phase_sigma_px: Annotated[float | None, Spec(
        'Initial sigma of the amplitudes of sine and cosine, along u and v, by which centroids '
        'depend on where in a pixel a star falls', 'px', _TINY, 1.0)] = None


@dataclass(frozen=True)
class InitialSigmaConfig(SigmaConfig):
    """How well each kind of calibrated state is known before the data, one standard deviation."""


@dataclass(frozen=True)
class ToleranceConfig(SigmaConfig):
    """How small a standard deviation must be before a state counts as known."""


def _initial_sigma() -> InitialSigmaConfig:
    return InitialSigmaConfig(
        gyro_bias_deg_h=0.1, fixed_angles_arcsec=600.0, principal_point_px=20.0,
        focal_length_mm=0.2, k1=1e-3, k2=1e-5, p1=1e-4, p2=1e-4)


def _tolerance() -> ToleranceConfig:
    return ToleranceConfig(
        gyro_bias_deg_h=2e-3, fixed_angles_arcsec=5.0, principal_point_px=0.1,
        focal_length_mm=2e-4, k1=2e-6, k2=2e-7, p1=1e-6, p2=1e-6)


@dataclass(frozen=True)
class EstimatorConfig:
    """The 16-state filter."""

    initial_sigma: InitialSigmaConfig = field(default_factory=_initial_sigma)
    tolerance: ToleranceConfig = field(default_factory=_tolerance)
    process_noise: ProcessNoiseConfig = field(default_factory=ProcessNoiseConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    feedback: Annotated[bool, Spec(
        'Correct the nominal values after each frame; false is the open-loop filter of the '
        'paper')] = True
    gate_probability: Annotated[float, Spec(
        'Probability with which a good star passes the chi-square gate', '', 0.5, 1.0,
        changeable=True)] = 0.9999
    reacquire_after_frames: Annotated[int, Spec(
        'Frames in a row, most of their stars rejected, before the attitude is found afresh',
        '', 1, 1000, changeable=True)] = 5
    answer_changes: Annotated[bool, Spec(
        'Where a step or a drift of bias, mounting or camera is seen, open its covariance and go '
        'on; false lets the calibration be inconsistent', changeable=True)] = True
    adapt: Annotated[Strings, Spec(
        'Noise levels that are estimated from the data, in place of the stated ones',
        choices=ADAPTABLE)] = ()
    earliest_utc: Annotated[str, Spec(
        'Earliest stamp that a sensor may give, ISO 8601; a message stamped before it is dropped: '
        'its clock counts from somewhere else than UTC')] = '2000-01-01T00:00:00'
    latest_utc: Annotated[str, Spec(
        'Latest stamp that a sensor may give, ISO 8601; a message stamped after it is dropped')
    ] = '2100-01-01T00:00:00'
    leap_periods: Annotated[float, Spec(
        'Periods of its topic by which a stamp may be ahead of the one before it; a message '
        'further ahead waits until the next confirms it, else it is dropped', '', 1.5, 1e6)] = 5.0
    gap_acceleration_deg_s2: Annotated[float, Spec(
        'Angular acceleration that may hide in a silence of the gyro', 'deg/s^2', 0.0, 1e4,
        changeable=True)] = 1.0
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that each result topic must have before the sensors are listened to', '', 0,
        100)] = 0
    wait_for_nodes: Annotated[Strings, Spec(
        'Nodes, by name, that must subscribe to each result topic before the sensors are listened '
        'to; no other subscriber stands in for them')] = ()
    calibration_directory: Annotated[str, Spec(
        'Where the service save_calibration puts calibrations, in a numbered folder each; in a '
        'namespace, in its folder there')] = 'calibrations'
    load_calibration: Annotated[bool, Spec(
        'Start from the newest calibration there, values and covariance, if there is one')] = False
