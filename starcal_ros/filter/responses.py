# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a filter does with an effect that its model lacks, and how large the innovations say it is.

Model
-----
An effect of unknown size p, (3,), that the filter knows nothing of, moves the error of its states
by ``E p`` and its innovation by ``D p``, both whitened or scaled as in `core.kalman`. With a shift
V of the errors over an interval and a direct effect d on the measurements ::

    E <- Phi E + V,      D = H E + d,      E <- E - K D                                (R.1)
    s += D' S^-1 z,      I += D' S^-1 D                                                (R.2)

Where the model is right s is of mean 0 and covariance I. Where it lacks the effect alone, the best
estimate of it is ``p = I^-1 s`` of covariance ``I^-1``, as if p had been a state all the time:
Friedland, *Treatment of bias in recursive filtering*, IEEE Transactions on Automatic Control
14(4), 1969; for effects that begin at some time Willsky and Jones, *A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems*, same journal 21(1), 1976.
``2 log`` of the likelihood ratio is ``s' I^-1 s``, chi-square of as many degrees of freedom as
numbers of p can be told.

Any number of effects, each for itself, share the arithmetic of a frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.kalman import Evidence

WIDTH = 3
"""Numbers of an effect, at most."""

TOLD = 10.0
"""Information on the largest p that is thought of, for it to be told."""
UNTOLD = 0.5
"""Part of a number that lies in directions that are not told, for it not to be told."""


class Fit(NamedTuple):
    """The sizes of some effects that fit best, each alone.

    Attributes
    ----------
    p : (g, 3) array
        Sizes, 0 where they can not be told.
    sigma : (g, 3) array
        Their standard deviations, infinite likewise.
    gain : (g,) array
        s' I^-1 s.
    freedom : (g,) int64 array
        Its degrees of freedom.
    root : (g, 3, 3) array
        Root of the covariance of p.
    """

    p: Array
    sigma: Array
    gain: Array
    freedom: Ints
    root: Array


def respond(said: Evidence, d: Array, judged: Mask, E: Array, s: Array, information: Array
            ) -> None:
    """Take a frame in, in place, Eq. (R.1) and (R.2).

    Parameters
    ----------
    said : Evidence
    d : (..., m, 3 n_effects) array
        Direct effect on the whitened measurements.
    judged : (...) bool array
        Whether the frame tells of the sizes; the errors respond all the same.
    E, s, information : arrays
        See `Responses`.
    """
    D = said.H @ E + d
    both = np.concatenate((D, said.z[..., None]), axis=-1)
    W = said.half(both)
    E -= said.root @ W[..., :-1]
    gain = np.swapaxes(both, -1, -2) @ both[..., -1:] - np.swapaxes(W, -1, -2) @ W[..., -1:]
    D, W = (np.moveaxis(part.reshape(*part.shape[:-1], -1, WIDTH), -2, -3)
            for part in (D, W[..., :-1]))
    told = np.swapaxes(D, -1, -2) @ D - np.swapaxes(W, -1, -2) @ W
    s += np.where(judged[..., None, None], gain[..., :-1, 0].reshape(s.shape), 0.0)
    information += np.where(judged[..., None, None, None], told, 0.0)


def fitted(s: Array, information: Array, largest: Array) -> Fit:
    """Return the sizes that fit best, of one run.

    Parameters
    ----------
    s, information, largest : arrays
        See `Responses`.
    """
    # In units of the largest; a direction of which little is known is left out.
    size = largest
    values, vectors = np.linalg.eigh(information * size[:, :, None] * size[:, None, :])
    told = values > TOLD
    inverse = np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)
    along = np.einsum('gij,gi->gj', vectors, s * size)
    p = size * np.einsum('gij,gj->gi', vectors, along * inverse)
    root = size[:, :, None] * vectors * np.sqrt(inverse)[:, None, :]
    known = np.einsum('gij,gj->gi', vectors**2, (~told).astype(float)) < UNTOLD
    return Fit(p, np.where(known & (size > 0.0), np.linalg.norm(root, axis=-1), np.inf),
               np.sum(along**2 * inverse, axis=-1), told.sum(axis=-1), root)


class Responses:
    """The responses to some effects.

    Parameters
    ----------
    batch : tuple of int
        Leading axes.
    n_states, n_effects : int
    largest : (n_effects, 3) array
        The largest p that is thought of; 0 where an effect has fewer numbers.

    Attributes
    ----------
    largest : (n_effects, 3) array
        As given.
    E : (..., n_states, 3 n_effects) array
        Response of the scaled errors.
    s : (..., n_effects, 3) array
    information : (..., n_effects, 3, 3) array
        Eq. (R.2).
    """

    def __init__(self, batch: tuple[int, ...], n_states: int, largest: Array) -> None:
        self.largest = largest
        self.E = np.zeros((*batch, n_states, largest.size))
        self.s = np.zeros((*batch, *largest.shape))
        self.information = np.zeros((*batch, *largest.shape, WIDTH))

    def begin(self, effect: int, E: Array) -> None:
        """Let an effect begin now, with the response (n_states, 3) or (..., n_states, 3)."""
        self.E[..., WIDTH * effect:WIDTH * (effect + 1)] = E
        self.s[..., effect, :] = 0.0
        self.information[..., effect, :, :] = 0.0

    def forget(self, rows: slice) -> None:
        """Let some states be found anew: their errors owe nothing to any effect."""
        self.E[..., rows, :] = 0.0

    def of(self, effect: int) -> Array:
        """Return the response to one effect, (..., n_states, 3)."""
        return self.E[..., WIDTH * effect:WIDTH * (effect + 1)]
