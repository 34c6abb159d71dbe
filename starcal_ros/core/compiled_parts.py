# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What compiled arithmetic is made of: small matrices, turns, the camera of one star. Needs numba.

Sums run in a fixed order and are not contracted: the bits do not depend on the machine. What calls
these is compiled with them.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numba
import numpy as np

from starcal_ros.core.arrays import Array

jit: Any = partial(numba.njit, cache=True, error_model='numpy')


@jit
def triangularized(A: Array) -> None:
    """Leave R of A = Q R in the upper triangle of A, by Householder reflections."""
    # Over whole rows, also where they are done with: of one length, which is faster.
    rows, n = A.shape
    v, w = np.empty(rows), np.empty(n)
    for j in range(n):
        square = 0.0
        for i in range(j + 1, rows):
            square += A[i, j] * A[i, j]
        if square == 0.0:
            continue
        alpha = A[j, j]
        beta = -np.copysign(np.sqrt(alpha * alpha + square), alpha)
        tau, inverse = (beta - alpha) / beta, 1.0 / (alpha - beta)
        first = A[j]
        for k in range(n):
            w[k] = first[k]
        for i in range(j + 1, rows):
            v[i] = factor = A[i, j] * inverse
            row = A[i]
            for k in range(n):
                w[k] += factor * row[k]
        for k in range(j + 1):
            w[k] = 0.0
        for k in range(n):
            w[k] *= tau
            first[k] -= w[k]
        first[j] = beta
        for i in range(j + 1, rows):
            factor, row = v[i], A[i]
            for k in range(n):
                row[k] -= factor * w[k]


@jit
def factored(A: Array, L: Array) -> bool:
    """Write the Cholesky factor of A, read of its lower triangle, to L; false if there is none."""
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            value = A[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if j < i:
                L[i, j] = value / L[j, j]
            elif value > 0.0:
                L[i, i] = np.sqrt(value)
            else:
                return False
        for j in range(i + 1, n):
            L[i, j] = 0.0
    return True


@jit
def solved(L: Array, X: Array) -> None:
    """Replace X by L^-1 X."""
    n, columns = X.shape
    for i in range(n):
        for k in range(i):
            factor = L[i, k]
            for c in range(columns):
                X[i, c] -= factor * X[k, c]
        inverse = 1.0 / L[i, i]
        for c in range(columns):
            X[i, c] *= inverse


@jit
def dot(x: Array, y: Array) -> float:
    """Return x'y, in four sums."""
    whole = len(x) - len(x) % 4
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for k in range(0, whole, 4):
        a += x[k] * y[k]
        b += x[k + 1] * y[k + 1]
        c += x[k + 2] * y[k + 2]
        d += x[k + 3] * y[k + 3]
    for k in range(whole, len(x)):
        a += x[k] * y[k]
    return (a + b) + (c + d)


@jit
def multiplied(A: Array, B: Array, out: Array) -> None:
    """Write A B to out: two rows at once, four terms each way over them, one after the other."""
    inner, columns = B.shape
    rows, whole = A.shape[0], inner - inner % 4
    for i in range(0, rows - 1, 2):
        a, b, p, q = A[i], A[i + 1], out[i], out[i + 1]
        for c in range(columns):
            p[c] = q[c] = 0.0
        for k in range(0, whole, 4):
            a0, a1, a2, a3 = a[k], a[k + 1], a[k + 2], a[k + 3]
            b0, b1, b2, b3 = b[k], b[k + 1], b[k + 2], b[k + 3]
            w, x, y, z = B[k], B[k + 1], B[k + 2], B[k + 3]
            for c in range(columns):                # each read once, before what is written
                wc, xc, yc, zc = w[c], x[c], y[c], z[c]
                p[c] = (((p[c] + a0 * wc) + a1 * xc) + a2 * yc) + a3 * zc
                q[c] = (((q[c] + b0 * wc) + b1 * xc) + b2 * yc) + b3 * zc
        for k in range(whole, inner):
            a0, b0, w = a[k], b[k], B[k]
            for c in range(columns):
                wc = w[c]
                p[c] += a0 * wc
                q[c] += b0 * wc
    if rows % 2:
        a, p = A[rows - 1], out[rows - 1]
        for c in range(columns):
            p[c] = 0.0
        for k in range(inner):
            a0, w = a[k], B[k]
            if a0 != 0.0:
                for c in range(columns):
                    p[c] += a0 * w[c]


@jit
def diagonalized(A: Array, V: Array) -> None:
    """Leave the eigenvalues of a symmetric matrix (n, n) in its diagonal; vectors in columns of V.

    By Jacobi's rotations, each of which makes an element zero: the largest first, and at most five
    for each element.
    """
    n = A.shape[0]
    V[:] = np.eye(n)
    for _ in range(5 * n * (n - 1) // 2):
        i, j = 0, 1
        for one in range(n):
            for other in range(one + 1, n):
                if abs(A[one, other]) > abs(A[i, j]):
                    i, j = one, other
        if not abs(A[i, j]) > 1e-17 * (abs(A[i, i]) + abs(A[j, j])):
            break
        t = 0.5 * (A[j, j] - A[i, i]) / A[i, j]
        t = np.copysign(1.0, t) / (abs(t) + np.sqrt(1.0 + t * t))
        c = 1.0 / np.sqrt(1.0 + t * t)
        s = t * c
        A[i, i], A[j, j] = A[i, i] - t * A[i, j], A[j, j] + t * A[i, j]
        A[i, j] = A[j, i] = 0.0
        for k in range(n):
            if k != i and k != j:
                a, b = c * A[k, i] - s * A[k, j], s * A[k, i] + c * A[k, j]
                A[k, i] = A[i, k] = a
                A[k, j] = A[j, k] = b
            V[k, i], V[k, j] = c * V[k, i] - s * V[k, j], s * V[k, i] + c * V[k, j]


# Rotations, as in `core.rotation`

@jit
def product(A: Array, B: Array, out: Array) -> None:
    """Write A B to out, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@jit
def product_by_transposed(A: Array, B: Array, out: Array) -> None:
    """Write A B' to out, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]


@jit
def transposed_product(A: Array, B: Array, out: Array) -> None:
    """Write A' B to out, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]


@jit
def exp(a: float, b: float, c: float, out: Array) -> None:
    """As `core.rotation.exp`, of one rotation vector."""
    half = 0.5 * np.sqrt(a * a + b * b + c * c)
    factor = 0.5 if half < 1e-8 else 0.5 * np.sin(half) / half
    x, y, z, w = a * factor, b * factor, c * factor, np.cos(half)
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - (yy + zz), xy - wz, xz + wy
    out[1, 0], out[1, 1], out[1, 2] = xy + wz, 1.0 - (xx + zz), yz - wx
    out[2, 0], out[2, 1], out[2, 2] = xz - wy, yz + wx, 1.0 - (xx + yy)


@jit
def orthonormalized(C: Array, out: Array) -> None:
    """As `core.rotation.orthonormalized`, of one matrix."""
    square, cube = np.empty((3, 3)), np.empty((3, 3))
    product_by_transposed(C, C, square)
    product(square, C, cube)
    for i in range(3):
        for j in range(3):
            out[i, j] = 1.5 * C[i, j] - 0.5 * cube[i, j]


# The camera

@jit
def projected(x0: float, y0: float, z0: float, camera: Array, pitch_mm: float, uv: Array,
              H_s: Array, H_lens: Array) -> None:
    """As `core.camera.linearize`, of one star."""
    u0, v0, f, k1, k2, p1, p2 = (camera[0], camera[1], camera[2], camera[3], camera[4], camera[5],
                                 camera[6])
    scale = 1.0 / pitch_mm
    a, b = x0 / z0, y0 / z0
    x, y = -f * a, -f * b
    rr = x * x + y * y
    s = 1.0 + rr * (k1 + k2 * rr) + 2.0 * (p1 * x + p2 * y)
    uv[0], uv[1] = u0 + scale * (x * s + p1 * rr), v0 + scale * (y * s + p2 * rr)
    bend = 2.0 * (k1 + 2.0 * k2 * rr)
    bend_x, bend_y = bend * x, bend * y
    D_xx = scale * (s + x * (bend_x + 4.0 * p1))
    D_xy = scale * (y * (bend_x + 2.0 * p1) + 2.0 * p2 * x)
    D_yy = scale * (s + y * (bend_y + 4.0 * p2))
    f_ab, f_aa, f_bb = f * a * b, -f * (1.0 + a * a), f * (1.0 + b * b)
    H_s[0, 0] = D_xx * f_ab + D_xy * f_bb
    H_s[1, 0] = D_xy * f_ab + D_yy * f_bb
    H_s[0, 1] = D_xx * f_aa - D_xy * f_ab
    H_s[1, 1] = D_xy * f_aa - D_yy * f_ab
    H_s[0, 2] = D_xy * x - D_xx * y
    H_s[1, 2] = D_yy * x - D_xy * y
    H_lens[0, 0] = H_lens[1, 1] = 1.0
    H_lens[0, 1] = H_lens[1, 0] = 0.0
    H_lens[0, 2] = -(D_xx * a + D_xy * b)
    H_lens[1, 2] = -(D_xy * a + D_yy * b)
    xx, yy = scale * x * x, scale * y * y
    r2, rr = x * x + y * y, xx + yy
    H_lens[0, 3] = x * rr
    H_lens[1, 3] = y * rr
    H_lens[0, 4] = x * rr * r2
    H_lens[1, 4] = y * rr * r2
    H_lens[0, 5] = rr + 2.0 * xx
    H_lens[1, 5] = H_lens[0, 6] = 2.0 * scale * x * y
    H_lens[1, 6] = rr + 2.0 * yy
