# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long the states that are outside their tolerance will take, and which never get there.

Model
-----
The information I = 1 / sigma^2 of a state grows by what the stars add, and what it has fades where
the state walks at random, of density q (`process_noise`) ::

    dI/dt = g - q^2 I^2                                                                (P.1)
    q = 0:   t = (I_tol - I) / g
    q > 0:   t = (artanh(I_tol / I_end) - artanh(I / I_end)) / (q sqrt g),  I_end = sqrt(g) / q

g is what the later half of the run has given, as long as it goes on like that; of the bias at most
1 / N^2, N the angular random walk, since no stars can know a bias better than N / sqrt(T).

Never
-----
Some tolerances can not be met by any motion: the bias of a gyro that leaves N / sqrt(T) above it
for longer than anyone waits, or whose walk keeps it above sqrt(q N); the fixed angles where the
gyro matrix is estimated. A turn of the gyros against the star tracker, ``Psi = -s, X = -[s x]`` of
`gyro_matrix`, is not measured at all: Psi stays as wide as the initial sigmas leave s.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC, NS
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.gyro_matrix import GyroMatrix
from starcal_ros.filter.states import CALIBRATED, EPSILON, PSI, STATE_NAMES

LONGEST_S = 1000.0 * 3600.0
"""What takes longer counts as never [s]."""

BIAS = slice(EPSILON.start - CALIBRATED.start, EPSILON.stop - CALIBRATED.start)
"""Where the bias stands among the 13."""

_LEAST_S = 120.0        # of a run before it says how fast it gains
_KEPT = 200             # points of a run that are kept, at most


class Progress:
    """The information on the 13 calibrated states over a run, at a constant cost."""

    def __init__(self, points: Iterable[tuple[int, Array]] = ()) -> None:
        self._points: list[tuple[int, Array]] = []
        self._apart_ns = 0
        for stamp_ns, sigma in points:
            self.add(stamp_ns, sigma)

    def add(self, stamp_ns: int, sigma: Array) -> None:
        """Take the sigmas, (16,), after a frame; one before the last begins a new run."""
        points = self._points
        if points and stamp_ns < points[-1][0]:
            points.clear()
            self._apart_ns = 0
        if points and stamp_ns < points[-1][0] + self._apart_ns:
            return
        points.append((stamp_ns, sigma[CALIBRATED]**-2.0))
        if len(points) == _KEPT:
            self._apart_ns = (points[-1][0] - points[0][0]) // (_KEPT // 2)
            del points[1::2]

    def remaining_s(self, filter_: Filter, sigma: Array) -> Array | None:
        """Return how long each state will take, (13,) [s]; None while the run is too short.

        Parameters
        ----------
        filter_ : Filter
            With tolerances and process noise.
        sigma : (16,) array
            Present sigmas, in the filter's units.
        """
        stamps = np.array([stamp_ns for stamp_ns, _ in self._points], np.int64)
        if not len(stamps) or (stamps[-1] - stamps[0]) * NS < _LEAST_S:
            return None
        middle = int(np.argmin(np.abs(stamps - (stamps[0] + stamps[-1]) // 2)))
        then, late = self._points[middle][1], self._points[-1][1]
        walk = filter_.density**2
        gain = ((late - then) / ((stamps[-1] - stamps[middle]) * NS)
                + walk * 0.5 * (then**2 + late**2))
        gain[BIAS] = np.minimum(gain[BIAS], filter_.walk**-2.0 if filter_.walk else np.inf)
        return time_to_reach(filter_.tolerance**-2.0, sigma[CALIBRATED]**-2.0, gain,
                             filter_.density)


def time_to_reach(wanted: Array, information: Array, gain: Array, density: Array) -> Array:
    """Return how long it takes from an information to one that is wanted [s], by (P.1).

    Infinite for never.

    Parameters
    ----------
    wanted, information : (k,) arrays
        1 / sigma^2.
    gain : (k,) array
        g, per second.
    density : (k,) array
        q, per root second.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        steady = (wanted - information) / gain
        end = np.sqrt(np.maximum(gain, 0.0)) / density
        walking = (np.arctanh(wanted / end) - np.arctanh(np.minimum(information / end, 1.0))
                   ) / (density * np.sqrt(np.maximum(gain, 0.0)))
    later = np.where(density > 0.0, np.where(wanted < end, walking, np.inf), steady)
    reached = (gain > 0.0) & (later < LONGEST_S)
    return np.where(information >= wanted, 0.0, np.where(reached, later, np.inf))


def unreachable(filter_: Filter) -> dict[str, str]:
    """Return the states whose tolerance can not be reached whatever is done, and why."""
    found = {}
    tolerance, walk = filter_.tolerance, filter_.walk
    for k in range(BIAS.start, BIAS.stop):
        floor = np.sqrt(filter_.density[k] * walk)
        if tolerance[k] < floor:
            found[STATE_NAMES[CALIBRATED.start + k]] = 'the bias walks faster than it can be seen'
        elif (walk / tolerance[k])**2 > LONGEST_S:
            found[STATE_NAMES[CALIBRATED.start + k]] = (
                f'ARW/√T takes {(walk / tolerance[k])**2 / 3600.0:.2g} h')
    turn = _turn_sigma(filter_)
    for k, floor in zip(range(PSI.start, PSI.stop), turn.tolist()):
        if tolerance[k - CALIBRATED.start] < floor:
            found[STATE_NAMES[k]] = (
                'the antisymmetric part of the gyro matrix is a turn of the mounting, known to '
                f'{turn.max() / ARCSEC:.2g} arcsec')
    return found


def _turn_sigma(filter_: Filter) -> Array:
    """Return the sigma, (3,), that no motion takes from a turn of gyros and star tracker."""
    among = _matrix(filter_.augmentation)
    if among is None:
        return np.zeros(3)
    turn = np.zeros((len(filter_.scale), 3))
    turn[PSI] = -np.eye(3)
    turn[among] = -rotation.skew(np.eye(3)).reshape(3, 9).T
    prior = filter_.begin(np.eye(3)).root
    known = np.linalg.solve(prior, turn / filter_.scale[:, None])
    return np.sqrt(np.diag(np.linalg.inv(known.T @ known)))


def _matrix(augmentation: Augmentation) -> slice | None:
    """Return where the gyro matrix stands among the errors; None where it is off."""
    return next((among for state, _, among in augmentation.errors()
                 if isinstance(state, GyroMatrix)), None)
