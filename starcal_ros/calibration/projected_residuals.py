# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What camera and attitudes leave of the residuals of stars, and the tests of what is left.

Here are equations (T.1) to (T.3) of `residual_tests`. Attitudes are projected out frame by frame,
and then the camera: the projector is never made.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.fitted_stars import FittedStars
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.distributions import f_isf, f_ppf
from starcal_ros.core.statistic import ALARM, Statistic

SCATTER = 2.0
"""Factor by which the variance of a cell or a brightness may differ from that of the rest."""
LEAST = 30
"""Degrees of freedom before a statistic says anything."""
_RANK = 1e-7            # singular value, of the largest, from which a column counts
_LEFT = 1e-3            # part of a direction that camera and attitudes must leave


class ProjectedResiduals:
    """What camera and attitudes leave of the residuals of some stars, Eq. (T.1).

    Parameters
    ----------
    stars : FittedStars
    by_camera : (n, 2, p) array
        Derivatives by the camera, as in `stars`; of a camera that has taken no part, p = 0.

    Attributes
    ----------
    squares : float
        z'P z.
    freedom : int
        m.
    """

    def __init__(self, stars: FittedStars, by_camera: Array) -> None:
        self._first = np.flatnonzero(np.diff(stars.frame, prepend=-1))
        self._row = np.unique(stars.frame, return_inverse=True)[1]
        self._Q_a, attitudes = self._basis_of_attitudes(stars.by_attitude)
        H = self._turned_out(by_camera).reshape(2 * len(self._row), -1)
        length = np.linalg.norm(H, axis=0)
        U, s, _ = np.linalg.svd(H / np.where(length > 0.0, length, 1.0), full_matrices=False)
        self._Q_c = U[:, s > _RANK * s.max(initial=0.0)]
        self._A = self._Q_c.T @ H           # slopes of the camera in that basis
        z = self._turned_out(stars.z[..., None]).reshape(-1)
        self._t = self._Q_c.T @ z
        self._z = z - self._Q_c @ self._t
        self.squares = float(self._z @ self._z)
        self.freedom = 2 * len(self._row) - attitudes - self._Q_c.shape[1]
        self._of_star = (2.0 - np.sum(self._Q_a**2, axis=(1, 2))
                         - np.sum(self._Q_c**2, axis=1).reshape(-1, 2).sum(axis=1))

    def _basis_of_attitudes(self, H: Array) -> tuple[Array, int]:
        """Return orthonormal columns, (n, 2, 3), that span those of a frame, and all ranks."""
        values, V = np.linalg.eigh(np.add.reduceat(np.swapaxes(H, 1, 2) @ H, self._first, axis=0))
        counts = values > _RANK**2 * values[:, -1:]
        inverse = np.where(counts, 1.0 / np.sqrt(np.where(counts, values, 1.0)), 0.0)
        return H @ (V * inverse[:, None, :])[self._row], int(counts.sum())

    def _turned_out(self, D: Array) -> Array:
        """Return vectors, (n, 2, k), less what attitudes explain of them."""
        share = np.add.reduceat(np.swapaxes(self._Q_a, 1, 2) @ D, self._first, axis=0)
        out: Array = D - self._Q_a @ share[self._row]
        return out

    def pattern(self, name: str, directions: Array, C: Array | None
                ) -> tuple[Statistic, Array] | None:
        """Return the score test of directions, (n, 2, k), Eq. (T.2); None with too few stars.

        Beside it stands the square of the shift of the camera, in sigmas of the covariance C,
        that comes of leaving the direction that explains most out of the model; 0 where there is
        no covariance.
        """
        D = directions / np.maximum(np.linalg.norm(directions, axis=(0, 1)), 1e-30)
        D = self._turned_out(D).reshape(len(self._z), -1)
        of_camera = self._Q_c.T @ D
        D -= self._Q_c @ of_camera
        G, q = D.T @ D, D.T @ self._z
        values, V = np.linalg.eigh(G)
        values, V = values[values > _LEFT**2], V[:, values > _LEFT**2]
        k, rest = V.shape[1], self.freedom - V.shape[1]
        if not k or rest < LEAST:
            return None
        explained = float(np.sum((V.T @ q)**2 / values))
        value = explained / k / ((self.squares - explained) / rest)
        test = Statistic(name, value, 0.0, float(f_isf(ALARM, k, rest)), k)
        if C is None:
            return test, np.zeros(1)
        left = np.maximum(np.diag(G), _LEFT**2)
        most = int(np.argmax(q**2 / left))
        shift = np.linalg.lstsq(self._A, of_camera[:, most] * q[most] / left[most], rcond=None)[0]
        return test, shift**2 / np.diag(C)

    def agreement(self, name: str, C: Array, variance: float) -> Statistic:
        """Return the test of a camera with the covariance C, Eq. (T.3)."""
        S = np.eye(len(self._t)) + self._A @ C @ self._A.T
        k = len(self._t)
        value = float(self._t @ np.linalg.solve(S, self._t)) / k / variance
        return Statistic(name, value, 0.0, float(f_isf(ALARM, k, self.freedom)), k)

    def scatter(self, name: str, *groupings: Ints) -> list[Statistic]:
        """Return the test of that group of stars, each (n,), whose scatter differs most."""
        return self.scatter_of(name, *(
            group == k for group in groupings for k in range(int(group.max()) + 1)))

    def scatter_of(self, name: str, *groups: Mask) -> list[Statistic]:
        """Return the test of that of some groups, each (n,), whose scatter differs most."""
        of_star = np.sum(self._z.reshape(-1, 2)**2, axis=1)
        pairs = [(float(of_star[group].sum()), float(self._of_star[group].sum()))
                 for group in groups]
        pairs = [(squares, freedom) for squares, freedom in pairs
                 if LEAST <= freedom <= self.freedom - LEAST]
        half, found = ALARM / 2.0 / max(len(pairs), 1), []
        for squares, freedom in pairs:
            rest = self.freedom - freedom
            ratio = squares / freedom / ((self.squares - squares) / rest)
            low, high = f_ppf([half, 1.0 - half], freedom, rest)
            found.append(Statistic(name, ratio, float(low) / SCATTER,
                                   float(high) * SCATTER, len(pairs)))
        return [max(found, key=lambda each: max(each.value / each.high, each.low / each.value))
                ] if found else []

    def squares_beside(self, by_camera: Array, C: Array) -> float:
        """Return z'P z, a camera with an error of the covariance C taken for a part of the noise.

        Parameters
        ----------
        by_camera : (n, 2, p) array
            d (predicted centroid) / d camera, which is not yet out.
        C : (p, p) array
        """
        M = self._turned_out(by_camera).reshape(len(self._z), -1) @ _root(C)
        b = M.T @ self._z
        return self.squares - float(b @ np.linalg.solve(np.eye(len(C)) + M.T @ M, b))


def _root(C: Array) -> Array:
    """Return a matrix whose square, times its transpose, is a covariance."""
    try:
        return np.asarray(np.linalg.cholesky(C + 1e-30 * np.eye(len(C))))
    except np.linalg.LinAlgError:       # of parameters that do nearly the same
        values, V = np.linalg.eigh(C)
        return np.asarray(V * np.sqrt(np.maximum(values, 0.0)))
