# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of a frame, compiled: the functions of `reference`, run by run.

Each run is worked on by itself, so that it comes out bit for bit the same alone and in a batch of
any size. What the functions mean, and the shapes of what they take, stands in `reference`; here
arrays are contiguous and writable besides. Sums run in a fixed order and are not contracted: the
bits do not depend on the machine.

Importing this compiles what is not in numba's cache on disk yet: half a minute, once.
"""

from __future__ import annotations

import sys
from typing import Any

import numba
import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.compiled import ready
from starcal_ros.core.compiled_parts import (
    diagonalized, dot, exp as _exp, factored, jit as _jit, multiplied,
    orthonormalized as _orthonormalized, product as _product,
    product_by_transposed as _product_by_transposed, projected, solved,
    transposed_product as _transposed_product, triangularized)
from starcal_ros.filter import compiled_tests, stretch
from starcal_ros.filter.changes import AWAITED, BEGUN
from starcal_ros.filter.curvature import BETWEEN, MATTERS, REPEATS
from starcal_ros.filter.frame_innovation import (ALONG, BLIND, CELLS, FRAMES, FREEDOM, LAG,
                                                 MAGNITUDES, PAIRS, RATE, REST, SPREAD, SUMS, TURN,
                                                 FrameInnovation)
from starcal_ros.filter.hypotheses import (CELL, DRIFTS, KM_S, LENS_TERMS, MAGNITUDE,
                                           MIDDLE_MAGNITUDE, MISALIGNMENTS, PHASE_U, PHASE_V,
                                           SCALE_FACTORS, TIME, VELOCITY, hourly)
from starcal_ros.filter.reference import Carried, Corrected, TurnFound
from starcal_ros.filter.responses import TOLD, UNTOLD, WIDTH, Fit
from starcal_ros.filter.states import LENS, SCALE

COMPILED = True

_typeof: Any = numba.typeof
_as_expected, _harmless = compiled_tests.as_expected, compiled_tests.harmless
_stands_out, _due, _begin = (compiled_tests.stands_out, compiled_tests.due,
                             compiled_tests.begin)

_TURN, _PSI, _LENS, _N = SCALE[0], 6, LENS.start, LENS.stop
_SCALE_U, _SCALE_V = SCALE[LENS.start], SCALE[LENS.start + 1]
_HOURLY = hourly().copy()                      # (16, 4, 3): of the drifts
_DRIFTS, _CELL = DRIFTS.start, CELL.start
_N_DRIFTS, _N_CELLS = DRIFTS.stop - DRIFTS.start, CELL.stop - CELL.start
# Columns of the effects that move the centroids themselves: time, velocity, lens, phases and
# magnitude, which move all stars, then those of the cells, which move their own, u before v. Where
# the effect of each begins; and the pairs, of those that move all stars, that are of one effect.
_DENSE = [WIDTH * effect + column for effect, count in (
    (TIME, 1), (VELOCITY, 3), (LENS_TERMS, 3), (PHASE_U, 2), (PHASE_V, 2), (MAGNITUDE, 2))
    for column in range(count)]
_PLACE = np.array([*_DENSE, *(WIDTH * (_CELL + cell) + column
                              for column in range(2) for cell in range(_N_CELLS))])
_N_DENSE = len(_DENSE)
_OWN = _PLACE - _PLACE % WIDTH
_FIRST, _SECOND = (part.copy() for part in np.nonzero(np.tril(
    _OWN[:_N_DENSE, None] == _OWN[:_N_DENSE])))


# The interval

@_jit('void(f8[:,::1], f8[::1], i8[::1], f8[:,:,::1], f8[:,:,::1])')
def _compose(theta, dt, first, Delta, J):
    # exp(phi) = 1 + a [phi x] + b [phi x]^2 and its right Jacobian 1 - b [phi x] + c [phi x]^2,
    # phi = -theta
    n, columns = len(first) - 1, J.shape[2]
    step, J_r, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(n):
        D, Jk = Delta[k], J[k]
        D[:] = np.eye(3)
        Jk[:] = 0.0
        for piece in range(first[k], first[k + 1]):
            x, y, z = -theta[piece, 0], -theta[piece, 1], -theta[piece, 2]
            xx, yy, zz = x * x, y * y, z * z
            s = xx + yy + zz
            if s < 1e-2:                        # the next terms are below 1e-17
                a = 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0)))
                b = 0.5 - s / 24.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0)))
                c = 1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0 * (1.0 - s / 110.0)))
                c /= 6.0
            else:
                angle = np.sqrt(s)
                a, b = np.sin(angle) / angle, 2.0 * (np.sin(0.5 * angle) / angle)**2
                c = (1.0 - a) / s
            for i, j, cross, product in ((0, 1, -z, x * y), (0, 2, y, x * z), (1, 2, -x, y * z)):
                step[i, j], step[j, i] = b * product + a * cross, b * product - a * cross
                J_r[i, j], J_r[j, i] = c * product - b * cross, c * product + b * cross
            for i, square in ((0, yy + zz), (1, xx + zz), (2, xx + yy)):
                step[i, i], J_r[i, i] = 1.0 - b * square, 1.0 - c * square
            _transposed_product(D, J_r, turned)
            for i in range(3):
                for j in range(3):
                    Jk[i, j] += turned[i, j] * dt[piece]
                    for m in range(3 if columns > 3 else 0):
                        Jk[i, 3 + 3 * j + m] += turned[i, j] * theta[piece, m]
            _product(step, D, turned)
            D[:] = turned


def compose(theta: Array, dt: Array, first: Ints, with_matrix: bool) -> tuple[Array, Array]:
    """Do as `preintegration.composed`, one piece after the other."""
    n = len(first) - 1
    Delta, J = np.empty((n, 3, 3)), np.empty((n, 3, 12 if with_matrix else 3))
    _compose(*map(ready, (theta, dt, first)), Delta, J)
    return Delta, J


@_jit('void(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], '
      'f8[:,:,::1], f8[:,:,::1], f8[::1], f8[::1], f8[::1], f8[::1], '
      'f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1])')
def _propagate(C_gi, C_sg, error, root, Delta, turn, J_b, slopes, sigma, duration, density, scale,
               C_gi_after, error_after, root_after, transition):
    runs, n = error.shape
    walks = False
    for each in density:
        walks = walks or each != 0.0
    rows = n + (19 if walks else 3)
    A = np.empty((rows, n))
    D, S, T, B = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for r in range(runs):
        _exp(turn[r, 0], turn[r, 1], turn[r, 2], T)
        _product(Delta[r], T, D)
        _product(D, C_gi[r], T)
        _orthonormalized(T, C_gi_after[r])
        _product(C_sg[r], D, T)                 # C_s1g0
        _product_by_transposed(T, C_sg[r], S)
        _product(T, J_b[r], B)
        Phi = transition[r]
        Phi[:] = 0.0
        for i in range(n):
            Phi[i, i] = 1.0
        for i in range(3):
            for j in range(3):
                Phi[i, j] = S[i, j]
                Phi[i, 3 + j] = B[i, j]
                Phi[i, _PSI + j] = (1.0 if i == j else 0.0) - S[i, j]
            for j in range(slopes.shape[2]):
                Phi[i, _N + j] = (T[i, 0] * slopes[r, 0, j] + T[i, 1] * slopes[r, 1, j]
                                  + T[i, 2] * slopes[r, 2, j])
            value = 0.0
            for j in range(n):
                value += Phi[i, j] * error[r, j]
                Phi[i, j] *= scale[j] / scale[i]
            error_after[r, i] = value
        for i in range(3, n):
            error_after[r, i] = error[r, i]
        # The rows of A are the columns of [Phi root, Q_root].
        A[:] = 0.0
        for c in range(n):
            for k in range(n):
                A[c, k] = root[r, k, c]
        for i in range(3):
            for c in range(n):
                value = 0.0
                for k in range(n):
                    value += Phi[i, k] * root[r, k, c]
                A[c, i] = value
        for i in range(3):
            A[n + i, i] = sigma[r] / _TURN
        if walks:
            step = np.sqrt(duration[r])
            for k in range(13):
                A[n + 3 + k, 3 + k] = density[k] * step / scale[3 + k]
            for i in range(3):
                for j in range(3):
                    bias = B[i, j] * density[j] * step / _TURN
                    A[n + 3 + j, i] = 0.5 * bias
                    A[n + 16 + j, i] = bias / np.sqrt(12.0)
                A[n + 6 + i, i] = density[3 + i] * step / _TURN
        triangularized(A)
        for i in range(n):
            for j in range(n):
                root_after[r, i, j] = A[j, i] if j <= i else 0.0


if sum(_propagate.stats.cache_misses.values()):
    print('starcal_ros: compiling the filter, once: half a minute', file=sys.stderr, flush=True)


def propagate(C_gi: Array, C_sg: Array, error: Array, root: Array, Delta: Array, turn: Array,
              J_b: Array, slopes: Array, sigma: Array, duration: Array, density: Array,
              scale: Array) -> Carried:
    """Do as `reference.propagate`."""
    after = Carried(np.empty(C_gi.shape), np.empty(error.shape), np.empty(root.shape),
                    np.empty(root.shape))
    _propagate(*map(ready, (C_gi, C_sg, error, root, Delta, turn, J_b, slopes, sigma, duration,
                            density, scale)), *after)
    return after


# The frame

_UNSEEN = _LENS - 3             # states that move no centroid: between the turns and the lens


@_jit
def _seen_state(j: int) -> int:
    """Return which state is the j-th of those that move a centroid."""
    return j if j < 3 else j + _UNSEEN


@_jit('b1(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], '
      'f8[:,:,::1], f8[:,::1], f8, f8)')
def _bends(C_si, u_i, sigma, error, root, intrinsics, shift, second, largest, pitch_mm, cos_field):
    runs, n = error.shape
    m = len(largest)
    spread, part, P = np.empty(m), np.ones(m), np.empty((m, m))
    for r in range(runs):
        C, fits = C_si[r], False
        for k in range(n):
            fits = fits or error[r, k] != 0.0
        if fits:
            continue
        finest = np.inf
        for star in range(sigma.shape[1]):
            u0, u1, u2 = u_i[r, star, 0], u_i[r, star, 1], u_i[r, star, 2]
            x = u0 * C[0, 0] + u1 * C[0, 1] + u2 * C[0, 2]
            y = u0 * C[1, 0] + u1 * C[1, 1] + u2 * C[1, 2]
            ahead = u0 * C[2, 0] + u1 * C[2, 1] + u2 * C[2, 2]
            if ahead > cos_field * np.sqrt(x * x + y * y + ahead * ahead):
                finest = min(finest, sigma[r, star])
        if not np.isfinite(finest):
            continue
        moved = finest
        for i in range(m):
            state = i if i < 3 else _LENS + i - 3
            square = 0.0
            for k in range(n):
                square += root[r, state, k] * root[r, state, k]
            spread[i] = np.sqrt(square) * SCALE[state]
            if i >= 3:
                moved += shift[i - 3] * spread[i]
        most = moved * pitch_mm / intrinsics[r, 2]
        for i in range(3):
            part[i] = min(1.0, most / max(spread[i], 1e-300))
        bound = 0.0
        for i in range(m):
            for k in range(m):
                bound += part[i] * spread[i] * largest[i, k] * part[k] * spread[k]
        if not np.sqrt(REPEATS / 2.0) * bound > MATTERS * finest:
            continue
        for i in range(m):
            for j in range(i + 1):
                a, b = i if i < 3 else _LENS + i - 3, j if j < 3 else _LENS + j - 3
                value = 0.0
                for k in range(n):
                    value += root[r, a, k] * root[r, b, k]
                P[i, j] = P[j, i] = value * SCALE[a] * SCALE[b] * part[i] * part[j]
        term = 0.0
        for h in second:
            value = 0.0
            for i in range(m):
                for j in range(m):
                    left, right = 0.0, 0.0
                    for k in range(m):
                        left += h[i, k] * P[k, j]
                        right += P[i, k] * h[k, j]
                    value += left * right
            term = max(term, value)
        if BETWEEN * np.sqrt(REPEATS / 2.0) * np.sqrt(term) > MATTERS * finest:
            return True
    return False


def bends(C_si: Array, u_i: Array, sigma: Array, error: Array, root: Array, intrinsics: Array,
          shift: Array, second: Array, largest: Array, pitch_mm: float, cos_field: float) -> bool:
    """Do as `reference.bends`."""
    return bool(_bends(*map(ready, (C_si, u_i, sigma, error, root, intrinsics, shift, second,
                                    largest)), pitch_mm, cos_field))


@_jit('b1(f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], '
      'f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], '
      'f8[:,:,:,::1], f8[::1], f8, f8, f8, b1, '
      'f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], '
      'f8[:,::1], b1[:,::1], f8[:,:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], '
      'f8[:,:,::1])')
def _correct(C_gi, bias, C_sg, intrinsics, error, root, C_si, shift, slopes, trail, u_i, uv, sigma,
             left_out, direct, scale, pitch_mm, cos_field, gate, feedback,
             error_after, root_after, C_gi_after, bias_after, C_sg_after, intrinsics_after, freed,
             chi2, accepted, residual, nis, spread, z_used, H_used, M_used, L):
    runs, n = error.shape
    stars, m = u_i.shape[1], slopes.shape[2]
    rows = 2 * stars
    seen = n - _UNSEEN
    H, white, z = np.zeros((rows, n)), np.empty((rows, seen)), np.empty(rows)
    usable, left = np.empty(stars, np.bool_), np.empty(n)
    H_s, H_lens, at, A = np.empty((2, 3)), np.empty((2, 7)), np.empty(2), np.empty((n, n))
    right, found, root_seen = np.empty((n, n + 1)), np.empty(n), np.empty((seen, n))
    T, S, turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    good = True
    for r in range(runs):
        C, lens, before = C_si[r], intrinsics[r], error[r]
        expected, trails = before.any(), trail[r].any()
        for star in range(stars):
            u0, u1, u2 = u_i[r, star, 0], u_i[r, star, 1], u_i[r, star, 2]
            x = u0 * C[0, 0] + u1 * C[0, 1] + u2 * C[0, 2]
            y = u0 * C[1, 0] + u1 * C[1, 1] + u2 * C[1, 2]
            ahead = u0 * C[2, 0] + u1 * C[2, 1] + u2 * C[2, 2]
            usable[star] = ahead > cos_field * np.sqrt(x * x + y * y + ahead * ahead)
            if not usable[star]:
                x, y, ahead = 0.0, 0.0, 1.0
            projected(x, y, ahead, lens, pitch_mm, at, H_s, H_lens)
            for i in range(2):
                row = H[2 * star + i]
                if m:
                    for j in range(3):
                        row[j] = (H_s[i, 0] * shift[r, 0, j] + H_s[i, 1] * shift[r, 1, j]
                                  + H_s[i, 2] * shift[r, 2, j])
                    for j in range(m):
                        row[_N + j] = (H_s[i, 0] * slopes[r, 0, j] + H_s[i, 1] * slopes[r, 1, j]
                                       + H_s[i, 2] * slopes[r, 2, j] + direct[r, star, i, j])
                else:
                    for j in range(3):
                        row[j] = H_s[i, j]
                for j in range(7):
                    row[_LENS + j] = H_lens[i, j]
                z[2 * star + i] = at[i] - uv[r, star, i]
            first, second = H[2 * star], H[2 * star + 1]
            z_u, z_v = z[2 * star], z[2 * star + 1]
            if expected:
                z_u, z_v = z_u - dot(first, before), z_v - dot(second, before)
            i_uu, i_vu, i_vv = 1.0, 0.0, 1.0
            if trails:
                a = first[0] * trail[r, 0] + first[1] * trail[r, 1] + first[2] * trail[r, 2]
                b = second[0] * trail[r, 0] + second[1] * trail[r, 1] + second[2] * trail[r, 2]
                i_uu = 1.0 / np.sqrt(1.0 + a * a)
                i_vv = np.sqrt((1.0 + a * a) / (1.0 + a * a + b * b))
                i_vu = -a * b / (1.0 + a * a) * i_vv
            deviation = sigma[r, star]
            if left_out[r, star] > 0.0:
                deviation = np.hypot(deviation, left_out[r, star])
            usable[star] = usable[star] and np.isfinite(deviation)
            weight = 1.0 / deviation
            z_used[r, 2 * star] = i_uu * z_u * weight
            z_used[r, 2 * star + 1] = (i_vu * z_u + i_vv * z_v) * weight
            i_uu, i_vu, i_vv = i_uu * weight, i_vu * weight, i_vv * weight
            for j in range(seen):
                k = _seen_state(j)
                white[2 * star, j] = i_uu * first[k] * scale[k]
                white[2 * star + 1, j] = (i_vu * first[k] + i_vv * second[k]) * scale[k]
        for j in range(seen):
            root_seen[j] = root[r, _seen_state(j)]
        Mr = M_used[r]
        multiplied(white, root_seen, Mr)
        square, widest = 0.0, 0.0
        H_used[r] = 0.0
        for star in range(stars):
            upper, lower = Mr[2 * star], Mr[2 * star + 1]
            z_u, z_v = z_used[r, 2 * star], z_used[r, 2 * star + 1]
            uu, ww = dot(upper, upper), dot(lower, lower)
            gain = dot(upper, lower) / (1.0 + uu)
            for j in range(n):
                left[j] = lower[j] - gain * upper[j]
            rest, across = dot(left, left), z_v - gain * z_u
            chi2[r, star] = z_u * z_u / (1.0 + uu) + across * across / (
                1.0 + gain * gain + rest)
            accepted[r, star] = usable[star] and chi2[r, star] <= gate
            if accepted[r, star]:
                widest = max(widest, uu, ww)
                square += z_u * z_u + z_v * z_v
                for row in range(2 * star, 2 * star + 2):
                    for j in range(seen):
                        H_used[r, row, _seen_state(j)] = white[row, j]
            else:
                for row in range(2 * star, 2 * star + 2):
                    z_used[r, row] = 0.0
                    for j in range(n):
                        Mr[row, j] = 0.0
        spread[r] = np.sqrt(widest)
        multiplied(Mr.T, Mr, A)
        for i in range(n):
            A[i, i] += 1.0
        good = factored(A, L[r]) and good
        # L^-1 root', of which the transposed is the root after it, and L^-1 M' z
        for i in range(n):
            for j in range(n):
                right[i, j] = root[r, j, i]
            right[i, n] = 0.0
        for row in range(rows):
            factor = z_used[r, row]
            for i in range(n):
                right[i, n] += Mr[row, i] * factor
        solved(L[r], right)
        for i in range(n):
            found[i] = right[i, n]
            for j in range(n):
                root_after[r, j, i] = right[i, j]
        nis[r] = square - dot(found, found)
        for i in range(n):
            error_after[r, i] = before[i] + scale[i] * dot(root_after[r, i], found)
        for row in range(rows):
            residual[r, row // 2, row % 2] = dot(H[row], error_after[r]) - z[row]
        freed[r] = 0.0
        C_gi_after[r], bias_after[r], C_sg_after[r] = C_gi[r], bias[r], C_sg[r]
        intrinsics_after[r] = lens
        if feedback:
            e = error_after[r]
            _product(C_sg[r], C_gi[r], T)
            _exp(-e[0], -e[1], -e[2], turn)
            _product(turn, T, S)                # C_si after
            _exp(-e[_PSI], -e[_PSI + 1], -e[_PSI + 2], turn)
            _product(turn, C_sg[r], T)
            _orthonormalized(T, C_sg_after[r])
            _transposed_product(C_sg_after[r], S, T)
            _orthonormalized(T, C_gi_after[r])
            for k in range(3):
                bias_after[r, k] = bias[r, k] - e[3 + k]
            for k in range(7):
                intrinsics_after[r, k] = intrinsics[r, k] - e[_LENS + k]
            for k in range(n):
                freed[r, k] = e[k]
                e[k] = 0.0
    return good


def correct(C_gi: Array, bias: Array, C_sg: Array, intrinsics: Array, error: Array, root: Array,
            C_si: Array, shift: Array, slopes: Array, trail: Array, u_i: Array, uv: Array,
            sigma: Array, left_out: Array, direct: Array, scale: Array, pitch_mm: float,
            cos_field: float, gate: float, feedback: bool) -> Corrected:
    """Do as `reference.correct`; LinAlgError where what is believed is no covariance."""
    (runs, n), rows = error.shape, 2 * sigma.shape[1]
    after = Corrected(
        np.empty(error.shape), np.empty(root.shape), np.empty(C_gi.shape), np.empty(bias.shape),
        np.empty(C_sg.shape), np.empty(intrinsics.shape), np.empty(error.shape),
        np.empty(sigma.shape), np.empty(sigma.shape, np.bool_), np.empty(uv.shape),
        np.empty(runs), np.empty(runs), np.empty((runs, rows)), np.empty((runs, rows, n)),
        np.empty((runs, rows, n)), np.empty(root.shape))
    if not _correct(*map(ready, (C_gi, bias, C_sg, intrinsics, error, root, C_si, shift, slopes,
                                 trail, u_i, uv, sigma, left_out, direct, scale)),
                    pitch_mm, cos_field, gate, feedback, *after):
        raise np.linalg.LinAlgError("no Cholesky factor of I + M'M")
    return after


# The tests of the model

@_jit('void(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], '
      'f8[:,:,::1], f8[::1], f8[:,:,::1])')
def _carry(E, Phi, C_gi_before, C_gi, C_sg, Delta, J, duration, drift):
    runs, n, columns = E.shape
    rows = np.empty((3, columns))
    C, T, B, rate = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for r in range(runs):
        multiplied(Phi[r, :3], E[r], rows)
        E[r, :3] = rows
        _product_by_transposed(C_gi[r], C_gi_before[r], C)
        span = max(duration[r], 1e-9)
        rate[0] = 0.5 * (C[1, 2] - C[2, 1]) / span
        rate[1] = 0.5 * (C[2, 0] - C[0, 2]) / span
        rate[2] = 0.5 * (C[0, 1] - C[1, 0]) / span
        _product(C_sg[r], Delta[r], T)
        for i in range(3):
            for j in range(3):
                B[i, j] = -(T[i, 0] * J[r, 0, j] + T[i, 1] * J[r, 1, j] + T[i, 2] * J[r, 2, j]) * (
                    1e-6 / _TURN)
        for i in range(3):
            for j in range(3):
                E[r, i, WIDTH * SCALE_FACTORS + j] += B[i, j] * rate[j]
            E[r, i, WIDTH * MISALIGNMENTS] += B[i, 0] * rate[1] + B[i, 1] * rate[0]
            E[r, i, WIDTH * MISALIGNMENTS + 1] += B[i, 0] * rate[2] + B[i, 2] * rate[0]
            E[r, i, WIDTH * MISALIGNMENTS + 2] += B[i, 1] * rate[2] + B[i, 2] * rate[1]
        for i in range(_N):
            for effect in range(_N_DRIFTS):
                for j in range(WIDTH):
                    E[r, i, WIDTH * (_DRIFTS + effect) + j] += (
                        drift[i, effect, j] * duration[r])


def carry(E: Array, Phi: Array, C_gi_before: Array, C_gi: Array, C_sg: Array, Delta: Array,
          J: Array, duration: Array) -> None:
    """Do as `reference.carry`."""
    _carry(E, *map(ready, (Phi, C_gi_before, C_gi, C_sg, Delta, J, duration)), _HOURLY)


@_jit
def _extreme_values(N):
    """Return the least and the largest eigenvalue of a symmetric matrix (3, 3).

    In closed form (Smith, Communications of the ACM 4(4), 1961), good to rounding of the largest.
    """
    mean = (N[0, 0] + N[1, 1] + N[2, 2]) / 3.0
    a, b, c = N[0, 0] - mean, N[1, 1] - mean, N[2, 2] - mean
    x, y, z = N[0, 1], N[0, 2], N[1, 2]
    spread = np.sqrt((a * a + b * b + c * c + 2.0 * (x * x + y * y + z * z)) / 6.0)
    if spread == 0.0:
        return mean, mean
    determinant = a * (b * c - z * z) - x * (x * c - y * z) + y * (x * z - b * y)
    angle = np.arccos(min(max(0.5 * determinant / spread**3, -1.0), 1.0)) / 3.0
    return (mean + 2.0 * spread * np.cos(angle + 2.0 * np.pi / 3.0),
            mean + 2.0 * spread * np.cos(angle))


@_jit
def _direct(H, C, rate_s, u_i, uv, magnitude, half, d, along):
    """As `hypotheses.direct`: the dense columns to d, those of the cells to along."""
    corner = np.sqrt(half[0] * half[0] + half[1] * half[1])
    for star in range(len(uv)):
        u, v = uv[star, 0], uv[star, 1]
        r0 = C[0, 0] * u_i[star, 0] + C[0, 1] * u_i[star, 1] + C[0, 2] * u_i[star, 2]
        r1 = C[1, 0] * u_i[star, 0] + C[1, 1] * u_i[star, 1] + C[1, 2] * u_i[star, 2]
        r2 = C[2, 0] * u_i[star, 0] + C[2, 1] * u_i[star, 1] + C[2, 2] * u_i[star, 2]
        x, y = u / corner, v / corner
        r6 = (x * x + y * y)**3
        sin_u, cos_u = np.sin(2.0 * np.pi * u), np.cos(2.0 * np.pi * u)
        sin_v, cos_v = np.sin(2.0 * np.pi * v), np.cos(2.0 * np.pi * v)
        fainter = magnitude[star] - MIDDLE_MAGNITUDE
        if np.isnan(fainter):
            fainter = 0.0
        for i in range(2 * star, 2 * star + 2):
            h0, h1, h2 = H[i, 0] / _TURN, H[i, 1] / _TURN, H[i, 2] / _TURN
            a, b = -H[i, _LENS] / _SCALE_U, -H[i, _LENS + 1] / _SCALE_V
            along[i, 0], along[i, 1] = a, b
            d[i, 0] = 1e-3 * (h0 * rate_s[0] + h1 * rate_s[1] + h2 * rate_s[2])
            c0, c1, c2 = h1 * r2 - h2 * r1, h2 * r0 - h0 * r2, h0 * r1 - h1 * r0
            for j in range(3):
                d[i, 1 + j] = -KM_S * (c0 * C[0, j] + c1 * C[1, j] + c2 * C[2, j])
            d[i, 4] = a * x * r6 + b * y * r6
            d[i, 5] = a * x - b * y
            d[i, 6] = a * y + b * x
            d[i, 7], d[i, 8] = a * sin_u, a * cos_u
            d[i, 9], d[i, 10] = b * sin_v, b * cos_v
            d[i, 11], d[i, 12] = a * fainter, b * fainter


@_jit
def _undrawn(N, C_sg, noise, s):
    """Take off the scores s what `hypotheses.drawn` returns."""
    s[TIME, 0] += 1e-3 * noise[0] * (N[0, 0] + N[1, 1] + N[2, 2])
    for i in range(3):
        for j in range(i, 3):
            value = 0.0
            for k in range(3):
                for m in range(3):
                    value += C_sg[k, i] * N[k, m] * C_sg[m, j]
            value *= 1e-6 * noise[1]
            if i == j:
                s[SCALE_FACTORS, i] -= value
            else:
                s[MISALIGNMENTS, i + j - 1] -= 2.0 * value


@_jit
def _along(E, GE, g, sized, paired):
    """Write E'g, and the products of a column of E with its own of GE and those before it."""
    n, columns = E.shape
    sized[:] = 0.0
    paired[:] = 0.0
    for k in range(n):
        factor = g[k]
        for c in range(columns):
            sized[c] += factor * E[k, c]
        for back in range(WIDTH):
            for c in range(back, columns):
                paired[back, c] += E[k, c] * GE[k, c - back]


@_jit('void(f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], '
      'f8[:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], '
      'f8[:,::1], b1[:,::1], f8[::1], f8[::1], f8[::1], f8[:,:,::1], f8[:,::1], '
      'b1[::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8[:,::1], f8[::1])')
def _judge(z, H, M, L, root, E, s, information, C_si, rate_s, u_i, uv, sigma, magnitude, accepted,
           spread, nis, half, C_sg, noise, judged, e, L_N, normal, cell, log_det):
    # With P = L^-1 M': D' S^-1 D = D' D - (P D)' (P D) of any directions D: those in which the
    # states that move a centroid move the innovation, H, z itself, and those in which the effects
    # do that move the centroids themselves, d, of which the cells have two a row.
    runs, n, columns = E.shape
    stars = accepted.shape[1]
    rows, effects, wide = 2 * stars, columns // WIDTH, len(_PLACE)
    m = n - _UNSEEN
    d, along = np.empty((rows, _N_DENSE)), np.empty((rows, 2))
    N, v = np.empty((3, 3)), np.empty(3)
    sized, paired, crossed = np.empty(columns), np.empty((WIDTH, columns)), np.empty((wide, WIDTH))
    squares, pairs = np.empty((3, _N_CELLS)), np.empty(len(_FIRST))
    for r in range(runs):
        Hr, zr = H[r], z[r]
        used = 0
        log_det[r] = 0.0
        for k in range(n):
            log_det[r] += 2.0 * np.log(L[r, k, k])
        for star in range(stars):
            if accepted[r, star]:
                used += 1
                log_det[r] += 4.0 * np.log(sigma[r, star])
            for i in range(2):
                row = 2 * star + i
                normal[r, star, i] = zr[row] / np.sqrt(1.0 + dot(M[r, row], M[r, row]))
            x = int((uv[r, star, 0] / half[0] + 1.0) * (0.5 * CELLS))
            w = int((uv[r, star, 1] / half[1] + 1.0) * (0.5 * CELLS))
            cell[r, star] = CELLS * min(max(w, 0), CELLS - 1) + min(max(x, 0), CELLS - 1)
        _direct(Hr, C_si[r], rate_s[r], u_i[r], uv[r], magnitude[r], half, d, along)
        # The products of [M H z] with D = [H z d cells], and from them PD, [H z]' S^-1 D and K D
        at = m + 1                                              # where d begins
        width = at + _N_DENSE
        left, W = np.empty((rows, n + at)), np.empty((rows, width))
        for row in range(rows):
            for j in range(m):
                W[row, j] = Hr[row, _seen_state(j)]
            W[row, m] = zr[row]
            for j in range(_N_DENSE):
                W[row, at + j] = d[row, j]
            for k in range(n):
                left[row, k] = M[r, row, k]
            for j in range(at):
                left[row, n + j] = W[row, j]
        by_cell = np.zeros((2 * _N_CELLS, n + at))
        for row in range(rows):
            for c in range(2):
                factor, sums = along[row, c], by_cell[_N_CELLS * c + cell[r, row // 2]]
                for k in range(n + at):
                    sums[k] += factor * left[row, k]
        by_W, products = np.empty((n + at, width)), np.empty((n + at, at + wide))
        multiplied(left.T, W, by_W)
        for k in range(n + at):
            for j in range(width):
                products[k, j] = by_W[k, j]
            for c in range(2 * _N_CELLS):
                products[k, width + c] = by_cell[c, k]
        PD, S = products[:n], np.empty((at, at + wide))
        solved(L[r], PD)
        multiplied(PD[:, :at].T, PD, S)
        for i in range(at):
            for j in range(at + wide):
                S[i, j] = products[n + i, j] - S[i, j]
        K = np.empty((n, at + wide))
        multiplied(root[r], PD, K)
        for i in range(3):
            v[i] = S[i, m] / _TURN
            for j in range(3):
                N[i, j] = S[i, j] / _TURN / _TURN
        judged[r] = False
        if used > 2 and spread[r] < SPREAD and np.isfinite(nis[r]):
            least, most = _extreme_values(N)
            judged[r] = least > BLIND * most and factored(N, L_N[r])
        if judged[r]:
            for i in range(3):
                value = v[i]
                for k in range(i):
                    value -= L_N[r, i, k] * e[r, k]
                e[r, i] = value / L_N[r, i, i]
        else:
            L_N[r] = np.eye(3)
            e[r] = v
        # E <- E - K D, D = H E + d, and G E, in one product
        E_seen, F, both = (np.empty((m, columns)), np.empty((n + m, m)),
                           np.empty((n + m, columns)))
        for j in range(m):
            E_seen[j] = E[r, _seen_state(j)]
            for k in range(n):
                F[k, j] = K[k, j]
            for i in range(m):
                F[n + i, j] = S[i, j]
        multiplied(F, E_seen, both)
        if judged[r]:
            # Over all columns at once: of each with itself and with the two before it, of which
            # those of its own effect count.
            _along(E_seen, both[n:], S[:, m], sized, paired)
            for effect in range(effects):
                for a in range(WIDTH):
                    c = WIDTH * effect + a
                    s[r, effect, a] += sized[c]
                    for b in range(a + 1):
                        information[r, effect, a, b] += paired[a - b, c]
                        if b < a:
                            information[r, effect, b, a] += paired[a - b, c]
            # E' H' S^-1 d of all columns of the effect, and its transposed
            crossed[:] = 0.0
            for k in range(m):
                Ek, Sk = E_seen[k], S[k]
                for c in range(wide):
                    first, factor = _OWN[c], Sk[at + c]
                    crossed[c, 0] += Ek[first] * factor
                    crossed[c, 1] += Ek[first + 1] * factor
                    crossed[c, 2] += Ek[first + 2] * factor
            for c in range(wide):
                effect, a = _PLACE[c] // WIDTH, _PLACE[c] % WIDTH
                s[r, effect, a] += S[m, at + c]
                for b in range(WIDTH):
                    information[r, effect, b, a] += crossed[c, b]
                    information[r, effect, a, b] += crossed[c, b]
            # d' S^-1 d, of the columns of one effect
            pairs[:] = 0.0
            for row in range(rows):
                for q in range(len(_FIRST)):
                    pairs[q] += d[row, _FIRST[q]] * d[row, _SECOND[q]]
            for k in range(n):
                for q in range(len(_FIRST)):
                    pairs[q] -= PD[k, at + _FIRST[q]] * PD[k, at + _SECOND[q]]
            for q in range(len(_FIRST)):
                c, b = _PLACE[_FIRST[q]], _PLACE[_SECOND[q]]
                own = information[r, c // WIDTH]
                own[c % WIDTH, b % WIDTH] += pairs[q]
                if b < c:
                    own[b % WIDTH, c % WIDTH] += pairs[q]
            squares[:] = 0.0
            for k in range(n):
                u, v_ = PD[k, width:width + _N_CELLS], PD[k, width + _N_CELLS:]
                for c in range(_N_CELLS):
                    squares[0, c] -= u[c] * u[c]
                    squares[1, c] -= u[c] * v_[c]
                    squares[2, c] -= v_[c] * v_[c]
            for row in range(rows):
                c, a, b = cell[r, row // 2], along[row, 0], along[row, 1]
                squares[0, c] += a * a
                squares[1, c] += a * b
                squares[2, c] += b * b
            for c in range(_N_CELLS):
                own = information[r, _CELL + c]
                own[0, 0] += squares[0, c]
                own[0, 1] += squares[1, c]
                own[1, 0] += squares[1, c]
                own[1, 1] += squares[2, c]
            _undrawn(N, C_sg[r], noise[r], s[r])
        for i in range(n):
            for c in range(columns):
                E[r, i, c] -= both[i, c]
            for c in range(wide):
                E[r, i, _PLACE[c]] -= K[i, at + c]


def judge(z: Array, H: Array, M: Array, L: Array, root: Array, E: Array, s: Array,
          information: Array, C_si: Array, rate_s: Array, u_i: Array, uv: Array, sigma: Array,
          magnitude: Array, accepted: Mask, spread: Array, nis: Array, half: Array, C_sg: Array,
          noise: Array) -> TurnFound:
    """Do as `reference.judge`."""
    runs = len(nis)
    found = TurnFound(
        np.empty(runs, np.bool_), np.empty((runs, 3)), np.empty((runs, 3, 3)), np.empty(uv.shape),
        np.empty(sigma.shape, np.int64), np.empty(runs))
    _judge(*map(ready, (z, H, M, L, root)), E, s, information,
           *map(ready, (C_si, rate_s, u_i, uv, sigma, magnitude, accepted, spread, nis, half,
                        C_sg, noise)),
           *found)
    return found


@_jit('void(f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], i8[::1], '
      'f8[:,:,::1])')
def _fit(s, information, largest, p, sigma, gain, freedom, root):
    A, V, along = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for g in range(len(s)):
        size = largest[g]
        for i in range(3):
            for j in range(3):
                A[i, j] = information[g, i, j] * size[i] * size[j]
        diagonalized(A, V)
        gain[g], freedom[g] = 0.0, 0
        for j in range(3):
            along[j] = 0.0
            if A[j, j] > TOLD:
                for i in range(3):
                    along[j] += V[i, j] * s[g, i] * size[i]
                along[j] /= np.sqrt(A[j, j])
                gain[g] += along[j] * along[j]
                freedom[g] += 1
        for i in range(3):
            p[g, i], square, untold = 0.0, 0.0, 0.0
            for j in range(3):
                root[g, i, j] = 0.0
                if A[j, j] > TOLD:
                    root[g, i, j] = size[i] * V[i, j] / np.sqrt(A[j, j])
                    p[g, i] += root[g, i, j] * along[j]
                    square += root[g, i, j] * root[g, i, j]
                else:
                    untold += V[i, j] * V[i, j]
            sigma[g, i] = np.sqrt(square) if untold < UNTOLD and size[i] > 0.0 else np.inf


def fit(s: Array, information: Array, largest: Array) -> Fit:
    """Do as `responses.fitted`."""
    n = len(s)
    found = Fit(np.empty((n, WIDTH)), np.empty((n, WIDTH)), np.empty(n), np.empty(n, np.int64),
                np.empty((n, WIDTH, WIDTH)))
    _fit(*map(ready, (s, information, largest)), *found)
    return found


@_jit('void(f8[::1], f8[:,::1], f8, i8, f8[::1], f8[:,::1], i8[::1], f8[::1], f8, f8[::1], '
      'f8[::1], f8[::1], b1, i8[::1], f8[::1], f8[:,::1], i8[::1], f8[::1], i8[::1], f8[::1])')
def _tally(e, L, nis, used, rate, normal, cell, magnitude, noise, run, window, last, follows,
           rows, star_frames, star_sums, cell_count, cell_squares, magnitude_count,
           magnitude_squares):
    turn, along, square, lag = 0.0, 0.0, 0.0, 0.0
    added = np.zeros(SUMS)
    for i in range(3):
        for j in range(3):
            along += noise * L[i, j] * L[i, j]
    for j in range(3):
        w = rate[0] * L[0, j] + rate[1] * L[1, j] + rate[2] * L[2, j]
        turn += e[j] * e[j]
        along += w * e[j]
        square += w * w
        lag += e[j] * last[j]
        last[j] = added[SUMS - 3 + j] = e[j]
    added[FRAMES], added[FREEDOM], added[TURN], added[REST] = 1.0, 2 * used - 3, turn, nis - turn
    added[ALONG], added[RATE] = along, square
    if follows:
        added[PAIRS], added[LAG] = 1.0, lag
    for k in range(SUMS):
        run[k] += added[k]
        window[k] += added[k]
    for star in range(len(rows)):
        row, square = rows[star], 0.0
        star_frames[row] += 1.0
        for i in range(2):
            star_sums[row, i] += normal[star, i]
            square += normal[star, i] * normal[star, i]
        cell_count[cell[star]] += 1
        cell_squares[cell[star]] += square
        if np.isfinite(magnitude[star]):
            kind = 0
            for edge in MAGNITUDES:
                kind += edge < magnitude[star]
            magnitude_count[kind] += 1
            magnitude_squares[kind] += square


def tally(frame: FrameInnovation, run: Array, window: Array, last: Array, follows: bool,
          rows: Ints, star_frames: Array, star_sums: Array, cell_count: Ints, cell_squares: Array,
          magnitude_count: Ints, magnitude_squares: Array) -> None:
    """Do as `frame_innovation.tally`."""
    e, L, nis, used, rate, _, normal, cell, magnitude, noise = frame
    _tally(*map(ready, (e, L)), nis, used, *map(ready, (rate, normal, cell, magnitude)), noise,
           run, window, last, follows, ready(rows), star_frames, star_sums, cell_count,
           cell_squares, magnitude_count, magnitude_squares)


# Ordinary frames, one after the other

# Plain tuples: a class in its place would stand in the cache on disk by its name.
@_jit((*(_typeof(tuple(part)) for part in stretch.example()), numba.int64), nogil=True)
def _advance(belief, constants, intervals, stars, sums, out, most):
    # All that a frame needs, in the order of `calibrator`; nothing is written before it is known
    # that the frame is an ordinary one.
    C_gi, bias, C_sg, intrinsics, root = belief
    (density, scale, lens_shift, second, largest, half, hourly, walk, gap_acceleration, trail_s,
     pitch_mm, cos_field, gate, guarded, largest_correction, sigma_acquired, wide, most_torn,
     torn_nis, least_stars, window_frames, gated, sizes) = constants
    Delta, J, durations, gap_turn, reading, share, reference = intervals
    stamp_ns, begin, all_u_i, all_uv, all_sigma, all_magnitude, row = stars
    (E, s, information, run, window, last_e, follows, star_frames, star_sums, cell_count,
     cell_squares, magnitude_count, magnitude_squares, worst, seen, slots, counts) = sums
    (C_gi_out, bias_out, C_sg_out, intrinsics_out, root_out, nis_out, used_out, log_det_out,
     squares_out, turn_out, chi2_out, accepted_out, residual_out) = out
    n = root.shape[1]
    error, slopes, shift = np.zeros((1, n)), np.zeros((1, 3, 0)), np.eye(3).reshape(1, 3, 3)
    drift, sigma = np.empty((1, 3)), np.empty(1)
    C_gi_1, error_1, root_1, Phi = (np.empty((1, 3, 3)), np.empty((1, n)), np.empty((1, n, n)),
                                    np.empty((1, n, n)))
    C_si, rate, trail = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((1, 3))
    error_2, root_2, freed = np.empty((1, n)), np.empty((1, n, n)), np.empty((1, n))
    C_gi_2, bias_2, C_sg_2, intrinsics_2 = (np.empty((1, 3, 3)), np.empty((1, 3)),
                                            np.empty((1, 3, 3)), np.empty((1, 7)))
    nis, spread, L = np.empty(1), np.empty(1), np.empty((1, n, n))
    noise = np.empty((1, 2))
    judged, e, L_N, log_det = (np.empty(1, np.bool_), np.empty((1, 3)), np.empty((1, 3, 3)),
                               np.empty(1))
    effects = len(sizes)
    p, p_sigma, gain, freedom, p_root = (
        np.empty((effects, WIDTH)), np.empty((effects, WIDTH)), np.empty(effects),
        np.empty(effects, np.int64), np.empty((effects, WIDTH, WIDTH)))
    for k in range(most):
        first, last = begin[k], begin[k + 1]
        count, usable = last - first, 0
        for star in range(first, last):
            usable += np.isfinite(all_sigma[star])
        if not usable:
            return k, False
        # The interval
        duration, square = durations[k], 0.0
        for i in range(3):
            rate[0, i] = bias[0, i] - reference[i]
            square += rate[0, i] * rate[0, i]
        if np.sqrt(square) * duration > largest_correction:
            return k, False
        for i in range(3):
            drift[0, i] = (J[k, i, 0] * rate[0, 0] + J[k, i, 1] * rate[0, 1]
                           + J[k, i, 2] * rate[0, 2])
        hidden = gap_acceleration * gap_turn[k]
        sigma[0] = np.sqrt(walk * walk * duration + hidden * hidden)
        _propagate(C_gi, C_sg, error, root, Delta[k:k + 1], drift, J[k:k + 1], slopes, sigma,
                   durations[k:k + 1], density, scale, C_gi_1, error_1, root_1, Phi)
        for i in range(3):
            square = 0.0
            for j in range(n):
                square += root_1[0, i, j] * root_1[0, i, j]
            if not _TURN * np.sqrt(square) <= sigma_acquired:
                return k, False
        # The frame
        _product(C_sg[0], C_gi_1[0], C_si[0])
        for i in range(3):
            value = 0.0
            for j in range(3):
                value += C_sg[0, i, j] * (reading[k, j] - bias[0, j])
            rate[0, i], trail[0, i] = value, value * trail_s
        u_i = all_u_i[first:last].reshape(1, count, 3)
        uv = all_uv[first:last].reshape(1, count, 2)
        deviation = all_sigma[first:last].reshape(1, count)
        if guarded and _bends(C_si, u_i, deviation, error, root_1, intrinsics, lens_shift, second,
                              largest, pitch_mm, cos_field):
            return k, False
        chi2 = chi2_out[first:last].reshape(1, count)
        accepted = accepted_out[first:last].reshape(1, count)
        residual = residual_out[first:last].reshape(1, count, 2)
        z, H, M = (np.empty((1, 2 * count)), np.empty((1, 2 * count, n)),
                   np.empty((1, 2 * count, n)))
        if not _correct(
                C_gi_1, bias, C_sg, intrinsics, error, root_1, C_si, shift, slopes, trail, u_i,
                uv, deviation, np.zeros((1, count)), np.empty((1, count, 2, 0)), scale, pitch_mm,
                cos_field, gate, True,
                error_2, root_2, C_gi_2, bias_2, C_sg_2, intrinsics_2, freed, chi2, accepted,
                residual, nis, spread, z, H, M, L):
            return k, False
        used = 0
        for star in range(count):
            used += accepted[0, star]
        torn = (usable >= least_stars and used <= most_torn * usable
                and nis[0] > torn_nis * 2 * used)
        total = root_2.sum() + C_gi_2.sum() + C_sg_2.sum() + bias_2.sum() + intrinsics_2.sum()
        if not spread[0] <= wide or torn or usable - used > used or not np.isfinite(total):
            return k, False
        # The tests of the model
        _carry(E, Phi, C_gi, C_gi_1, C_sg, Delta[k:k + 1], J[k:k + 1], durations[k:k + 1], hourly)
        normal, cell = np.empty((1, count, 2)), np.empty((1, count), np.int64)
        place = uv - residual
        noise[0, 0], noise[0, 1] = walk * walk * share[k], walk * walk * duration
        _judge(z, H, M, L, root_2, E, s, information, C_si, rate, u_i, place, deviation,
               all_magnitude[first:last].reshape(1, count), accepted, spread, nis, half, C_sg,
               noise, judged, e, L_N, normal, cell, log_det)
        if judged[0]:
            chosen = np.flatnonzero(accepted[0])
            _tally(e[0], L_N[0], nis[0], used, rate[0], normal[0][chosen], cell[0][chosen],
                   all_magnitude[first:last][chosen], noise[0, 0], run, window, last_e, follows[0],
                   row[first:last][chosen], star_frames, star_sums, cell_count, cell_squares,
                   magnitude_count, magnitude_squares)
        follows[0] = judged[0]
        C_gi[:], bias[:], C_sg[:], intrinsics[:], root[:] = (
            C_gi_2, bias_2, C_sg_2, intrinsics_2, root_2)
        C_gi_out[k], bias_out[k], C_sg_out[k], intrinsics_out[k], root_out[k] = (
            C_gi[0], bias[0], C_sg[0], intrinsics[0], root[0])
        nis_out[k], used_out[k], log_det_out[k] = nis[0], used, log_det[0]
        turn_out[k] = e[0] if judged[0] else np.full(3, np.nan)
        squares_out[k] = 0.0
        for star in range(count):
            if accepted[0, star]:
                for i in range(2):
                    squares_out[k, i] += residual[0, star, i] * residual[0, star, i]
        seen[0] += used
        seen[1] += usable - used
        look, full = _due(stamp_ns[k], counts), window[FRAMES] >= window_frames
        if look and not (full or counts[AWAITED]):
            _fit(s[0], information[0], sizes, p, p_sigma, gain, freedom, p_root)
            if not _stands_out(gain, freedom, slots, counts):
                clean = _as_expected(run, worst, seen, gated, star_frames, star_sums, cell_count,
                                     cell_squares, magnitude_count, magnitude_squares)
                clean = clean and _harmless(E[0], root[0], p, gain, freedom, counts[BEGUN])
                _begin(stamp_ns[k], clean, slots, counts, E[0], s[0], information[0])
                look = False
        if look or full:
            return k + 1, look
    return most, False


def advance(belief: stretch.Values, constants: stretch.Constants, intervals: stretch.Intervals,
            stars: stretch.StretchStars, sums: stretch.TestSums, out: stretch.Gained, most: int
            ) -> tuple[int, bool]:
    """Process ordinary frames: up to one that is none, is to be looked at, or ends a window.

    Parameters
    ----------
    belief, constants, intervals, stars, sums, out
        As described in `stretch`; belief and sums are changed, out is written.
    most : int
        Frames, at most.

    Returns
    -------
    done : int
        Number of frames that were processed.
    look : bool
        Whether the last of them is one to look at (`ModelTests.answer`). Where nothing stands out
        a candidate begins in passing.
    """
    done, look = _advance(*map(tuple, (belief, constants, intervals, stars, sums, out)), most)
    return int(done), bool(look)
