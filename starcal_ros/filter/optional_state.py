# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a state that may be appended to the 16 has to tell the filter; by default it does nothing.

The filter goes by an error of each state, estimate minus truth, that it counts in the frames in
which what can not be seen stays one and the same direction: a subclass says how that error belongs
to the values, what the state does to the gyro's account of an interval, and what to a frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.filter.rate_noise import NoiseMoments


class Turned(NamedTuple):
    """What a state changes in a preintegrated interval.

    Attributes
    ----------
    turn : (..., 3) array
        The turn of g that the interval's Delta lacks, applied before it, in g [rad].
    J_b : (..., 3, 3) array
        Derivative of the turn by the bias [s].
    J : (..., 3, k) array
        Derivative of the turn by the state's k errors.
    """

    turn: Array
    J_b: Array
    J: Array


class Looked(NamedTuple):
    """What a state does to the directions of a frame: ``r_s = C C_si u_i``.

    Attributes
    ----------
    C : (..., 3, 3) array
        Rotation of the star tracker, in s.
    slope : (..., 3, k) array
        Rotation vector, in s, by which the estimate is off for each of the state's k errors.
    """

    C: Array
    slope: Array


class Drawn(NamedTuple):
    """What the noise of the gyro adds to what a frame says of a state, on average.

    Attributes
    ----------
    score : (..., k) array
        To the score of the state's errors.
    information : (..., k) array
        To the information on each, which is none.
    """

    score: Array
    information: Array


class OptionalState:
    """One state of k numbers, off unless its initial sigma is given.

    Attributes
    ----------
    key : str
        Field of `AugmentConfig` that holds its initial sigma, in `unit`.
    names : tuple of str
        Its k names in results, with the unit.
    unit : float
        That unit, in the unit that the filter counts in.
    scale : float
        What the filter divides the errors by.
    needs_matrix : bool
        Whether `preintegration` has to give the derivative by the gyro matrix.
    effects : tuple of int
        Of `hypotheses`, those that it is: not left out any more.
    """

    key: str
    names: tuple[str, ...]
    unit = 1.0
    scale = 1e-5
    needs_matrix = False
    effects: tuple[int, ...] = ()

    def error(self, values: Array, true: Array, C_sg: Array) -> Array:
        """Return the error (..., k) of values (..., k); C_sg (..., 3, 3) is the estimate's."""
        return values - true

    def freed(self, values: Array, error: Array, C_sg: Array) -> Array:
        """Return the values freed of an error (..., k): undoes `error`."""
        return values - error

    def outer(self, root: Array, values: Array, C_sg: Array) -> Array:
        """Return rows (..., k, n) of a root of the covariance, of the errors, for the values."""
        return root

    def gain(self, values: Array) -> Array:
        """Return G, (..., 3, 3): the rate of g is G (reading - bias)."""
        return np.eye(3)

    def turned(self, J: Array, d: Array, values: Array, C_sg: Array, gain: Array
               ) -> Turned | None:
        """Return what the state changes in an interval; None for nothing.

        Parameters
        ----------
        J : (..., 3, 3) or (..., 3, 12) array
            `Preintegrated.J`: derivatives by the bias [s], and by the gyro matrix where it is
            asked for.
        d : (..., 3) array
            `gain` times what the present bias is larger by than that of the preintegration
            [rad/s].
        values : (..., k) array
            Present values.
        C_sg : (..., 3, 3) array
            Mounting.
        gain : (..., 3, 3) array
            `Preintegrated.gain`.
        """
        return None

    def integrated(self, turn: Array) -> Array | None:
        """Return how a turn (n, 3) of g depends on the values, (n, 3, k); None for not at all."""
        return None

    def displaced(self, uv_raster: Array, sigma: Array) -> Array | None:
        """Return how centroids depend on the values, (..., n, 2, k); None for not at all.

        What is measured is displaced by that times the values.

        Parameters
        ----------
        uv_raster : (..., n, 2) array
            Predicted centroids [px].
        sigma : (..., n) array
            Of their errors, each axis [px].
        """
        return None

    def drawn(self, N: Array, T: Array, moments: NoiseMoments, values: Array) -> Drawn | None:
        """Return what the noise of the gyro adds; None where the state does not go with the rate.

        Parameters
        ----------
        N : (..., 3, 3) array
            q^2 A' S^-1 A of `rate_noise`.
        T : (...) array
            Length of the interval [s].
        moments : NoiseMoments
            Before the frame.
        values : (..., k) array
            Present values.
        """
        return None

    def looked(self, values: Array, C_sg: Array, rate_g: Array) -> Looked | None:
        """Return what the state does to a frame; None for nothing.

        Parameters
        ----------
        values : (..., k) array
            Present values.
        C_sg : (..., 3, 3) array
            Mounting.
        rate_g : (..., 3) array
            Rate of g at the frame's stamp, in g, noise left out (`rate_noise.steady`) [rad/s].
        """
        return None
