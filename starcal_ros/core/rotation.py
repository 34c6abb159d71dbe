# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""SO(3) on arrays: matrices, quaternions, exponential and logarithm.

Every function takes leading batch dimensions. ``C_ab`` takes components in b to components in a;
a quaternion is scalar-last (x, y, z, w) and means the same rotation as its matrix. The sign of
``exp`` is ``exp(phi) = I + [phi x] + ...``.

scipy's ``Rotation`` does the same for one flat batch; it costs 10 us a call and takes no leading
axes, which the filter's inner loop can not afford.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array

_GENERATORS: Array = np.zeros((3, 3, 3))
_GENERATORS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0
_GENERATORS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0
_GENERATORS = np.ascontiguousarray(_GENERATORS.transpose(2, 0, 1).reshape(3, 9))


def skew(v: Array) -> Array:
    """Return [v x], (..., 3, 3), with ``skew(v) @ w = cross(v, w)``."""
    return (v @ _GENERATORS).reshape(*v.shape[:-1], 3, 3)


def exp(phi: Array) -> Array:
    """Return the rotation matrix exp([phi x]), (..., 3, 3), of a rotation vector [rad]."""
    return to_matrix(exp_quaternion(phi))


def exp_quaternion(phi: Array) -> Array:
    """Return the quaternion, (..., 4), of a rotation vector (..., 3) [rad]."""
    half = 0.5 * np.sqrt(np.einsum('...i,...i->...', phi, phi))[..., None]
    small = half < 1e-8                 # sin(half) / half is 1 to the last bit
    q = np.empty((*phi.shape[:-1], 4))
    q[..., :3] = phi * np.where(small, 0.5, 0.5 * np.sin(half) / np.where(small, 1.0, half))
    q[..., 3:] = np.cos(half)
    return q


def right_jacobian(phi: Array) -> Array:
    """Return J, (..., 3, 3), with ``exp(phi + d) = exp(phi) exp(J d)`` for small d."""
    square = np.einsum('...i,...i->...', phi, phi)[..., None, None]
    angle = np.sqrt(square)
    small = angle < 1e-3                # the next terms of the series are below 1e-9
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    cross = skew(phi)
    return np.eye(3) - first * cross + second * (cross @ cross)


def log(C: Array) -> Array:
    """Return the rotation vector (..., 3), of length pi at most, of a rotation matrix [rad]."""
    q = to_quaternion(C)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.sqrt(np.einsum('...i,...i->...', q[..., :3], q[..., :3]))[..., None]
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    small = sine < 1e-8
    return q[..., :3] * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def to_matrix(q: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of a unit quaternion (..., 4)."""
    x, y, z, w = (q[..., k] for k in range(4))
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    C = np.empty((*q.shape[:-1], 3, 3))
    C[..., 0, 0], C[..., 0, 1], C[..., 0, 2] = 1.0 - (yy + zz), xy - wz, xz + wy
    C[..., 1, 0], C[..., 1, 1], C[..., 1, 2] = xy + wz, 1.0 - (xx + zz), yz - wx
    C[..., 2, 0], C[..., 2, 1], C[..., 2, 2] = xz - wy, yz + wx, 1.0 - (xx + yy)
    return C


def to_quaternion(C: Array) -> Array:
    """Return the unit quaternion (..., 4) of a rotation matrix (..., 3, 3).

    Each of the four columns of 4 q q^T holds the quaternion times one of its own components; the
    one with the largest component is well conditioned (Shepperd 1978).
    """
    xx, yy, zz = C[..., 0, 0], C[..., 1, 1], C[..., 2, 2]
    outer = np.empty((*C.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + xx - yy - zz
    outer[..., 1, 1] = 1.0 - xx + yy - zz
    outer[..., 2, 2] = 1.0 - xx - yy + zz
    outer[..., 3, 3] = 1.0 + xx + yy + zz
    for i, j, value in ((0, 1, C[..., 0, 1] + C[..., 1, 0]),
                        (0, 2, C[..., 0, 2] + C[..., 2, 0]),
                        (1, 2, C[..., 1, 2] + C[..., 2, 1]),
                        (0, 3, C[..., 2, 1] - C[..., 1, 2]),
                        (1, 3, C[..., 0, 2] - C[..., 2, 0]),
                        (2, 3, C[..., 1, 0] - C[..., 0, 1])):
        outer[..., i, j] = outer[..., j, i] = value
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, best[..., None, None], axis=-1)[..., 0]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def from_fixed_angles(angles: Array) -> Array:
    """Return ``C_sg = Rz(z) Ry(y) Rx(x)`` of fixed angles (..., 3) [rad]."""
    x, y, z = (exp(angles[..., i, None] * axis) for i, axis in enumerate(np.eye(3)))
    return z @ y @ x


def to_fixed_angles(C_sg: Array) -> Array:
    """Return the fixed angles (..., 3) of a mounting matrix, y in [-pi/2, pi/2] [rad]."""
    x = np.arctan2(C_sg[..., 2, 1], C_sg[..., 2, 2])
    y = np.arctan2(-C_sg[..., 2, 0], np.hypot(C_sg[..., 0, 0], C_sg[..., 1, 0]))
    # Not from the first column, which vanishes at y = 90 deg: from C_sg Rx(-x) = Rz(z) Ry(y).
    sin, cos = np.sin(x), np.cos(x)
    z = np.arctan2(sin * C_sg[..., 0, 2] - cos * C_sg[..., 0, 1],
                   cos * C_sg[..., 1, 1] - sin * C_sg[..., 1, 2])
    return np.stack((x, y, z), axis=-1)


def orthonormalized(C: Array) -> Array:
    """Return the rotation nearest to a matrix that rounding has moved off SO(3).

    One Newton step of the polar decomposition; the error left is the square of the one given.
    """
    return 1.5 * C - 0.5 * C @ np.swapaxes(C, -1, -2) @ C


def wahba(B: Array) -> Array:
    """Return the rotation C, (..., 3, 3), that maximises tr(C' B), B the sum of r_a r_b'.

    It takes the directions r_b nearest to the r_a: Wahba's problem, by singular values (Markley,
    Journal of the Astronautical Sciences 36, 1988).
    """
    U, _, Vt = np.linalg.svd(B)
    U[..., :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[..., None]
    return U @ Vt
