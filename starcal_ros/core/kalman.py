# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Kalman filter steps in square-root form: predict, gate, correct.

The covariance is carried as a root ``P = root @ root.T`` (any root, not only a triangular one),
so that it is positive semidefinite whatever rounding does. Functions are pure; leading axes are
batch axes; measurements are independent pairs (a star's two coordinates).

Predict triangularises ``[Phi root, Q_root]``; correct is the transform of Bierman
(Factorization Methods for Discrete Sequential Estimation, 1977) for all measurements at once ::

    M = R^-1/2 H root                        A = I + M' M = L L'
    root+ = root L'^-1                       K z = root+ L^-1 M' R^-1/2 z

A is the identity plus a square: its Cholesky factor exists for any prior, up to 1e7 times wider
than a measurement, where the identity drowns in rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Mask


class Innovation(NamedTuple):
    """What one set of measurements says before it is used.

    Attributes
    ----------
    whitened : (..., n, 2) array
        z / sigma.
    M : (..., n, 2, n_states) array
        H root / sigma.
    chi2 : (..., n) array
        z' S^-1 z of each pair, S its innovation covariance; two degrees of freedom.
    """

    whitened: Array
    M: Array
    chi2: Array


def predict(root: Array, Phi: Array, Q_root: Array) -> Array:
    """Return the root, (..., n, n) lower triangular, of ``Phi P Phi' + Q_root Q_root'``.

    Parameters
    ----------
    root : (..., n, n) array
        Root of the covariance.
    Phi : (..., n, n) array
        State transition.
    Q_root : (..., n, m) array
        Root of the process noise covariance.
    """
    stacked = np.concatenate((Phi @ root, Q_root), axis=-1)
    triangle = np.linalg.qr(np.swapaxes(stacked, -1, -2), mode='r')
    return np.swapaxes(triangle, -1, -2)


def root_of(covariance: Array) -> Array:
    """Return a root, (..., n, n), of a covariance; what rounding made negative in it is zero."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def sigma_of(root: Array) -> Array:
    """Return the standard deviations, (..., n), that a root (..., n, m) of a covariance states."""
    return np.sqrt(np.einsum('...ij,...ij->...i', root, root))


def marginal(root: Array, k: int) -> Array:
    """Return a root, (..., k, k), of the covariance of the first k of n states."""
    if root.shape[-1] == k:
        return root
    triangle = np.linalg.qr(np.swapaxes(root[..., :k, :], -1, -2), mode='r')
    return np.swapaxes(triangle, -1, -2)


def innovate(root: Array, H: Array, z: Array, sigma: Array) -> Innovation:
    """Whiten measurements and compute the chi-square of each pair.

    Parameters
    ----------
    root : (..., n_states, n_states) array
        Root of the covariance.
    H : (..., n, 2, n_states) array
        Measurement matrix of each pair.
    z : (..., n, 2) array
        Innovation (predicted minus measured, the error being estimate minus truth).
    sigma : (..., n) array
        Standard deviation of both coordinates; infinite for an excluded pair.
    """
    weight = (1.0 / sigma)[..., None]
    whitened = z * weight
    M = (H.reshape(*H.shape[:-3], -1, H.shape[-1]) @ root).reshape(H.shape) * weight[..., None]
    # S / sigma^2 of a pair = I + its 2x2 block of M M', inverted in closed form.
    S_uu = 1.0 + np.einsum('...i,...i->...', M[..., 0, :], M[..., 0, :])
    S_uv = np.einsum('...i,...i->...', M[..., 0, :], M[..., 1, :])
    z_u, z_v = whitened[..., 0], whitened[..., 1]
    gain = S_uv / S_uu
    rest = M[..., 1, :] - gain[..., None] * M[..., 0, :]
    S_rest = 1.0 + gain * gain + np.einsum('...i,...i->...', rest, rest)
    chi2 = z_u * z_u / S_uu + (z_v - gain * z_u)**2 / S_rest
    return Innovation(whitened, M, chi2)


def correct(root: Array, innovation: Innovation, use: Mask) -> tuple[Array, Array, Array]:
    """Return the error estimate, the corrected root and the normalised innovation squared.

    Parameters
    ----------
    root : (..., n_states, n_states) array
        Root of the covariance before the measurements.
    innovation : Innovation
        From `innovate`.
    use : (..., n) bool array
        Pairs to use.

    Returns
    -------
    x : (..., n_states) array
        Estimate of the error.
    root : (..., n_states, n_states) array
        Root of the covariance after the measurements.
    nis : (...) array
        Normalised innovation squared of the pairs used, ``2 * use.sum()`` degrees of freedom.
    """
    n_states = root.shape[-1]
    keep = use[..., None]
    z = np.where(keep, innovation.whitened, 0.0).reshape(*use.shape[:-1], -1)
    M = np.where(keep[..., None], innovation.M, 0.0).reshape(*use.shape[:-1], -1, n_states)
    Mt = np.swapaxes(M, -1, -2)
    L = np.linalg.cholesky(np.eye(n_states) + Mt @ M)
    right = np.concatenate((np.swapaxes(root, -1, -2), Mt @ z[..., None]), axis=-1)
    solved = np.linalg.solve(L, right)
    root_new = np.swapaxes(solved[..., :n_states], -1, -2)
    half = solved[..., n_states]
    x = (root_new @ half[..., None])[..., 0]
    # z' S^-1 z = z' (I - M A^-1 M') z, whitened.
    nis = np.einsum('...i,...i->...', z, z) - np.einsum('...i,...i->...', half, half)
    return x, root_new, nis


class Evidence(NamedTuple):
    """What a set of measurements said, for whoever wants to know whether the model is right.

    ``S^-1 = I - M (I + M' M)^-1 M'`` is never formed: of any directions D of the whitened
    measurements, `half` gives W, and ``D' S^-1 D = D' D - W' W``.

    Attributes
    ----------
    z : (..., m) array
        Whitened innovation, two rows a pair; zero where a pair was not used.
    H : (..., m, n_states) array
        Whitened measurement matrix, likewise.
    M : (..., m, n_states) array
        H root, likewise.
    L : (..., n_states, n_states) array
        Cholesky factor of I + M'M.
    root : (..., n_states, n_states) array
        Root of the covariance after the measurements.
    """

    z: Array
    H: Array
    M: Array
    L: Array
    root: Array

    def half(self, D: Array) -> Array:
        """Return W = L^-1 M' D, (..., n_states, k), of D (..., m, k); root W is their gain."""
        return np.asarray(np.linalg.solve(self.L, np.swapaxes(self.M, -1, -2) @ D), np.float64)

    def explained(self, D: Array) -> tuple[Array, Array]:
        """Return what some directions explain of the innovation.

        The combination of them that fits it best is ``N^-1 v``, of covariance ``N^-1``; it takes
        ``v' N^-1 v`` out of the normalised innovation squared.

        Parameters
        ----------
        D : (..., m, k) array
            Directions of the whitened measurements, zero where a pair was not used.

        Returns
        -------
        N : (..., k, k) array
            D' S^-1 D.
        v : (..., k) array
            D' S^-1 z.
        """
        both = np.concatenate((D, self.z[..., None]), axis=-1)
        W = self.half(both)
        gram = np.swapaxes(both, -1, -2) @ both - np.swapaxes(W, -1, -2) @ W
        return gram[..., :-1, :-1], gram[..., :-1, -1]


def evidence(innovation: Innovation, H: Array, use: Mask, root: Array) -> Evidence:
    """Return what measurements said.

    Parameters
    ----------
    innovation : Innovation
        From `innovate`.
    H : (..., n, 2, n_states) array
        Whitened measurement matrix.
    use : (..., n) bool array
        Pairs that `correct` used.
    root : (..., n_states, n_states) array
        What it returned.
    """
    rows, keep = (*use.shape[:-1], -1), use[..., None]
    z = np.where(keep, innovation.whitened, 0.0).reshape(rows)
    H, M = (np.where(keep[..., None], part, 0.0).reshape(*rows, part.shape[-1])
            for part in (H, innovation.M))
    L = np.linalg.cholesky(np.eye(M.shape[-1]) + np.swapaxes(M, -1, -2) @ M)
    return Evidence(z, H, M, np.asarray(L, np.float64), root)
