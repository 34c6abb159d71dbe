# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Calibrated states that walk at random: what the filter adds to its covariance for it.

Model
-----
Bias, fixed angles and intrinsics each have a rate of change that is white, of density q (state per
root second), independent of each other. Over an interval of length T in which a constant bias
error epsilon would turn theta by ``B epsilon`` (`error_state`, ``B = C_s1g0 J``) ::

    epsilon += w(T)                      w     walk of density q_b from zero, w(T) = q_b sqrt(T) n1
    theta   += integral of dB w          = B (w(T) / 2 + q_b sqrt(T / 12) n2)              (N.1)
    Psi     += q_Psi sqrt(T) n3          theta, which holds Psi, by the same
    delta   += q sqrt(T) n4              n1 .. n4  independent, white, of unit variance

N.1 is the walk given its end: half of it on average, and a bridge about that with an integral of
variance q_b^2 T^3 / 12. At rest this is exact: q_b^2 T^3 / 3 of attitude and q_b^2 T^2 / 2 between
attitude and bias. While g turns it takes the mean direction of the interval for each of its parts,
which is wrong by a sixth of the turn at most: 0.07 % for 0.25 deg.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array

_COLUMNS = 16           # n1, n3, n4: one for each of the 13 states that walk; n2: three


def root(density: Array, B: Array, duration: Array, n_states: int) -> Array:
    """Return a root, (..., n_states, 16), of the covariance that the walks add.

    Parameters
    ----------
    density : (13,) array
        q of bias, fixed angles and intrinsics, per root second, in the filter's units.
    B : (..., 3, 3) array
        Derivative of theta by a constant bias error [s].
    duration : (...) array
        Length of the interval [s].
    n_states : int
        Rows: 16, or more, which do not walk.
    """
    steps = density * np.sqrt(duration)[..., None]
    columns = np.zeros((*steps.shape[:-1], n_states, _COLUMNS))
    columns[..., range(3, 16), range(13)] = steps
    bias = B * steps[..., None, :3]
    columns[..., :3, :3] = 0.5 * bias
    columns[..., :3, 13:] = bias / np.sqrt(12.0)
    columns[..., range(3), range(3, 6)] = steps[..., 3:6]
    return columns
