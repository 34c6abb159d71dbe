# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""States that may be appended to the 16: what T18's gyros and clocks are free of.

Model
-----
::

    omega_m = (I + M) omega + b + n            C_gi of a frame stamped t = C_gi(t + tau)

    omega  (3,)    rad/s  rate of g, in g; omega_m what the gyro reads
    M      (3, 3)  1      scale factors (diagonal) and misalignments: M_xy is what the x gyro sees
                          of a rate about y
    b, n   (3,)    rad/s  bias, noise
    tau            s      a frame stamped t shows the sky of t + tau; positive: stamped early

The values stand in one vector (..., m), m = 0, 1, 9 or 10: M row by row (xx, xy, xz, yx, ...)
where it is a state, then tau where it is one. Their errors, estimate minus truth, follow the 16.

A turn of g against the three gyros and the star tracker changes nothing that is measured: the
antisymmetric part of M can not be told from the fixed angles, and the initial sigmas alone divide
the one from the other. The scale factors and the symmetric part are measured once the motion has
turned about all three axes.

Inside the filter the error of M is X, (3, 3), in s ::

    I + M_est = (I + M) (I - Y/2)^-1 (I + Y/2),    Y = C_gs X C_sg,    d M = (I + M) Y    (A.1)

so that what can not be seen, ``Psi = -sigma, X = -[sigma x]``, stays one and the same direction
however the estimate moves, and a correction along it is a turn: Cayley's form is exp(Y) to second
order, and undone exactly. What a rotation about one axis does not show of M still moves with the
estimate, by M: for M of 1000 ppm that can not be noticed, for 5000 ppm and fixed angles off by
600 arcsec the sigmas of a run are a fifth too small.

Gyro
----
`preintegration` composes for a bias b0 and no M. With ``G = (I + M)^-1`` and ``d = b - b0`` ::

    omega = G (omega_m - b) = (omega_m - b0) - d - N (omega_m - b0 - d),     N = I - G
    Delta = Delta_0 exp([J_b d + J_N N x]),    J_N = J_M - J_b (I kron d')             (A.2)
    d omega = -G db - C_gs X C_sg omega,       dN = C_gs X C_sg G                      (A.3)

This is exact in M and d but for the square of the correction over one interval: (M turn)^2, for M
of 5000 ppm and the 0.25 deg of half a second at 0.5 deg/s 1e-4 arcsec. To first order in M it
would be wrong by M^2 of the whole turn: 2.7 arcsec after 30 deg.

Time offset
-----------
With the rate omega_s, in s, of the gyro at the frame's stamp ::

    r_s = exp(-[omega_s tau x]) C_sg C_gi r_i,    d r_s / d tau = -omega_s x r_s       (A.4)

The rate is taken as constant over tau: at an angular acceleration alpha that misses
alpha tau^2 / 2, 0.4 arcsec for 0.5 deg/s^2 and 20 ms. The derivatives of omega_s by b, Psi and M
are left out: each is the part omega tau, 1e-4 for 0.5 deg/s and 10 ms, of what the same state does
over an interval.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.config.estimator import AugmentConfig
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array

N_MATRIX = 9
PPM = 1e-6
SCALE = np.full(N_MATRIX + 1, 1e-5)
"""What the filter divides these states by: a few are as good for M as for tau."""

_MATRIX_NAMES = tuple(f'M_{row}{column}_ppm' for row in 'xyz' for column in 'xyz')


def initial_sigma(config: AugmentConfig) -> Array:
    """Return the first standard deviations, (m,), of the states that are on [1, s]."""
    matrix, offset = config.gyro_matrix_sigma_ppm, config.time_offset_sigma_s
    return np.array([*(() if matrix is None else (matrix * PPM,) * N_MATRIX),
                     *(() if offset is None else (offset,))])


def has_matrix(m: int) -> bool:
    """Tell whether M is among m states."""
    return m >= N_MATRIX


def has_offset(m: int) -> bool:
    """Tell whether tau is among m states; it is the last of them."""
    return m % N_MATRIX == 1


def names(m: int) -> tuple[str, ...]:
    """Return the names of m states, each with its human unit."""
    return _MATRIX_NAMES * has_matrix(m) + ('tau_s',) * has_offset(m)


def units(m: int) -> Array:
    """Return the human unit of each of m states, (m,), in the unit that the filter counts in."""
    return np.array([PPM] * (N_MATRIX * has_matrix(m)) + [1.0] * has_offset(m))


def matrix(values: Array) -> Array:
    """Return I + M, (..., 3, 3), of values (..., m); the identity where M is no state."""
    if not has_matrix(values.shape[-1]):
        return np.eye(3)
    return np.eye(3) + _square(values)


def gain(values: Array) -> Array:
    """Return G = (I + M)^-1, (..., 3, 3); the identity where M is no state."""
    return _inverse(matrix(values)) if has_matrix(values.shape[-1]) else np.eye(3)


def error(values: Array, true: Array, C_sg: Array) -> Array:
    """Return the error (..., m) of values, that of M as X (A.1); C_sg is the estimate's."""
    difference: Array = values - true
    if has_matrix(values.shape[-1]):
        ratio = gain(true) @ matrix(values)
        Y = 2.0 * (ratio - np.eye(3)) @ _inverse(ratio + np.eye(3))
        difference[..., :N_MATRIX] = _flat(C_sg @ Y @ np.swapaxes(C_sg, -1, -2))
    return difference


def freed(values: Array, error_: Array, C_sg: Array) -> Array:
    """Return the values freed of an error (..., m): undoes `error`."""
    better: Array = values - error_
    if has_matrix(values.shape[-1]):
        half = 0.5 * np.swapaxes(C_sg, -1, -2) @ _square(error_) @ C_sg
        ratio = (np.eye(3) - half) @ _inverse(np.eye(3) + half)
        better[..., :N_MATRIX] = _flat(matrix(values) @ ratio - np.eye(3))
    return better


def outer(root: Array, values: Array, C_sg: Array) -> Array:
    """Return the rows (..., m, n) of a root of the covariance with X taken to M (A.1)."""
    if not has_matrix(values.shape[-1]):
        return root
    left = matrix(values) @ np.swapaxes(C_sg, -1, -2)
    by_X = np.einsum('...ik,...lj->...ijkl', left, C_sg)
    by_X = by_X.reshape(*by_X.shape[:-4], N_MATRIX, N_MATRIX)
    return np.concatenate(
        (by_X @ root[..., :N_MATRIX, :], root[..., N_MATRIX:, :]), axis=-2)


def relinearized(J: Array, d: Array, values: Array, C_sg: Array) -> tuple[Array, Array]:
    """Return what the present bias and M change in a preintegrated turn (A.2, A.3).

    Parameters
    ----------
    J : (..., 3, 3) or (..., 3, 12) array
        Derivatives by the bias [s] and, where M is a state, by M, at b0 and no M.
    d : (..., 3) array
        Present bias less b0 [rad/s].
    values : (..., m) array
        Present values of the augmented states.
    C_sg : (..., 3, 3) array
        Mounting.

    Returns
    -------
    turn : (..., 3) array
        The argument of the second factor of Delta [rad].
    J : as J
        Derivatives by the bias and by X at the present values.
    """
    turn = (J[..., :3] @ d[..., None])[..., 0]
    if J.shape[-1] == 3:
        return turn, J
    G = gain(values)
    J_b, J_M = J[..., :3], J[..., 3:].reshape(*J.shape[:-1], 3, 3)
    J_N = J_M - J_b[..., None] * d[..., None, None, :]
    turn = turn + np.einsum('...aij,...ij->...a', J_N, np.eye(3) - G)
    right = np.swapaxes(C_sg @ G, -1, -2)
    J_X = C_sg[..., None, :, :] @ J_N @ right[..., None, :, :]
    return turn, np.concatenate((J_b @ G, _flat(J_X)), axis=-1)


def shift(values: Array, C_sg: Array, rate_g: Array) -> tuple[Array, Array]:
    """Return the rate at a frame's stamp and what the time offset turns a frame by (A.4).

    Parameters
    ----------
    values : (..., m) array
        Present values of the augmented states.
    C_sg : (..., 3, 3) array
        Mounting.
    rate_g : (..., 3) array
        The gyro's reading at the stamp, less bias [rad/s].

    Returns
    -------
    omega_s : (..., 3) array
        Rate of g, in s [rad/s].
    C : (..., 3, 3) array
        exp(-[omega_s tau x]).
    """
    omega_s = (C_sg @ gain(values) @ rate_g[..., None])[..., 0]
    return omega_s, rotation.exp(-values[..., -1:] * omega_s)


def _square(values: Array) -> Array:
    return values[..., :N_MATRIX].reshape(*values.shape[:-1], 3, 3)


def _flat(M: Array) -> Array:
    return M.reshape(*M.shape[:-2], N_MATRIX)


def _inverse(A: Array) -> Array:
    return np.linalg.inv(A).astype(np.float64)
