# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The optional states of the filter: their true values, and what the sensors tell of them.

The slopes come from the equations of the simulated sensors, by differences; nothing of the
filter's Jacobians is repeated here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import camera, pixel_phase, rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.optional_state import OptionalState
from starcal_ros.simulation.truth import Truth

_RATE_NS = 500_000      # to each side, of the difference that is the rate of g
_OFFSET_NS = 1_000_000  # likewise, of the image by the time offset


class Evaluated(NamedTuple):
    """What is known of an optional state of k numbers.

    Attributes
    ----------
    true : callable
        Of the truth: the true values (k,), in the filter's units.
    turning : callable, optional
        Of the truth and stamps (n,): derivative of the rate of phi, in i, by an error of the
        values, (n, 3, k) [rad/s].
    imaged : callable, optional
        Of the truth, the middles (n,) of exposures and the places (n, 3) of a star in each:
        derivative of its image by an error of the values, (n, 2, k) [px].
    """

    true: Callable[[Truth], Array]
    turning: Callable[[Truth, Ints], Array] | None = None
    imaged: Callable[[Truth, Ints, Array], Array] | None = None


def true_values(augmentation: Augmentation, truth: Truth) -> Array:
    """Return the true values of the optional states that are on, (m,), in the filter's units."""
    return np.concatenate([np.empty(0), *(of(state).true(truth) for state in augmentation.on)])


def of(state: OptionalState) -> Evaluated:
    """Return what is known of a state.

    Raises
    ------
    ConfigError
        Where it has no entry in `EVALUATED`.
    """
    if state.key not in EVALUATED:
        raise ConfigError(f'estimator.augment.{state.key}: can not be judged without an entry in '
                          f'EVALUATED of {__name__}')
    return EVALUATED[state.key]


def _matrix_turning(truth: Truth, stamps_ns: Ints) -> Array:
    """Return ``C_ig G (I kron omega')``: readings of (I + M) omega taken for those of M + dM."""
    C_ig = truth.motion.attitude(stamps_ns)
    before, after = (truth.motion.attitude(stamps_ns + step) for step in (-_RATE_NS, _RATE_NS))
    omega = rotation.log(np.swapaxes(before, -1, -2) @ after) / (2 * _RATE_NS * NS)
    turning = (C_ig @ gain(truth))[..., None] * omega[:, None, None, :]
    return turning.reshape(-1, 3, 9)


def _offset_imaged(truth: Truth, middle_ns: Ints, u_i: Array) -> Array:
    """Return how the image moves with the moment at which it is taken."""
    C_sg = truth.mounting_at(middle_ns)

    def image(step_ns: int) -> Array:
        C_si = C_sg @ np.swapaxes(truth.motion.attitude(middle_ns + step_ns), -1, -2)
        return camera.project((C_si @ u_i[..., None])[..., 0], truth.intrinsics,
                              truth.detector.pitch_mm)

    moved = image(_OFFSET_NS) - image(-_OFFSET_NS)
    return moved[..., None] / (2 * _OFFSET_NS * NS)


def _phase_imaged(truth: Truth, middle_ns: Ints, u_i: Array) -> Array:
    """Return how the image moves with the amplitudes of the pixel phase."""
    C_si = truth.mounting_at(middle_ns) @ np.swapaxes(truth.motion.attitude(middle_ns), -1, -2)
    uv = camera.project((C_si @ u_i[..., None])[..., 0], truth.intrinsics, truth.detector.pitch_mm)
    return pixel_phase.waves(uv + truth.detector.centre_raster)


def gain(truth: Truth) -> Array:
    """Return G = (I + M)^-1, (3, 3): the rate of g is G (reading - bias)."""
    return np.linalg.inv(np.eye(3) + truth.gyro_matrix).astype(np.float64)


EVALUATED = {
    'gyro_matrix_sigma_ppm': Evaluated(lambda truth: truth.gyro_matrix.ravel(),
                                       turning=_matrix_turning),
    # A frame taken at t shows the sky of t + tau.
    'time_offset_sigma_s': Evaluated(lambda truth: np.array([-truth.unknown_offset]),
                                     imaged=_offset_imaged),
    # The simulated centroids have none.
    'pixel_phase_sigma_px': Evaluated(lambda truth: np.zeros(4), imaged=_phase_imaged),
}
"""By the `key` of the state."""
