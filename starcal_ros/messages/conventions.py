# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The core's camera, frames and state in the conventions of ROS messages, and back.

No ROS here: plain numbers, for the nodes and for recordings written without rclpy. Centroids need
no turn: u and v count the same way on the detector in s and in o.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS, Detector
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.states import EPSILON, N_STATES, PSI, STATE_NAMES

INERTIAL_FRAME, GYRO_FRAME, OPTICAL_FRAME = 'icrf', 'gyro', 'star_tracker_optical'
CALIBRATED_FRAME, INTRINSICS_FRAME = (
    'star_tracker_calibrated_optical', 'star_tracker_intrinsics_optical')
"""The optical frame again, for the cameras that are calibrated: one CameraInfo a frame, since
viewers hang the image plane of a camera on its frame, as a frame with one parent."""
C_os = np.diag([-1.0, -1.0, 1.0])
"""T18's s, which projects with a minus sign, turned to REP-103's optical frame o."""

STATE_LAYOUT = (('stamp_s', 1),
                ('attitude_rotation_vector_rad[3] gyro_bias_rad_s[3] fixed_angles_rad[3] u0_px '
                 'v0_px f_mm k1_mm-2 k2_mm-4 p1_mm-1 p2_mm-1', N_STATES),
                (f'covariance of errors {",".join(STATE_NAMES)}', N_STATES * N_STATES))
"""Labels and sizes of the parts of `starcal/state`, one after the other."""
INTRINSICS_LAYOUT = (('stamp_s', 1), ('u0_px v0_px f_mm k1_mm-2 k2_mm-4 p1_mm-1 p2_mm-1', 7),
                     (f'covariance of errors {",".join(INTRINSICS)}', 49))
"""The same of `starcal/intrinsics/state`."""


class PlumbBob(NamedTuple):
    """The numbers of a sensor_msgs/CameraInfo of distortion model ``plumb_bob``."""

    K: list[float]
    D: list[float]
    P: list[float]


def camera_info(intrinsics: Array, detector: Detector) -> PlumbBob:
    """Return K (9), D (5) and P (12) of a camera; T18's p1 and p2 are OpenCV's p2 and p1."""
    u0, v0, f, k1, k2, p1, p2 = intrinsics.tolist()
    cu, cv = (detector.centre_raster + (u0, v0)).tolist()
    scale = f / detector.pitch_mm
    return PlumbBob([scale, 0.0, cu, 0.0, scale, cv, 0.0, 0.0, 1.0],
                    [k1 * f**2, k2 * f**4, p2 * f, p1 * f, 0.0],
                    [scale, 0.0, cu, 0.0, 0.0, scale, cv, 0.0, 0.0, 0.0, 1.0, 0.0])


def from_camera_info(K: Array, D: Array, detector: Detector) -> Array:
    """Return the intrinsics (7,) of a CameraInfo's K (9,) and D (5,), square pixels."""
    f = K[0] * detector.pitch_mm
    u0, v0 = np.array([K[2], K[5]]) - detector.centre_raster
    return np.array([u0, v0, f, D[0] / f**2, D[1] / f**4, D[3] / f, D[2] / f])


def optical_in_gyro(C_sg: Array) -> Array:
    """Return the orientation C_go of star_tracker_optical in gyro, from a mounting (3, 3)."""
    return (C_os @ C_sg).T


def mounting_from_optical(C_go: Array) -> Array:
    """Return the mounting C_sg, (3, 3), of an orientation of star_tracker_optical in gyro."""
    return C_os.T @ C_go.T


def bias_covariance(covariance: Array) -> Array:
    """Return the 6x6 twist covariance of the gyro bias, of a 16x16 state covariance."""
    twist = np.zeros((6, 6))
    twist[3:, 3:] = covariance[EPSILON, EPSILON]
    return twist


def mounting_covariance(C_sg: Array, covariance: Array) -> Array:
    """Return the 6x6 pose covariance, about the axes of gyro, of a 16x16 state covariance."""
    pose = np.zeros((6, 6))
    pose[3:, 3:] = C_sg.T @ covariance[PSI, PSI] @ C_sg
    return pose


def state_vector(stamp_ns: int, belief: Belief) -> Array:
    """Return the data of `starcal/state`, laid out as STATE_LAYOUT says."""
    estimate = belief.estimate
    return np.concatenate((
        [stamp_ns * 1e-9], rotation.log(estimate.C_gi.T), estimate.bias,
        rotation.to_fixed_angles(estimate.C_sg), estimate.intrinsics,
        belief.covariance.ravel()))
