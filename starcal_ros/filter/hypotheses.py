# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Effects that the model leaves out and data show: what each would do, from the first frame on.

Each is a row of `HYPOTHESES`: what it is called, its numbers and their units, and the size up to
which it is thought of. `direct` says what they do to the centroids of a frame, `shift` to the
errors of the states over an interval; `responses` does the rest. Signs are those of the truth: a
time offset is positive where a frame shows the sky of later than its stamp, a scale factor where
the gyro reads too much, a drift where the state grows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.kalman import Evidence
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR
from starcal_ros.filter.frame_innovation import CELLS, cell_of
from starcal_ros.filter.responses import WIDTH
from starcal_ros.filter.states import EPSILON, PSI, SCALE, STATE_NAMES, THETA

_U0, _V0, _F = (STATE_NAMES.index(name) for name in ('u0', 'v0', 'f'))
_HOUR = 3600.0
_PAIRS = (0, 1), (0, 2), (1, 2)

KM_S = 1.0 / 299792.458
"""A kilometre a second, of the speed of light."""
MIDDLE_MAGNITUDE = 5.0
"""Magnitude that is not displaced with the magnitude."""


class Hypothesis(NamedTuple):
    """An effect.

    Attributes
    ----------
    name : str
        What it is called.
    numbers : tuple of str
        Its numbers, with their units.
    largest : float or (n,) array
        The largest that is thought of.
    """

    name: str
    numbers: tuple[str, ...]
    largest: float | Array


TIME, SCALE_FACTORS, MISALIGNMENTS, VELOCITY, LENS_TERMS, PHASE_U, PHASE_V, MAGNITUDE = range(8)
DRIFTS = slice(8, 12)
CELL = slice(12, 12 + CELLS * CELLS)
CHANGING = ('gyro bias', 'mounting of the star tracker',
            'mounting of the gyros', 'camera')
"""What may step or drift. Of the two turns only the first is seen at once."""
STEP_NUMBERS = (('x deg/h', 'y deg/h', 'z deg/h'), *(('x arcsec', 'y arcsec', 'z arcsec'),) * 2,
                ('u0 px', 'v0 px', 'f um'))
LARGEST_STEPS = np.array([[1e4, 1e4, 1e4], [3600.0, 3600.0, 3600.0], [3600.0, 3600.0, 3600.0],
                          [100.0, 100.0, 1000.0]])
"""Largest step of each of `CHANGING` that is thought of, in units of `STEP_NUMBERS`.

In a slow turn the innovations of a step of the bias are those of gyros that are turned by a right
angle as well. Without a bound that turn is fitted, where errors are far from linear, and opens the
covariance by directions that are none.
"""
HYPOTHESES = (
    Hypothesis('time offset of the frames', ('ms',), 1e3),
    Hypothesis('gyro scale factors', ('xx ppm', 'yy ppm', 'zz ppm'), 1e5),
    Hypothesis('gyro misalignments', ('xy ppm', 'xz ppm', 'yz ppm'), 1e5),
    Hypothesis('velocity of the observer', ('x km/s', 'y km/s', 'z km/s'), 1e3),
    Hypothesis('lens terms that the model lacks',
               ('r^7 px', 'aspect px', 'skew px'), 1e3),
    Hypothesis('pixel phase along u', ('sine px', 'cosine px'), 1.0),
    Hypothesis('pixel phase along v', ('sine px', 'cosine px'), 1.0),
    Hypothesis('displacement with the magnitude', ('u px/mag', 'v px/mag'), 10.0),
    *(Hypothesis(f'drift of the {name}', tuple(f'{number} per h' for number in numbers), most)
      for name, numbers, most in zip(CHANGING, STEP_NUMBERS, LARGEST_STEPS)),
    *(Hypothesis(f'cell {row + 1}, {column + 1} of the detector', ('u px', 'v px'), 10.0)
      for row in range(CELLS) for column in range(CELLS)))

STEPS = np.zeros((4, len(SCALE), WIDTH))
"""Change of the scaled states for a step of each of `CHANGING`, in units of `STEP_NUMBERS`."""
STEPS[0, EPSILON] = np.eye(3) * DEG_PER_HOUR / SCALE[EPSILON]
STEPS[1, THETA] = STEPS[1, PSI] = STEPS[2, PSI] = np.eye(3) * ARCSEC / SCALE[PSI]
STEPS[3, [_U0, _V0, _F], range(3)] = np.array([1.0, 1.0, 1e-3]) / SCALE[[_U0, _V0, _F]]


def largest() -> Array:
    """Return the sizes up to which the effects are thought of, (n, 3)."""
    sizes = np.zeros((len(HYPOTHESES), WIDTH))
    for row, each in zip(sizes, HYPOTHESES):
        row[:len(each.numbers)] = each.largest
    return sizes


def hourly() -> Array:
    """Return what each drift does to the scaled errors in a second, (16, 4, 3)."""
    return -np.swapaxes(STEPS, 0, 1) / _HOUR


def shift(C_gi_before: Array, C_gi: Array, C_sg: Array, Delta: Array, J: Array, dt: Array,
          n_states: int) -> Array:
    """Return what the effects do to the scaled errors over an interval, (..., n_states, 3 n).

    Parameters
    ----------
    C_gi_before, C_gi : (..., 3, 3) arrays
        Attitude at its beginning and its end.
    C_sg : (..., 3, 3) array
        Mounting.
    Delta, J, dt : arrays
        Turn, its derivative by the bias, and duration, of `preintegration`.
    n_states : int
    """
    V = np.zeros((*dt.shape, n_states, len(HYPOTHESES), WIDTH))
    # C is 1 - [turn x] to first order.
    C = C_gi @ np.swapaxes(C_gi_before, -1, -2)
    turn = 0.5 * np.stack((C[..., 1, 2] - C[..., 2, 1], C[..., 2, 0] - C[..., 0, 2],
                           C[..., 0, 1] - C[..., 1, 0]), axis=-1)
    rate = turn / np.maximum(dt, 1e-9)[..., None]
    # As an error of the bias turns theta, so does what M reads too much (A.2 of `gyro_matrix`).
    B = -(C_sg @ Delta @ J[..., :3]) * (1e-6 / SCALE[0])
    V[..., THETA, SCALE_FACTORS, :] = B * rate[..., None, :]
    for column, (i, j) in enumerate(_PAIRS):
        V[..., THETA, MISALIGNMENTS, column] = (B[..., i] * rate[..., j, None]
                                                + B[..., j] * rate[..., i, None])
    V[..., :len(SCALE), DRIFTS, :] = hourly() * dt[..., None, None, None]
    return V.reshape(*V.shape[:-2], WIDTH * len(HYPOTHESES))


class Sight(NamedTuple):
    """Where the stars of a frame are seen.

    Attributes
    ----------
    u_i : (..., n, 3) array
        Their apparent places.
    uv : (..., n, 2) array
        Centroids, from the centre of the detector [px].
    magnitude : (..., n) array
        NaN where it is not known.
    half : (2,) array
        Half of the detector [px].
    """

    u_i: Array
    uv: Array
    magnitude: Array
    half: Array


def direct(said: Evidence, C_si: Array, rate_s: Array, sight: Sight) -> Array:
    """Return what the effects do to the whitened innovation of a frame, (..., 2 n, 3 n).

    Parameters
    ----------
    said : Evidence
        Of the frame.
    C_si : (..., 3, 3) array
        Attitude of the star tracker before it.
    rate_s : (..., 3) array
        Rate of the camera, in s [rad/s].
    sight : Sight
    """
    d = np.zeros((*said.z.shape, len(HYPOTHESES), WIDTH))
    H_s = said.H[..., THETA] / SCALE[0]
    d[..., TIME, 0] = 1e-3 * (H_s @ rate_s[..., None])[..., 0]
    r_s = np.repeat(sight.u_i @ np.swapaxes(C_si, -1, -2), 2, axis=-2)
    d[..., VELOCITY, :] = -KM_S * np.cross(H_s, r_s) @ C_si
    # A shift of the measured u is one of u0 with the other sign.
    along_u, along_v = (-said.H[..., column] / SCALE[column] for column in (_U0, _V0))

    def moved(effect: int, column: int, u: Array | None, v: Array | None) -> None:
        for whitened, by in ((along_u, u), (along_v, v)):
            if by is not None:
                d[..., effect, column] += whitened * np.repeat(by, 2, axis=-1)

    corner = float(np.hypot(*sight.half))
    x, y = sight.uv[..., 0] / corner, sight.uv[..., 1] / corner
    r6 = (x * x + y * y)**3
    moved(LENS_TERMS, 0, x * r6, y * r6)
    moved(LENS_TERMS, 1, x, -y)
    moved(LENS_TERMS, 2, y, x)
    phase = 2.0 * np.pi * sight.uv
    for column, wave in enumerate((np.sin(phase), np.cos(phase))):
        moved(PHASE_U, column, wave[..., 0], None)
        moved(PHASE_V, column, None, wave[..., 1])
    fainter = np.nan_to_num(sight.magnitude - MIDDLE_MAGNITUDE)
    moved(MAGNITUDE, 0, fainter, None)
    moved(MAGNITUDE, 1, None, fainter)
    number = np.repeat(CELL.start + cell_of(sight.uv, sight.half), 2, axis=-1)
    for column, whitened in enumerate((along_u, along_v)):
        np.put_along_axis(d[..., column], number[..., None], whitened[..., None], axis=-1)
    return d.reshape(*said.z.shape, WIDTH * len(HYPOTHESES))


def drawn(N: Array, C_sg: Array, noise: Array) -> Array:
    """Return what the noise of the gyro adds to the score of each effect on average, (..., n, 3).

    An effect that goes with the rate is scored along what the gyro read, of which the noise is
    in the innovation as well: with q the angular random walk, n the noise of the mean rate over an
    interval of the length T and theta the error of the turn, ``E[n theta'] = -q^2 C_gs``,
    whatever T is. Left in, the score of a coarse gyro grows without end (errors in the variables).

    Parameters
    ----------
    N : (..., 3, 3) array
        A' S^-1 A of `innovation_tests`, in s.
    C_sg : (..., 3, 3) array
        Mounting.
    noise : (..., 2) array
        q^2 times the part of the last reading that lies before the frame [rad^2/s], and q^2 T
        [rad^2].
    """
    b = np.zeros((*N.shape[:-2], len(HYPOTHESES), WIDTH))
    in_g = np.swapaxes(C_sg, -1, -2) @ N @ C_sg * (1e-6 * noise[..., 1, None, None])
    b[..., TIME, 0] = -1e-3 * noise[..., 0] * np.trace(N, axis1=-2, axis2=-1)
    b[..., SCALE_FACTORS, :] = np.diagonal(in_g, axis1=-2, axis2=-1)
    for column, (i, j) in enumerate(_PAIRS):
        b[..., MISALIGNMENTS, column] = 2.0 * in_g[..., i, j]
    return b
