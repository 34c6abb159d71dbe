# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Self-calibration of a camera that distorts: S24's experiment with a k1 that is not zero.

The pinhole model is wrong by k1, the model with k1 knows f less well; which of the two errors is
the larger one depends on k1 and on the noise. What counts for identification, the angle between
two stars, is measured by the cameras found on the stars of ten other frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC
from starcal_ros.evaluation.tasks import complete
from starcal_ros.reproduction.self2024 import (LARGEST, PINHOLE, PITCH_MM, START, STEPS, Point,
                                               scenes)

ESTIMATORS = ('SCWC pinhole', 'SCWC + k1', 'SCOC unbiased + k1')
LARGEST_K1 = np.append(LARGEST, 1e-3)
_ROUNDS = 10                # in a file
_FRAMES = 10                # on which the angles are compared


class Case(NamedTuple):
    """What is simulated: a point, and k1 [mm^-2]."""

    point: Point
    k1: float


class Errors(NamedTuple):
    """What the estimators made of some rounds.

    Attributes
    ----------
    f_um : (3, n) array
        Estimate minus truth.
    angle_arcsec : (3, n) array
        RMS error of the angles between stars.
    """

    f_um: Array
    angle_arcsec: Array

    @property
    def f_rms(self) -> Array:
        """RMS error of f, (3,) [um]."""
        return np.sqrt(np.mean(self.f_um**2, axis=1))

    @property
    def angle_rms(self) -> Array:
        """RMS error of an angle, (3,) [arcsec]."""
        return np.sqrt(np.mean(self.angle_arcsec**2, axis=1))


def evaluate(x: Array, uv: Array, sigma: float, constrained: bool) -> tuple[Array, Array]:
    """Return value and matrix of S for `solve`; without constraint less its expectation.

    Parameters
    ----------
    x : (rounds, K) array
        The first K intrinsics, the others being zero.
    uv : (rounds, NF, NS, 2) array
        Spots [px].
    sigma : float
        Scale of their noise [px].
    constrained : bool
        WC.
    """
    look = partial(interstar.lens, intrinsics=_whole(x), pitch_mm=PITCH_MM,
                   estimated=range(x.shape[1]), constrained=constrained,
                   seen=np.ones(uv.shape[:-1], np.bool_))
    sight = look(uv)
    value, by_direction = equations = interstar.equations(sight)
    if not constrained:
        bias = interstar.bias(look, uv, sigma)
        value = value - (bias.squares / bias.expected)[:, None] * bias.value
    return value, equations.product(sight.by_intrinsics)


def _whole(x: Array) -> Array:
    """Return the intrinsics (..., 7) of which the first are x."""
    return np.concatenate((x, np.zeros((*x.shape[:-1], 7 - x.shape[-1]))), axis=-1)


def calibrate(uv: Array, sigma: float) -> list[Array]:
    """Return the cameras (rounds, K) that ESTIMATORS find in rounds (rounds, NF, NS, 2) [px]."""
    problem = partial(evaluate, uv=uv, sigma=sigma)
    pinhole = interstar.solve(partial(problem, constrained=True),
                              np.broadcast_to(START, (len(uv), 3)), LARGEST, STEPS)
    start = np.concatenate((pinhole, np.zeros((len(uv), 1))), axis=-1)
    return [pinhole, *(interstar.solve(partial(problem, constrained=constrained), start,
                                       LARGEST_K1, STEPS) for constrained in (True, False))]


def run_file(case: Case, seed: int, number: int, rounds: int) -> dict[str, Array]:
    """Run the rounds of one file."""
    point, truth = case.point, PINHOLE + case.k1 * np.eye(7)[3]
    rng = np.random.default_rng(np.random.SeedSequence(
        seed, spawn_key=(point.frames, point.stars, number)))
    v, C_si = scenes(rng, rounds, point)
    sigma = point.sigma_px / np.sqrt(2.0)
    uv = camera.project(v[:, None] @ np.swapaxes(C_si, -1, -2), truth, PITCH_MM)
    _, C_other = scenes(rng, rounds, Point(frames=_FRAMES, stars=point.stars))
    r_s = v[:, None] @ np.swapaxes(C_other, -1, -2)
    seen = camera.project(r_s, truth, PITCH_MM).reshape(rounds, -1, 2)
    f_um, angle = [], []
    for x in calibrate(uv + sigma * rng.standard_normal(uv.shape), sigma):
        w_s = camera.unproject(seen, _whole(x), PITCH_MM).reshape(r_s.shape)
        f_um.append((x[:, 2] - truth[2]) * 1e3)
        angle.append(np.sqrt(np.mean((_angles(w_s) - _angles(r_s))**2, axis=(1, 2))) / ARCSEC)
    return Errors(np.stack(f_um), np.stack(angle))._asdict()


def _angles(w: Array) -> Array:
    """Return the angles, (..., pairs), between unit vectors (..., n, 3) [rad]."""
    i, j = np.triu_indices(w.shape[-2], 1)
    return 2.0 * np.arcsin(0.5 * np.linalg.norm(w[..., i, :] - w[..., j, :], axis=-1))


def run(cases: Sequence[Case], rounds: int, seed: int, work: Path,
        on_progress: Callable[[float], None]) -> list[Errors]:
    """Run the rounds of each case, or what is missing of them, as `self2024.run`."""
    work.mkdir(parents=True, exist_ok=True)
    cuts = range(0, rounds, _ROUNDS)
    tasks = [(case, seed, k, min(_ROUNDS, rounds - low))
             for case in cases for k, low in enumerate(cuts)]
    names = [work / f's24_lens_{k1:g}_{point.sigma_px:g}_{point.frames}_{point.stars}_{seed}_'
             f'{number}_{size}.npz' for (point, k1), _, number, size in tasks]
    complete(names, run_file, tasks, on_progress=on_progress)
    parts = [[np.load(name) for name in names[low:low + len(cuts)]]
             for low in range(0, len(names), len(cuts))]
    return [Errors(*(np.concatenate([file[key] for file in files], axis=1)
                     for key in Errors._fields)) for files in parts]
