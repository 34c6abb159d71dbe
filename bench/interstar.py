# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time of S24's equations: `OPENBLAS_NUM_THREADS=1 python bench/interstar.py`.

As written: all NF (NF - 1) NS (NS - 1) / 4 rows of A and e (S24 Eq. 11, 12), then A'A and A'e.
Reduced: the same two from sums over stars and frames (`calibration.interstar_complete`), rounds
batched. Both begin with the directions of the spots and their derivatives. Compiled: from the
spots, as written, but no row is kept (`calibration.interstar_kernel`). The best of several tries.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter

from bars import told
import numpy as np
from numpy.typing import NDArray

from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.calibration.interstar_arithmetic import pinhole_equations
from starcal_ros.calibration.interstar_complete import normal_equations
from starcal_ros.reproduction.self2024 import (METHODS, PITCH_MM, TRUTH, Point, run_file, scenes,
                                               spots)

Array = NDArray[np.float64]

POINTS = (Point(frames=100, stars=20), Point(frames=50, stars=20), Point(frames=50, stars=40))
AT_ONCE = 4
RATIO, MS_A_ROUND = 100.0, 2.0                  # at NF = 100, NS = 20


def best(task: Callable[[], object], tries: int) -> float:
    """Return the least time of some tries [ms]."""
    times = []
    for _ in range(tries):
        begin = perf_counter()
        task()
        times.append(perf_counter() - begin)
    return 1e3 * min(times)


def as_written(sight: interstar.SpotDirections) -> tuple[Array, Array]:
    """Return A'A and A'e of S, one round, from all pairs of frames and of stars."""
    w, b = np.moveaxis(sight.w, 0, -1), np.moveaxis(sight.instruments, (0, 1), (-1, -2))
    i, j = np.triu_indices(w.shape[1], 1)
    m, n = np.triu_indices(w.shape[0], 1)
    q = np.einsum('mpa,mpa->mp', w[:, i], w[:, j])
    slope = (np.einsum('mpa,mpak->mpk', w[:, i], b[:, j])
             + np.einsum('mpa,mpak->mpk', w[:, j], b[:, i]))
    A, e = (slope[m] - slope[n]).reshape(-1, 3), (q[m] - q[n]).ravel()
    return A.T @ A, A.T @ e


def main() -> None:
    """Print the times."""
    np.empty(31 << 20, np.uint8)                # as in self2024.run_file
    print("A'A and A'e of the self-calibration, r held")
    for point in POINTS:
        v, C_si = scenes(np.random.default_rng(1), AT_ONCE, point)
        uv = spots(v, C_si)
        uv = uv + 0.07 * np.random.default_rng(2).standard_normal(uv.shape)
        x = np.tile(TRUTH, (AT_ONCE, 1))
        sight = interstar.pinhole(uv, x, PITCH_MM, True)
        one = interstar.pinhole(uv[0], TRUTH, PITCH_MM, True)
        for ours, literal in zip(reversed(normal_equations(sight, sight.instruments)),
                                 as_written(one)):
            np.testing.assert_allclose(ours[0], literal, rtol=1e-5)
        written = best(partial(as_written, one), 5)
        ours_ms = best(partial(normal_equations, sight, sight.instruments), 40) / AT_ONCE
        compiled_ms = best(partial(pinhole_equations, uv, x, PITCH_MM, None, True, False),
                           40) / AT_ONCE
        print(f'NF {point.frames:3d}, NS {point.stars:2d}: as written {written:7.1f} ms, reduced '
              f'{ours_ms:6.3f} ms, {written / ours_ms:5.0f} times; compiled '
              f'{compiled_ms:6.3f} ms, {written / compiled_ms:5.0f} times')
        if point is POINTS[0]:
            told(f"A'A and A'e of S24 as written over ours, NF {point.frames}, NS {point.stars}",
                 written / compiled_ms, RATIO, 'times', least=True)
    ms = np.min([run_file(POINTS[0], 1, k, 8)['ms'][:len(METHODS), 0] for k in range(4)], axis=0)
    print('A round at NF 100, NS 20: '
          + ', '.join(f'{name} {value:.2f}' for name, value in zip(METHODS, ms))
          + f', together {ms.sum():.2f} ms')
    told('round of S24, four methods', ms.sum(), MS_A_ROUND, 'ms')


if __name__ == '__main__':
    main()
