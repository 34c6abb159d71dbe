# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time of a frame by W19's methods: `OPENBLAS_NUM_THREADS=1 python bench/intrinsics_methods.py`.

Angular distances (AD) and singular values (SVD, Model 4, {sigma2, sigma3}) of a calibration that
has converged, over the number of stars, on one core: ours, wrong stars screened out, with the
full and with the published weighting; and as W19 does it, derivatives by differences and the gain
of its Eq. 25, which inverts a matrix of the size of the residuals. The last columns say which part
of that the derivatives are: the same, but the gain by a matrix of the size of the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter

from bars import told
import numpy as np
from numpy.typing import NDArray

from starcal_ros.calibration import attitude_free
from starcal_ros.calibration.attitude_free import CameraBelief, Measurement
from starcal_ros.core import rotation
from starcal_ros.measurements.samples import Stars
from starcal_ros.reproduction.published_cameras import unproject_w19
from starcal_ros.reproduction.wu2019 import (DETECTOR, LENS, METHODS, PRECISION, SIGMA_PX,
                                             START_SIGMA, TRUTH)

Array = NDArray[np.float64]

STARS = (8, 12, 16, 20, 25, 31, 40, 50, 60)
LIMITS_MS = {'AD': 0.1, 'SVD': 0.15}
LIMIT_STARS = 31
FRAMES, REPEATS = 20, 9
GATE = 18.4


def frame_of(stars: int, rng: np.random.Generator) -> Stars:
    """Return a frame of stars anywhere on the detector, at some attitude."""
    uv = rng.uniform(0.0, [DETECTOR.width, DETECTOR.height], (stars, 2))
    u_i = unproject_w19(uv, TRUTH, DETECTOR.pitch_mm) @ rotation.exp(rng.normal(size=3))
    return Stars(u_i, uv + SIGMA_PX * rng.standard_normal((stars, 2)), np.full(stars, SIGMA_PX))


def angles(w: Array) -> Array:
    """Return the angles of all pairs."""
    one, other = np.triu_indices(len(w), 1)
    return np.arccos(np.sum(w[one] * w[other], axis=-1))


def singular_values(w: Array) -> Array:
    """Return sigma2 and sigma3 of the first three, four, ... stars."""
    return np.concatenate([np.linalg.svd(w[:count], compute_uv=False)[1:]
                           for count in range(3, len(w) + 1)])


def as_published(values: Callable[[Array], Array], as_printed: bool, x: Array, P: Array,
                 stars: Stars) -> tuple[Array, Array]:
    """Return state and covariance after a frame, W19 Eq. 25 to 28, derivatives by differences."""
    def h(state: Array) -> Array:
        return values(unproject_w19(stars.uv, state, DETECTOR.pitch_mm))

    H = np.stack([(h(x + step) - h(x - step)) / (2.0 * step.sum())
                  for step in np.diag(PRECISION)], axis=-1)
    z = values(stars.u_i) - h(x)
    variance = 2.0 * (SIGMA_PX * DETECTOR.pitch_mm / x[1])**2
    if as_printed:
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + variance * np.eye(len(z)))
        return x + K @ z, (np.eye(len(x)) - K @ H) @ P
    P = np.linalg.inv(np.linalg.inv(P) + H.T @ H / variance)
    return x + P @ H.T @ z / variance, P


def best_ms(step: Callable[[Stars], object], frames: list[Stars]) -> float:
    """Return the time of a frame, the best of some tries of each."""
    total = 0.0
    for stars in frames:
        tries = []
        for _ in range(REPEATS):
            begin = perf_counter()
            step(stars)
            tries.append(perf_counter() - begin)
        total += min(tries)
    return 1e3 * total / len(frames)


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(1)
    ours = {f'{name} {weighting}': partial(_ours, converged(measure, rng), measure)
            for name, weightings in METHODS.items() for weighting, measure in weightings.items()}
    belief = converged(METHODS['AD']['full'], rng)
    P = belief.root @ belief.root.T
    theirs = {f'{name} {how}': partial(as_published, values, how == 'W19', TRUTH, P)
              for how in ('W19', 'differences')
              for name, values in (('AD', angles), ('SVD', singular_values))}
    columns = {**ours, **theirs}
    print('ms a frame'.ljust(12) + ''.join(f'{name:>17}' for name in columns))
    for count in STARS:
        frames = [frame_of(count, rng) for _ in range(FRAMES)]
        times = {name: best_ms(step, frames) for name, step in columns.items()}
        print(f'{count:>3} stars'.ljust(12) + ''.join(f'{ms:17.3f}' for ms in times.values()))
        print(''.ljust(12) + ' '.join((
            f'AD / SVD: full {times["AD full"] / times["SVD full"]:.2f},',
            f'published weighting {times["AD diagonal"] / times["SVD diagonal"]:.2f},',
            f'W19 {times["AD W19"] / times["SVD W19"]:.1f}; W19 / ours:',
            f'AD {times["AD W19"] / times["AD full"]:.0f},',
            f'SVD {times["SVD W19"] / times["SVD full"]:.0f}')))
        if count == LIMIT_STARS:
            for name, limit in LIMITS_MS.items():
                alone = best_ms(lambda stars: attitude_free.update(
                    belief, stars, LENS, METHODS[name]['full']), frames)
                print(f'{"":12}{name} {times[f"{name} full"]:.2f} ms, {alone:.2f} without the '
                      'screening of stars')
                told(f'{name} of W19 at {count} stars, with screening', times[f'{name} full'],
                     limit, 'ms a frame')


def converged(measure: Measurement, rng: np.random.Generator) -> CameraBelief:
    """Return what is known after 2500 frames of 20 stars: the fifth part of after 100."""
    belief = CameraBelief(TRUTH, np.diag(START_SIGMA))
    for _ in range(100):
        belief = attitude_free.update(belief, frame_of(20, rng), LENS, measure)
    return CameraBelief(TRUTH, 0.2 * belief.root)


def _ours(belief: CameraBelief, measure: Measurement, stars: Stars) -> object:
    return attitude_free.screen(belief, stars, LENS, measure, GATE)


if __name__ == '__main__':
    main()
