# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How likely a model makes the frames: what models are compared by.

Model
-----
The innovations of all frames are independent, of covariance S, so that the probability density of
what was measured is the product of theirs; twice its logarithm, for the n stars that were used ::

    2 log L = sum (n 2 ln A - 2 n ln 2 pi - ln det S - z' S^-1 z)                        (G.1)

It is counted against stars that may be anywhere on the detector, of density 1 / A each, which is
what a star is to a model that does not use it: of the same frames no model gains by rejecting
more of them, and a frame that is not used counts nothing. ``ln det S`` is that of the sigmas and
of ``I + M' M`` (`core.kalman`). What trails add to it is left out, the same for all models.

The first frames are left out, too: there the linear model is not good to what is asked here.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.units import NS

BEGIN_S = 10.0
"""Time from the first frame on of which nothing is counted [s]."""


def log_det(sigma: Array, accepted: Mask, L: Array) -> Array:
    """Return ln det S, (...), of the stars that were used.

    Parameters
    ----------
    sigma : (..., n) array
        Of the stars [px].
    accepted : (..., n) bool array
        Those that were used.
    L : (..., k, k) array
        Cholesky factor of I + M'M.
    """
    stars = np.sum(np.log(np.where(accepted, sigma, 1.0)), axis=-1)
    return 4.0 * stars + 2.0 * np.sum(np.log(np.einsum('...ii->...i', L)), axis=-1)


class Likelihood:
    """Twice the logarithm of the likelihood of one run, or of all runs of a batch.

    Attributes
    ----------
    twice_log : (...) array
        Eq. (G.1).
    """

    def __init__(self, detector: Detector) -> None:
        self._free = 2.0 * np.log(detector.width * detector.height) - 2.0 * np.log(2.0 * np.pi)
        self._first_ns: int | None = None
        self.twice_log: Array = np.zeros(())

    def add(self, stamp_ns: Ints, used: Ints, log_det: Array, nis: Array) -> None:
        """Take frames in, one after the other.

        Parameters
        ----------
        stamp_ns : (m,) int64 array
        used : (m, ...) int64 array
            Number of stars that were used.
        log_det : (m, ...) array
            Their ln det S.
        nis : (m, ...) array
            Their z' S^-1 z.
        """
        if self._first_ns is None:
            self._first_ns = int(stamp_ns[0])
        begun = (stamp_ns - self._first_ns) * NS >= BEGIN_S
        gains = np.where(np.isfinite(nis), used * self._free - log_det - nis, 0.0)[begun]
        # One after the other, and so the same however many come at once.
        self.twice_log = np.add.accumulate(np.concatenate((
            np.broadcast_to(self.twice_log, (1, *gains.shape[1:])), gains)))[-1]
