# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the stars of a recording trail while the camera turns.

A tracker that turns smears its stars, Eq. (E.2) of `measurement_model`. A recording that was
simulated without, or whose sender's sigma holds the trail already, scatters along it as across.
The data tell: along the trail a the whitened innovation w of a star has the variance ::

    v = 1 + m where it trails,    v = 1 / (1 + a'a) + m where it does not                 (Y.1)

m being what the prediction adds. The logarithm of the ratio of both likelihoods is summed over
stars that move, until one of the two is beyond doubt.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.filter.states import THETA
from starcal_ros.measurements.samples import Stars

_BEYOND_DOUBT = 25.0    # of the log likelihood ratio: one in 7e10
_MOVES = 0.3            # length of a trail from which on it tells something, in sigmas of the spot


class TrailTest:
    """The test of one run.

    Parameters
    ----------
    trails : bool
        Whether stars are taken to trail; if not, there is nothing to test.

    Attributes
    ----------
    open : bool
        Whether there is still something to find out.
    """

    def __init__(self, trails: bool) -> None:
        self.open, self._evidence = trails, 0.0

    def denies(self, filter_: Filter, predicted: Nominal, stars: Stars, update: Update) -> bool:
        """Take a frame; return true once, when it is beyond doubt that the stars do not trail.

        Parameters
        ----------
        filter_ : Filter
        predicted : Nominal
            Before the frame.
        stars : Stars
            The frame.
        update : Update
            What it did, with its evidence.
        """
        said = update.evidence
        if not self.open or said is None or not update.linear:
            return False
        _, H, _ = filter_.model.predict(predicted, stars.u_i)
        trail = filter_.model.trail(predicted, H[..., THETA])
        moves = update.accepted & (np.sum(trail * trail, axis=-1) > _MOVES**2)
        if not moves.any():
            return False
        along = filter_.model.whitened(predicted, H, trail)[1][moves]
        squared = np.sum(along * along, axis=-1)                # a'a / (1 + a'a)
        along = along / np.sqrt(squared)[:, None]
        z = said.z.reshape(-1, 2)[moves]
        M = said.M.reshape(len(stars.sigma), 2, -1)[moves]
        w2 = np.sum(z * along, axis=-1)**2
        m = np.sum(np.einsum('ni,nij->nj', along, M)**2, axis=-1)
        trailing, resting = 1.0 + m, 1.0 - squared + m
        self._evidence += 0.5 * float(np.sum(
            w2 / trailing - w2 / resting + np.log(trailing / resting)))
        self.open = abs(self._evidence) < _BEYOND_DOUBT
        return self._evidence >= _BEYOND_DOUBT
