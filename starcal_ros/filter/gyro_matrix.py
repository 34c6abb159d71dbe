# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Optional state: scale factors and misalignments of the gyros.

Model
-----
::

    omega_m = (I + M) omega + b + n

    omega  (3,)    rad/s  rate of g, in g; omega_m what the gyro reads
    M      (3, 3)  1      scale factors (diagonal) and misalignments: M_xy is what the x gyro sees
                          of a rate about y; row by row (xx, xy, xz, yx, ...)
    b, n   (3,)    rad/s  bias, noise

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

Preintegration composes ``omega_0 = G_0 (omega_m - b_0)``. With ``G = (I + M)^-1`` and
``d = G_0 (b - b_0)`` ::

    omega = G (omega_m - b) = omega_0 - d - N (omega_0 - d),     N = I - G G_0^-1
    Delta = Delta_0 exp([J_b d + J_N N x]),    J_N = J_M - J_b (I kron d')             (A.2)
    d omega = -G db - C_gs X C_sg omega,       dN = C_gs X C_sg G G_0^-1               (A.3)

This is exact in M and d but for the square of the correction over one interval, which
`error_state` bounds: G_0 = I does for half a second between two frames, for minutes without stars
the present G. To first order in M it would be wrong by M^2 of the whole turn: 2.7 arcsec after
30 deg for M of 5000 ppm.

X turns theta by ``X omega_s T`` in an interval T, of which the noise of the gyro is a part; on
average it adds b to the score of X, row by row (`rate_noise`) ::

    b = -q^2 T A' S^-1 A                                                               (A.7)

What information it feigns, one degree of freedom a frame, is of no account.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.filter.hypotheses import MISALIGNMENTS, SCALE_FACTORS
from starcal_ros.filter.optional_state import Drawn, OptionalState, Turned
from starcal_ros.filter.rate_noise import NoiseMoments

PPM = 1e-6


class GyroMatrix(OptionalState):
    """M, nine numbers."""

    key = 'gyro_matrix_sigma_ppm'
    names = tuple(f'M_{row}{column}_ppm' for row in 'xyz' for column in 'xyz')
    unit = PPM
    needs_matrix = True
    effects = (SCALE_FACTORS, MISALIGNMENTS)

    def error(self, values: Array, true: Array, C_sg: Array) -> Array:
        """Return X, (..., 9)."""
        ratio = self.gain(true) @ sensitivity(values)
        Y = 2.0 * (ratio - np.eye(3)) @ _inverse(ratio + np.eye(3))
        return _flat(C_sg @ Y @ np.swapaxes(C_sg, -1, -2))

    def freed(self, values: Array, error: Array, C_sg: Array) -> Array:
        """Return M freed of X, by (A.1)."""
        half = 0.5 * np.swapaxes(C_sg, -1, -2) @ _square(error) @ C_sg
        ratio = (np.eye(3) - half) @ _inverse(np.eye(3) + half)
        return _flat(sensitivity(values) @ ratio - np.eye(3))

    def outer(self, root: Array, values: Array, C_sg: Array) -> Array:
        """Return the rows (..., 9, n) with X taken to M, by (A.1)."""
        left = sensitivity(values) @ np.swapaxes(C_sg, -1, -2)
        by_X = np.einsum('...ik,...lj->...ijkl', left, C_sg)
        return by_X.reshape(*by_X.shape[:-4], 9, 9) @ root

    def gain(self, values: Array) -> Array:
        """Return G = (I + M)^-1, (..., 3, 3)."""
        return _inverse(sensitivity(values))

    def turned(self, J: Array, d: Array, values: Array, C_sg: Array, gain: Array) -> Turned:
        """Return what M changes in an interval, and the derivative by X (A.2, A.3)."""
        G = self.gain(values)
        ratio = G @ _inverse(gain)
        J_b, J_M = J[..., :3], J[..., 3:].reshape(*J.shape[:-1], 3, 3)
        J_N = J_M - J_b[..., None] * d[..., None, None, :]
        turn = np.einsum('...aij,...ij->...a', J_N, np.eye(3) - ratio)
        right = np.swapaxes(C_sg @ ratio, -1, -2)
        J_X = C_sg[..., None, :, :] @ J_N @ right[..., None, :, :]
        return Turned(turn, J_b @ G, _flat(J_X))

    def drawn(self, N: Array, T: Array, moments: NoiseMoments, values: Array) -> Drawn:
        """Return b of (A.7)."""
        b = -T[..., None] * _flat(N)
        return Drawn(b, np.zeros_like(b))

    def integrated(self, turn: Array) -> Array:
        """Return I kron turn', (n, 3, 9)."""
        return np.einsum('ia,nb->niab', np.eye(3), turn).reshape(len(turn), 3, 9)


def sensitivity(values: Array) -> Array:
    """Return I + M, (..., 3, 3), of the values (..., 9)."""
    return np.eye(3) + _square(values)


def _square(values: Array) -> Array:
    return values.reshape(*values.shape[:-1], 3, 3)


def _flat(M: Array) -> Array:
    return M.reshape(*M.shape[:-2], 9)


def _inverse(A: Array) -> Array:
    return np.linalg.inv(A).astype(np.float64)
