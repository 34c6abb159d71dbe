# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The interstar equations of a pinhole camera as they are written, compiled: pair by pair.

What `interstar_complete` reduces to sums over stars, because arrays of all pairs would be large,
is a loop here, whose sums over the frames of a pair are vector instructions. With ``rho = 1 / r``
and ``c = w_i . w_j`` Eq. (I.1) and (I.2) of `interstar_equations` are, per unit of q_k ::

    WC  A_k = w_jk rho_i + w_ik rho_j           OC  A_k - c (w_ik rho_i + w_jk rho_j)

Importing this compiles what is not in numba's cache on disk yet: some seconds, once.
"""

from __future__ import annotations

from functools import partial
import sys
from typing import Any

import numba
import numpy as np

from starcal_ros.core.arrays import Array

# Sums over frames in any order, so that they are vector instructions.
_jit: Any = partial(numba.njit, cache=True, error_model='numpy',
                    fastmath={'reassoc', 'contract', 'nsz'})


@_jit
def _look(uv: Array, x: Array, pitch_mm: float, w: Array, along: Array, rho: Array) -> None:
    """Fill the directions w (3, NS, NF), w / r alike, and 1 / r (NS, NF) of spots (NF, NS, 2)."""
    for i in range(rho.shape[0]):
        for m in range(rho.shape[1]):
            a, b, f = (x[0] - uv[m, i, 0]) * pitch_mm, (x[1] - uv[m, i, 1]) * pitch_mm, x[2]
            per_mm = 1.0 / np.sqrt(a * a + b * b + f * f)
            rho[i, m] = per_mm
            w[0, i, m], w[1, i, m], w[2, i, m] = a * per_mm, b * per_mm, f * per_mm
            for k in range(3):
                along[k, i, m] = w[k, i, m] * per_mm


@_jit
def _pair(i: int, j: int, w: Array, along: Array, rho: Array, zero: float, held: bool,
          newton: bool, sums: Array) -> None:
    """Sum over the frames of a pair: c, A, M, A c and A M; c is counted from a zero.

    The 19 sums are variables of their own: as elements of an array they are not vectorised.
    """
    x_i, y_i, z_i, rho_i = w[0, i], w[1, i], w[2, i], rho[i]
    x_j, y_j, z_j, rho_j = w[0, j], w[1, j], w[2, j], rho[j]
    p_i, q_i, r_i = along[0, i], along[1, i], along[2, i]
    p_j, q_j, r_j = along[0, j], along[1, j], along[2, j]
    e = a0 = a1 = a2 = m0 = m1 = m2 = e0 = e1 = e2 = 0.0
    s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
    for m in range(rho_i.size):
        c = x_i[m] * x_j[m] + y_i[m] * y_j[m] + z_i[m] * z_j[m]
        A0 = x_j[m] * rho_i[m] + x_i[m] * rho_j[m]
        A1 = y_j[m] * rho_i[m] + y_i[m] * rho_j[m]
        A2 = z_j[m] * rho_i[m] + z_i[m] * rho_j[m]
        M0, M1, M2 = (A0 - c * (p_i[m] + p_j[m]), A1 - c * (q_i[m] + q_j[m]),
                      A2 - c * (r_i[m] + r_j[m]))
        if not held:
            A0, A1, A2 = M0, M1, M2
        if not newton:
            M0, M1, M2 = A0, A1, A2
        c -= zero
        e += c
        a0, a1, a2 = a0 + A0, a1 + A1, a2 + A2
        m0, m1, m2 = m0 + M0, m1 + M1, m2 + M2
        e0, e1, e2 = e0 + A0 * c, e1 + A1 * c, e2 + A2 * c
        s00, s01, s02 = s00 + A0 * M0, s01 + A0 * M1, s02 + A0 * M2
        s10, s11, s12 = s10 + A1 * M0, s11 + A1 * M1, s12 + A1 * M2
        s20, s21, s22 = s20 + A2 * M0, s21 + A2 * M1, s22 + A2 * M2
    sums[:] = (e, a0, a1, a2, m0, m1, m2, e0, e1, e2,
               s00, s01, s02, s10, s11, s12, s20, s21, s22)


@_jit('void(f8[:,:,:,::1], f8[:,::1], f8, b1, f8[:,:,::1], b1, b1, f8[:,::1], f8[:,:,::1])')
def _pinhole_equations(uv: Array, x: Array, pitch_mm: float, identified: bool, cosines: Array,
                       held: bool, newton: bool, value: Array, matrix: Array) -> None:
    rounds, frames, spots, _ = uv.shape
    w, along, rho = (np.empty((3, spots, frames)), np.empty((3, spots, frames)),
                     np.empty((spots, frames)))
    sums = np.empty(19)
    for r in range(rounds):
        _look(uv[r], x[r], pitch_mm, w, along, rho)
        for i in range(spots):
            for j in range(i + 1, spots):
                zero = cosines[r, i, j] if identified else (
                    w[0, i, 0] * w[0, j, 0] + w[1, i, 0] * w[1, j, 0] + w[2, i, 0] * w[2, j, 0])
                _pair(i, j, w, along, rho, zero, held, newton, sums)
                for k in range(3):
                    # Frames with one another: n times the centred sum, Eq. (I.3).
                    value[r, k] += (sums[7 + k] if identified else
                                    frames * sums[7 + k] - sums[1 + k] * sums[0])
                    for m in range(3):
                        matrix[r, k, m] += (
                            sums[10 + 3 * k + m] if identified else
                            frames * sums[10 + 3 * k + m] - sums[1 + k] * sums[4 + m])


if sum(_pinhole_equations.stats.cache_misses.values()):
    print('starcal_ros: compiling the self-calibration, once: some seconds', file=sys.stderr,
          flush=True)


def pinhole_equations(uv: Array, x: Array, pitch_mm: float, cosines: Array | None,
                      constrained: bool, newton: bool) -> tuple[Array, Array]:
    """Do as `interstar_complete.pinhole_equations`."""
    value, matrix = np.zeros(x.shape), np.zeros((*x.shape, 3))
    identified = cosines is not None
    _pinhole_equations(np.ascontiguousarray(uv), np.ascontiguousarray(x), pitch_mm, identified,
                       np.ascontiguousarray(cosines) if identified else np.empty((1, 1, 1)),
                       constrained, newton, value, matrix)
    unit = np.array([pitch_mm, pitch_mm, 1.0])
    return value * unit, matrix * unit * unit[:, None]
