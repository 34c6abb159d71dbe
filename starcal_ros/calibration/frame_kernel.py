# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of a frame without an attitude, compiled, for one run at a time.

What numpy does in `invariants`, `attitude_free` and `methods.singular_value`, where the equations
stand, for any number of runs.

Importing this compiles what is not in numba's cache on disk yet: some ten seconds, once.
"""

from __future__ import annotations

import sys

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.compiled import ready
from starcal_ros.core.compiled_parts import (diagonalized, factored, jit as _jit, multiplied,
                                             projected, solved)

_DEPENDENT = 1e-10      # part of a column that others leave, below which it is rounding


@_jit
def _direction(u: float, v: float, camera: Array, pitch_mm: float, steps: int, w: Array) -> None:
    """As `core.camera.unproject`, of one star."""
    k1, k2, p1, p2 = camera[3], camera[4], camera[5], camera[6]
    x_m, y_m = (u - camera[0]) * pitch_mm, (v - camera[1]) * pitch_mm
    x, y = x_m, y_m
    for _ in range(2):
        rr = x * x + y * y
        s = 1.0 + rr * (k1 + k2 * rr) + 2.0 * (p1 * x + p2 * y)
        x, y = x + (x_m - (x * s + p1 * rr)), y + (y_m - (y * s + p2 * rr))
    for _ in range(steps):
        rr = x * x + y * y
        s = 1.0 + rr * (k1 + k2 * rr) + 2.0 * (p1 * x + p2 * y)
        bend = 2.0 * (k1 + 2.0 * k2 * rr)
        D_xx, D_yy = s + x * (bend * x + 4.0 * p1), s + y * (bend * y + 4.0 * p2)
        D_xy = y * (bend * x + 2.0 * p1) + 2.0 * p2 * x
        e_x, e_y = x * s + p1 * rr - x_m, y * s + p2 * rr - y_m
        inverse = 1.0 / (D_xx * D_yy - D_xy * D_xy)
        x, y = x - (D_yy * e_x - D_xy * e_y) * inverse, y - (D_xx * e_y - D_xy * e_x) * inverse
    per_mm = 1.0 / np.sqrt(x * x + y * y + camera[2] * camera[2])
    w[0], w[1], w[2] = -x * per_mm, -y * per_mm, camera[2] * per_mm


@_jit
def _wahba(B: Array, C: Array) -> None:
    """As `core.rotation.wahba`: the quaternion of the largest q' K q (Davenport's method)."""
    K, V = np.empty((4, 4)), np.empty((4, 4))
    trace = B[0, 0] + B[1, 1] + B[2, 2]
    K[0, 0] = trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        K[0, 1 + i] = K[1 + i, 0] = B[k, j] - B[j, k]
        for m in range(3):
            K[1 + i, 1 + m] = B[i, m] + B[m, i]
        K[1 + i, 1 + i] -= trace
    diagonalized(K, V)
    best = 0
    for k in range(1, 4):
        if K[k, k] > K[best, best]:
            best = k
    a, b, c, d = V[0, best], V[1, best], V[2, best], V[3, best]
    C[0, 0], C[1, 1], C[2, 2] = (a * a + b * b - c * c - d * d, a * a - b * b + c * c - d * d,
                                 a * a - b * b - c * c + d * d)
    C[0, 1], C[1, 0] = 2.0 * (b * c - a * d), 2.0 * (b * c + a * d)
    C[0, 2], C[2, 0] = 2.0 * (b * d + a * c), 2.0 * (b * d - a * c)
    C[1, 2], C[2, 1] = 2.0 * (c * d - a * b), 2.0 * (c * d + a * b)


@_jit
def _orthonormalized(Q: Array) -> None:
    """Make the columns of Q orthonormal (modified Gram-Schmidt, twice); zero a dependent one."""
    rows, columns = Q.shape
    for j in range(columns):
        before = 0.0
        for i in range(rows):
            before += Q[i, j] * Q[i, j]
        for _ in range(2):
            for k in range(j):
                along = 0.0
                for i in range(rows):
                    along += Q[i, k] * Q[i, j]
                for i in range(rows):
                    Q[i, j] -= along * Q[i, k]
        square = 0.0
        for i in range(rows):
            square += Q[i, j] * Q[i, j]
        factor = 1.0 / np.sqrt(square) if square > _DEPENDENT**2 * before else 0.0
        for i in range(rows):
            Q[i, j] *= factor


@_jit
def _without(Q: Array, A: Array) -> None:
    """Replace A by A - Q Q' A."""
    rows, columns = A.shape
    along = np.empty(columns)
    for k in range(Q.shape[1]):
        along[:] = 0.0
        for i in range(rows):
            q = Q[i, k]
            for c in range(columns):
                along[c] += q * A[i, c]
        for i in range(rows):
            q = Q[i, k]
            for c in range(columns):
                A[i, c] -= q * along[c]


@_jit('b1(f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8, '
      'i8, f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1])')
def _linearize(u_i, uv, sigma, camera, slopes, scale, scale_slopes, pitch_mm, steps, r_s, z,
               H, N, Q):
    stars, p = len(sigma), slopes.shape[1]
    B, C, w = np.zeros((3, 3)), np.empty((3, 3)), np.empty(3)
    H_s, H_lens, at = np.empty((2, 3)), np.empty((2, 7)), np.empty(2)
    for star in range(stars):
        _direction(uv[star, 0] / scale[0], uv[star, 1] / scale[1], camera, pitch_mm, steps, w)
        weight = 1.0 / (sigma[star] * sigma[star])
        for i in range(3):
            for j in range(3):
                B[i, j] += weight * w[i] * u_i[star, j]
    _wahba(B, C)
    for star in range(stars):
        for i in range(3):
            r_s[star, i] = (C[i, 0] * u_i[star, 0] + C[i, 1] * u_i[star, 1]
                            + C[i, 2] * u_i[star, 2])
        projected(r_s[star, 0], r_s[star, 1], r_s[star, 2], camera, pitch_mm, at, H_s, H_lens)
        for i in range(2):
            row, weight = 2 * star + i, 1.0 / sigma[star]
            z[row, 0] = weight * (scale[i] * at[i] - uv[star, i])
            for j in range(3):
                N[row, j] = Q[row, j] = weight * scale[i] * H_s[i, j]
            for j in range(p):
                slope = 0.0
                for k in range(7):
                    slope += H_lens[i, k] * slopes[k, j]
                H[row, j] = weight * (scale[i] * slope + at[i] * scale_slopes[i, j])
    _orthonormalized(Q)
    _without(Q, z)
    _without(Q, H)
    return np.isfinite(z.sum() + H.sum())


@_jit('void(f8[:,::1], f8[::1], f8[:,::1], f8[::1])')
def _inform(H, z, matrix, vector):
    rows, p = H.shape
    for i in range(p):
        vector[i] = 0.0
        for j in range(p):
            matrix[i, j] = 0.0
    for row in range(rows):
        for i in range(p):
            vector[i] += H[row, i] * z[row]
            for j in range(i + 1):
                matrix[i, j] += H[row, i] * H[row, j]
    for i in range(p):
        for j in range(i):
            matrix[j, i] = matrix[i, j]


@_jit('b1(f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1])')
def _correct(prior, root, away, matrix, vector, parameters, root_after):
    p = len(prior)
    half, A, L = np.empty((p, p)), np.empty((p, p)), np.empty((p, p))
    X = np.empty((p, p + 1))
    multiplied(matrix, root, half)
    multiplied(root.T, half, A)
    for i in range(p):
        A[i, i] += 1.0
        told = 0.0
        for j in range(p):
            X[i, j] = root[j, i]
            left = vector[j]
            for k in range(p):
                left -= matrix[j, k] * away[k]
            told += root[j, i] * left
        X[i, p] = told
    if not factored(A, L):
        return False
    solved(L, X)
    for i in range(p):
        step = 0.0
        for j in range(p):
            root_after[i, j] = X[j, i]
            step += X[j, i] * X[j, p]
        parameters[i] = prior[i] - step
    return True


@_jit('b1(f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, f8[::1])')
def _misfit(z, H, Q, root, away, tiny, fall):
    rows, p = H.shape
    M, A, L = np.empty((rows, p)), np.empty((p, p)), np.empty((p, p))
    V, left, along = np.empty((p, rows)), np.empty(rows), np.zeros(p)
    multiplied(H, root, M)
    for i in range(p):
        for j in range(i + 1):
            A[i, j] = 1.0 if i == j else 0.0
            for row in range(rows):
                A[i, j] += M[row, i] * M[row, j]
    if not factored(A, L):
        return False
    for row in range(rows):
        left[row] = z[row]
        for j in range(p):
            left[row] -= H[row, j] * away[j]
            V[j, row] = M[row, j]
    solved(L, V)
    for j in range(p):
        for row in range(rows):
            along[j] += V[j, row] * left[row]
    for star in range(rows // 2):
        u, v = 2 * star, 2 * star + 1
        g_u, g_v, uu, uv, vv = left[u], left[v], 1.0 + tiny, 0.0, 1.0 + tiny
        for j in range(p):
            a, b = V[j, u], V[j, v]
            g_u, g_v = g_u - a * along[j], g_v - b * along[j]
            uu, uv, vv = uu - a * a, uv - a * b, vv - b * b
        for j in range(3):
            a, b = Q[u, j], Q[v, j]
            uu, uv, vv = uu - a * a, uv - a * b, vv - b * b
        fall[star] = (vv * g_u * g_u - 2.0 * uv * g_u * g_v + uu * g_v * g_v) / (uu * vv - uv * uv)
    return True


@_jit
def _ascending(G: Array) -> tuple[int, int, int]:
    """Return where the diagonal elements of a matrix (3, 3) are, the smallest first."""
    a, b, c = 0, 1, 2
    if G[b, b] < G[a, a]:
        a, b = b, a
    if G[c, c] < G[b, b]:
        b, c = c, b
    if G[b, b] < G[a, a]:
        a, b = b, a
    return a, b, c


@_jit('void(f8[:,::1], i8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8, f8, f8[:,::1], '
      'f8[:,::1], f8[::1])')
def _singular_values(member, order, r_s, z, H, N, least, never, both, B, beyond):
    groups, stars = member.shape
    p, chosen = H.shape[1], len(order)
    T, variance, w = np.empty((stars, 3, 2)), np.empty(stars), np.empty(3)
    squares, measured = np.empty((stars, 6)), np.empty((stars, 6))
    F = np.empty((2, 3))
    G, V, G_m, V_m = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for star in range(stars):
        x, y, ahead = r_s[star, 0], r_s[star, 1], r_s[star, 2]
        for i in range(2):
            n = N[2 * star + i]
            F[i, 0], F[i, 1], F[i, 2] = (n[1] * ahead - n[2] * y, n[2] * x - n[0] * ahead,
                                         n[0] * y - n[1] * x)
        uu = F[0, 0] * F[0, 0] + F[0, 1] * F[0, 1] + F[0, 2] * F[0, 2]
        uv = F[0, 0] * F[1, 0] + F[0, 1] * F[1, 1] + F[0, 2] * F[1, 2]
        vv = F[1, 0] * F[1, 0] + F[1, 1] * F[1, 1] + F[1, 2] * F[1, 2]
        inverse = 1.0 / (uu * vv - uv * uv)
        variance[star], norm = 0.0, 0.0
        for i in range(3):
            a = inverse * (vv * F[0, i] - uv * F[1, i])
            b = inverse * (uu * F[1, i] - uv * F[0, i])
            T[star, i, 0], T[star, i, 1] = a, b
            variance[star] += 0.5 * (a * a + b * b)
            w[i] = r_s[star, i] - a * z[2 * star] - b * z[2 * star + 1]
            norm += w[i] * w[i]
        at = 0
        for i in range(3):
            for j in range(i + 1):
                squares[star, at] = r_s[star, i] * r_s[star, j]
                measured[star, at] = w[i] * w[j] / norm
                at += 1
    B[:] = 0.0
    for g in range(groups):
        count = spread = 0.0
        G[:], G_m[:] = 0.0, 0.0
        for star in range(stars):
            if member[g, star]:
                count, spread = count + 1.0, spread + variance[star]
                at = 0
                for i in range(3):
                    for j in range(i + 1):
                        G[i, j] += squares[star, at]
                        G_m[i, j] += measured[star, at]
                        at += 1
        for i in range(3):
            for j in range(i):
                G[j, i], G_m[j, i] = G[i, j], G_m[i, j]
        diagonalized(G, V)
        diagonalized(G_m, V_m)
        first, second = _ascending(G), _ascending(G_m)
        v = spread / count
        for k in range(chosen):
            row, one = g * chosen + k, first[order[k]]
            value = max(G[one, one], least * least)
            sigma = np.sqrt(value)
            factor = count - 1.0
            for other in range(3):
                if other != one:
                    beside = max(G[other, other], least * least)
                    factor += (2.0 * value * (value + beside)
                               / ((value - beside) * (value - beside) + least**4))
            beyond[row] = min(0.5 * v * v * factor / value, never)
            found = second[order[k]]
            both[row, 0] = sigma - np.sqrt(max(G_m[found, found], 0.0))
            for star in range(stars):
                if member[g, star]:
                    a, b, c = V[0, one], V[1, one], V[2, one]
                    along = (a * r_s[star, 0] + b * r_s[star, 1] + c * r_s[star, 2]) / sigma
                    for j in range(2):
                        B[row, 2 * star + j] = along * (
                            a * T[star, 0, j] + b * T[star, 1, j] + c * T[star, 2, j])
    for row in range(groups * chosen):
        for j in range(p):
            both[row, 1 + j] = 0.0
        for k in range(2 * stars):
            b = B[row, k]
            for j in range(p):
                both[row, 1 + j] += b * H[k, j]


if sum(_linearize.stats.cache_misses.values()):
    print('starcal_ros: compiling the calibration by single frames, once: some ten seconds',
          file=sys.stderr, flush=True)


def linearize(u_i: Array, uv: Array, sigma: Array, camera: Array, slopes: Array, scale: Array,
              scale_slopes: Array, pitch_mm: float, steps: int
              ) -> tuple[Array, Array, Array, Array, Array]:
    """Return r_s, z, H, N and Q of `invariants.linearize`, of a frame in a camera's `Square`.

    Raises
    ------
    numpy.linalg.LinAlgError
        As there.
    """
    stars, p = len(sigma), slopes.shape[-1]
    r_s, z, H = np.empty((stars, 3)), np.empty((2 * stars, 1)), np.empty((2 * stars, p))
    N, Q = np.empty((2 * stars, 3)), np.empty((2 * stars, 3))
    if not _linearize(*map(ready, (u_i, uv, sigma, camera, slopes, scale, scale_slopes)), pitch_mm,
                      steps, r_s, z, H, N, Q):
        raise np.linalg.LinAlgError('the camera can not have seen the stars')
    return r_s, z[:, 0], H, N.reshape(stars, 2, 3), Q


def information(z: Array, H: Array) -> tuple[Array, Array]:
    """Return matrix and vector of `invariants.information`."""
    p = H.shape[1]
    matrix, vector = np.empty((p, p)), np.empty(p)
    _inform(ready(H), ready(z), matrix, vector)
    return matrix, vector


def correct(prior: Array, root: Array, away: Array, matrix: Array, vector: Array
            ) -> tuple[Array, Array]:
    """Return parameters and root of a belief that is told so much at `away` from it.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where what is told is no number.
    """
    parameters, after = np.empty(prior.shape), np.empty(root.shape)
    if not _correct(*map(ready, (prior, root, away, matrix, vector)), parameters, after):
        raise np.linalg.LinAlgError('what a frame tells is no number')
    return parameters, after


def misfit(z: Array, H: Array, Q: Array, root: Array, away: Array, tiny: float) -> Array:
    """Return by how much the sum of squares falls when a star goes, (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        Where a residual is no number.
    """
    fall = np.empty(len(z) // 2)
    if not _misfit(*map(ready, (z, H, Q, root, away)), tiny, fall):
        raise np.linalg.LinAlgError('what a frame tells is no number')
    return fall


def singular_values(member: Array, order: Ints, r_s: Array, z: Array, H: Array, N: Array,
                    least: float, never: float) -> tuple[Array, Array, Array]:
    """Return residuals and slopes side by side, slopes by centroids, and the second order.

    Of `methods.singular_value.measure`: those of order `order`, the smallest first, of groups of
    stars; (m, 1 + p), (m, 2 n) and (m,) arrays.
    """
    rows = len(member) * len(order)
    both, B, beyond = (np.empty((rows, 1 + H.shape[1])), np.empty((rows, len(z))), np.empty(rows))
    _singular_values(*map(ready, (member, order, r_s, z, H, N.reshape(-1, 3))), least, never,
                     both, B, beyond)
    return both, B, beyond
