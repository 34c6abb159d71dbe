# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The group ``intrinsics``: calibration of the camera alone, without an attitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from starcal_ros.config.parameter import Spec
from starcal_ros.core.camera import INTRINSICS


@dataclass(frozen=True)
class IntrinsicsConfig:
    """How ``starcal intrinsics`` and the node ``intrinsics_estimator`` work.

    They begin at the nominal camera, with ``estimator.initial_sigma``.
    """

    method: Annotated[str, Spec(
        'Calibration method: a file of starcal_ros/calibration/methods')
    ] = 'angular_distance'
    estimate: Annotated[tuple[str, ...], Spec(
        'Intrinsics to estimate; the others stay at their nominal values',
        choices=INTRINSICS)] = INTRINSICS
    free: Annotated[tuple[str, ...], Spec(
        'Of bundle, with identified stars: what each frame has for itself, such as the focal '
        'length behind an autofocus; the estimate is their mean', choices=('f',))] = ()
    weighting: Annotated[str, Spec(
        'Weights of angular_distance and singular_value: full counts the correlations of the '
        'residuals of one frame, diagonal does not (the paper)', choices=('full', 'diagonal'))
    ] = 'full'
    combination_model: Annotated[int, Spec(
        'Star combination model of singular_value (Wu et al. 2019, Sec. 3.3.2)', '', 1, 4)] = 4
    singular_values: Annotated[tuple[int, ...], Spec(
        'Singular values that singular_value uses, 1 the largest', '', 1, 3)] = (2, 3)
    interstar_equations: Annotated[str, Spec(
        'Equations of interstar: traditional (T, identified stars) or self-calibration (S), '
        'without (O) or with (W) the constraint of the optical path (S24). SCOC is freed of its '
        'bias, and the only one that estimates distortion from unidentified spots',
        choices=('TCOC', 'TCWC', 'SCOC', 'SCWC'))] = 'SCOC'
