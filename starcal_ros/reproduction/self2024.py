# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulated experiment of S24 (*Self-Calibration for Star Sensors*, 2024), Sec. 5.

Model
-----
A pinhole camera of 1536 x 1536 pixels of 5.5 um, f = 24.4455 mm, (x0, y0) = (768, 768) px. NS
stars lie evenly in a cone of 10 deg diameter; in NF frames all of them are seen, at random
attitudes. Each of the four methods starts at (1000, 1000) px and 20 mm.

Two things are ours to settle. S24 writes the centroid error as N(0, sigma^2 / 2) on each axis, so
its sigma is that of the length, and we take it so: with sigma on each axis, the Cramér-Rao bound
on f alone would exceed what it reports. And it does not state how the attitudes are drawn: here
the boresight is even over the cap in which the whole cone stays on the detector,
``atan(768 * 5.5 um / f) - 5 deg = 4.8 deg``, and the roll is any.

Rounds come in pairs, the same scene with the noise n and -n: what is odd in the noise cancels in
the mean of the two, which leaves the bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.calibration.interstar_arithmetic import pinhole_equations
from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation.tasks import complete

METHODS = ('TCOC', 'TCWC', 'SCOC', 'SCWC')
"""Traditional or self-calibration, without or with the constraint of the optical path."""
CONSTRAINED = (1, 3)            # of them
UNBIASED = 'SCOC unbiased'
"""Not of S24: SCOC less the expectation of its equations, see `interstar_equations.bias`."""
RESULTS = (*METHODS, UNBIASED)

PITCH_MM, HALF_PX = 5.5e-3, 768.0
TRUTH = np.array([HALF_PX, HALF_PX, 24.4455])                   # x0, y0 [px], f [mm]
PINHOLE = np.concatenate((TRUTH, np.zeros(4)))
"""The same as intrinsics of `starcal_ros.core.camera`, but counted from the corner."""
START = np.array([1000.0, 1000.0, 20.0])
LARGEST = np.array([HALF_PX, HALF_PX, 5.0])                     # step of an iteration
CONE = np.radians(5.0)                                          # half angle
CAP = np.arctan(HALF_PX * PITCH_MM / TRUTH[2]) - CONE
UNIT = np.array([1.0, 1.0, 1e3])
"""One px, px and um of the errors."""

STEPS = 20              # Newton's, at most: six do
UNBIASED_STEPS = 4      # from the result of SCWC; then rounding moves f by 1e-3 um
PAPER_STEPS, PAPER_LAMBDA = 10, 200.0
_PAIRS = 50             # pairs of rounds in a file
_SPOTS = 8000           # spots worked on at once: the arrays stay in the cache
_KEPT_BYTES = 31 << 20  # see `run_file`


@dataclass(frozen=True)
class Point:
    """One combination of what S24 varies.

    Attributes
    ----------
    sigma_px : float
        Centroid error, of the length: sigma_px / sqrt(2) on each axis.
    frames, stars : int
        NF and NS.
    """

    sigma_px: float = 0.1
    frames: int = 100
    stars: int = 20


class Rounds(NamedTuple):
    """What the methods of RESULTS made of some rounds, the two of a pair side by side.

    Attributes
    ----------
    error : (5, n, 3) array
        Estimate minus truth: x0, y0 [px], f [mm].
    paper_error : (2, n, 3) array
        The same of the constrained ones after the paper's ten iterations with lambda = 200.
    ms : (5, files) array
        CPU time that a round took each method, the last one from the result of SCWC [ms].
    """

    error: Array
    paper_error: Array
    ms: Array

    @property
    def bias(self) -> Array:
        """Mean error, (5, 3), in px, px, um."""
        return self.error.mean(axis=1) * UNIT

    @property
    def bias_sigma(self) -> Array:
        """Standard error of the bias, (5, 3); the pairs are independent."""
        pair = self.error.reshape(len(RESULTS), -1, 2, 3).mean(axis=2) * UNIT
        return pair.std(axis=1) / np.sqrt(pair.shape[1])

    @property
    def total(self) -> Array:
        """RMS error, (5, 3), S24 Eq. 15."""
        return rms(self.error)


def rms(error: Array) -> Array:
    """Return the RMS (..., 3), in px, px, um, of errors (..., n, 3)."""
    return np.sqrt(np.mean(error**2, axis=-2)) * UNIT


def scenes(rng: np.random.Generator, count: int, point: Point) -> tuple[Array, Array]:
    """Draw the scenes of rounds.

    Returns
    -------
    v : (count, NS, 3) array
        Directions of the stars, in i.
    C_si : (count, NF, 3, 3) array
        Attitudes of the camera.
    """
    v = _directions(*_cap(rng, (count, point.stars), CONE))
    angle, bearing = _cap(rng, (count, point.frames), CAP)
    zero = np.zeros_like(angle)
    roll = rng.uniform(-np.pi, np.pi, angle.shape)
    # The shortest way from the boresight's direction to z, then the roll about it.
    turn = angle[..., None] * np.stack((np.sin(bearing), -np.cos(bearing), zero), axis=-1)
    return v, rotation.exp(np.stack((zero, zero, roll), axis=-1)) @ rotation.exp(turn)


def spots(v: Array, C_si: Array) -> Array:
    """Return where the true camera sees the stars, (count, NF, NS, 2) [px]."""
    return camera.project(v[:, None] @ np.swapaxes(C_si, -1, -2), PINHOLE, PITCH_MM)


def _cap(rng: np.random.Generator, shape: tuple[int, int], half: float) -> tuple[Array, Array]:
    """Draw points evenly in a cap about z: angle from z, and bearing."""
    angle = np.arccos(1.0 - rng.random(shape) * (1.0 - np.cos(half)))
    return angle, rng.uniform(-np.pi, np.pi, shape)


def _directions(angle: Array, bearing: Array) -> Array:
    return np.stack((np.sin(angle) * np.cos(bearing), np.sin(angle) * np.sin(bearing),
                     np.cos(angle)), axis=-1)


def evaluate(x: Array, uv: Array, cosines: Array | None, constrained: bool,
             scale: float | None = None) -> tuple[Array, Array]:
    """Return the value (rounds, 3) and matrix (rounds, 3, 3) of `interstar_equations.solve`.

    Parameters
    ----------
    x : (rounds, 3) array
        Cameras.
    uv : (rounds, NF, NS, 2) array
        Spots.
    cosines : (rounds, NS, NS) array or None
        For T; None for S.
    constrained : bool
        WC.
    scale : float, optional
        lambda of S24 Eq. 10; Newton's method without.
    """
    value, matrix = pinhole_equations(uv, x, PITCH_MM, cosines, constrained, newton=scale is None)
    return value, matrix if scale is None else matrix / scale


def evaluate_unbiased(x: Array, uv: Array, sigma: float) -> tuple[Array, Array]:
    """Return value and matrix, as `evaluate`, of SCOC less its expectation.

    The noise is taken from the residuals; ``sigma`` [px] only gives its scale.
    """
    look = partial(interstar.pinhole, intrinsics=x, pitch_mm=PITCH_MM, constrained=False)
    bias = interstar.bias(look, uv, sigma)
    value, matrix = evaluate(x, uv, None, False)
    return value - (bias.squares / bias.expected)[:, None] * bias.value, matrix


def calibrate(uv: Array, v: Array, sigma: float) -> tuple[Array, Array, Array]:
    """Run all methods on rounds.

    Parameters
    ----------
    uv : (rounds, NF, NS, 2) array
        Spots [px].
    v : (rounds, NS, 3) array
        Directions of the stars.
    sigma : float
        Centroid noise, each axis [px].

    Returns
    -------
    x : (5, rounds, 3) array
        Cameras found by Newton's method.
    x_paper : (2, rounds, 3) array
        By ten of the paper's iterations, of the constrained methods.
    ms : (5,) array
        CPU time a round took with Newton's method [ms].
    """
    start = np.broadcast_to(START, (len(uv), 3))
    x, x_paper, ms = np.empty((len(RESULTS), *start.shape)), [], np.empty(len(RESULTS))
    for k, name in enumerate(METHODS):
        begin = process_time()
        cosines = v @ np.swapaxes(v, -1, -2) if name.startswith('T') else None
        problem = partial(evaluate, uv=uv, cosines=cosines, constrained=k in CONSTRAINED)
        x[k] = interstar.solve(problem, start, LARGEST, STEPS)
        ms[k] = (process_time() - begin) / len(uv) * 1e3
        if k in CONSTRAINED:
            x_paper.append(interstar.solve(
                partial(problem, scale=PAPER_LAMBDA), start, LARGEST, PAPER_STEPS))
    begin = process_time()
    x[-1] = interstar.solve(partial(evaluate_unbiased, uv=uv, sigma=sigma), x[3], LARGEST,
                            UNBIASED_STEPS)
    ms[-1] = (process_time() - begin) / len(uv) * 1e3
    return x, np.stack(x_paper), ms


def run_file(point: Point, seed: int, number: int, pairs: int) -> dict[str, Array]:
    """Run the pairs of one file; they depend on the seed and its number alone."""
    # glibc gives memory of this size back when it is freed, and page faults then cost more than
    # the arithmetic; having freed one such piece it keeps smaller ones.
    np.empty(_KEPT_BYTES, np.uint8)
    rng = np.random.default_rng(np.random.SeedSequence(
        seed, spawn_key=(point.frames, point.stars, number)))
    errors: list[tuple[Array, Array, Array]] = []
    at_once = max(1, _SPOTS // (2 * point.frames * point.stars))
    for low in range(0, pairs, at_once):
        v, C_si = scenes(rng, min(at_once, pairs - low), point)
        uv = spots(v, C_si)
        sigma = point.sigma_px / np.sqrt(2.0)
        noise = sigma * rng.standard_normal(uv.shape)
        paired = np.stack((uv + noise, uv - noise), axis=1).reshape(-1, *uv.shape[1:])
        x, x_paper, ms = calibrate(paired, np.repeat(v, 2, axis=0), sigma)
        errors.append((x - TRUTH, x_paper - TRUTH, ms))
    error, paper_error, times = zip(*errors)
    return {'error': np.concatenate(error, axis=1),
            'paper_error': np.concatenate(paper_error, axis=1),
            'ms': np.min(times, axis=0)[:, None]}


def run(points: Sequence[Point], rounds: int, seed: int, work: Path,
        on_progress: Callable[[float], None]) -> list[Rounds]:
    """Run many rounds of each point, or what is missing of them.

    Parameters
    ----------
    points : sequence of Point
        What to run.
    rounds : int
        Rounds of each; an odd number is made even.
    seed : int
        Of all randomness. Points of the same NF and NS have the same scenes and noise.
    work : Path
        Folder of the finished files.
    on_progress : callable
        Called with the part done, 0 to 1.
    """
    work.mkdir(parents=True, exist_ok=True)
    pairs = (rounds + 1) // 2
    cuts = list(range(0, pairs, _PAIRS))
    tasks = [(point, seed, k, min(_PAIRS, pairs - low))
             for point in points for k, low in enumerate(cuts)]
    names = [work / f's24_{point.sigma_px:g}_{point.frames}_{point.stars}_{seed}_{k}_{size}.npz'
             for point, _, k, size in tasks]
    complete(names, run_file, tasks, on_progress=on_progress)
    loaded = []
    for low in range(0, len(names), len(cuts)):
        parts = [np.load(name) for name in names[low:low + len(cuts)]]
        loaded.append(Rounds(*(np.concatenate([part[key] for part in parts], axis=1)
                               for key in Rounds._fields)))
    return loaded


def bound(point: Point, seed: int, unknown: int = 3, count: int = 10) -> Array:
    """Return the Cramér-Rao bound, RMS over some scenes, (2, unknown): T and S.

    Each frame has an attitude that nobody knows; in S the stars' places are unknown as well.

    Parameters
    ----------
    point : Point
        What is simulated.
    seed : int
        Of the scenes.
    unknown : int
        How many of the intrinsics are: x0, y0 [px], f [mm], k1, ….
    count : int
        Number of scenes.
    """
    v, C_si = scenes(np.random.default_rng(seed), count, point)
    variance = np.zeros((2, unknown))
    for v_i, C in zip(v, C_si):
        _, H_turn, H_lens = camera.linearize(v_i @ np.swapaxes(C, -1, -2), PINHOLE, PITCH_MM)
        H_star = np.zeros((*H_turn.shape[:-1], point.stars, 2))
        each = np.arange(point.stars)
        # A star that turns in i by theta moves in s by C_si theta; across it there are two ways.
        across = np.linalg.svd(v_i[:, None, :])[2][:, 1:]
        H_star[:, each, :, each] = np.swapaxes(
            H_turn @ C[:, None] @ np.swapaxes(across, -1, -2), 0, 1)
        attitude = np.linalg.qr(H_turn.reshape(point.frames, -1, 3))[0]
        H = np.concatenate((H_lens[..., :unknown], H_star.reshape(*H_turn.shape[:-1], -1)),
                           axis=-1).reshape(point.frames, 2 * point.stars, -1)
        H -= attitude @ (np.swapaxes(attitude, -1, -2) @ H)
        rows = H.reshape(-1, H.shape[-1])
        information = rows.T @ rows / (0.5 * point.sigma_px**2)
        for k, size in enumerate((unknown, len(information))):
            scale = 1.0 / np.sqrt(np.diag(information)[:size])
            scaled = information[:size, :size] * scale[:, None] * scale
            # Singular in S: turning all stars along with the attitudes moves no spot.
            inverse = np.linalg.pinv(scaled, rcond=1e-11, hermitian=True)
            variance[k] += np.diag(inverse)[:unknown] * scale[:unknown]**2 / count
    return np.sqrt(variance)


NOTES = (
    'sigma is that of the length, sigma / sqrt(2) on each axis, as S24 writes it: N(0, '
    'sigma^2 / 2). With sigma on each axis the bound on f would be 0.21 um at the point sigma = '
    '0.1 px, NF = 100, NS = 20, where the paper reports 0.15 um.',
    'S24 does not state how the attitudes are drawn. Here the boresight is even over the cap in '
    'which the whole cone of stars stays on the detector, and the roll is any.',
    'Rounds come in pairs with opposite noise: biases are known far better than errors / '
    'sqrt(rounds).')
"""What every study of S24 says."""
