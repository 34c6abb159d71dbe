# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star identification with false and missing stars: `python bench/identify.py [FRAMES]`.

T18's true camera (3 px of distortion at the corner), which the identifier does not know; 5 false
spots in each frame, 20 % of the stars missing. Prints, a line a case: frames identified, true
stars named, wrong names among all names, processor time a frame.
"""

from __future__ import annotations

from itertools import product
import sys
from time import perf_counter

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.camera import Detector
from starcal_ros.evaluation.identification import Score, Viewer, score
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.identifier import Identifier

DETECTOR = Detector(1024, 1024, 0.00645)
TRUE = np.array([5.0, 10.0, 25.6, 2e-4, -1e-6, 2e-5, 2e-5])
START_NS, PERIOD_NS = 1_782_993_600_000_000_000, 500_000_000
TURN_ERROR = 1e-5       # rad, of the gyros over one period


def line(case: str, result: Score) -> None:
    """Print one case."""
    milliseconds = 1e3 * result.seconds
    print(f'{case:<44} {result.found:4d}/{result.frames}  '
          f'named {result.named / result.stars:7.2%}  '
          f'wrong {result.wrong:3d} of {result.named} ({result.wrong / result.named:.3%})  '
          f'ms {np.median(milliseconds):5.1f}, at most {milliseconds.max():5.1f}')


def lost_in_space(frames: int) -> None:
    """Search each frame anew."""
    for error in (0.001, 0.01, -0.01, 0.1, -0.1):
        identifier = Identifier(CameraGuess.of_focal_length(
            DETECTOR, TRUE[2] * (1.0 + error), 1.2 * abs(error)))
        viewer = Viewer(DETECTOR, TRUE, np.random.default_rng(1))
        begin = perf_counter()
        identifier.lost_in_space(*viewer.anywhere(START_NS)[1:3])
        if (building := perf_counter() - begin) > 0.5:
            print(f'database built in {building:.1f} s')
        line(f'lost in space, focal length {error:+.1%}',
             score((viewer.anywhere(START_NS) for _ in range(frames)),
                   lambda s: identifier.lost_in_space(s.uv_raster, s.flux, s.stamp_ns)))


def track(frames: int, limiting_magnitude: float, rate_deg_s: float, gyro: bool) -> None:
    """Follow a camera that turns about another axis every 20 s."""
    rng = np.random.default_rng(2)
    axes = np.vstack((np.eye(3), -np.eye(3)))[rng.integers(0, 6, frames // 40 + 1)]
    turns = rotation.exp(np.radians(rate_deg_s) * PERIOD_NS * 1e-9
                         * np.repeat(axes, 40, axis=0)[:frames])
    viewer = Viewer(DETECTOR, TRUE, rng, limiting_magnitude=limiting_magnitude)
    C_si, sights, measured = np.eye(3), [], {}
    for k, turn in enumerate(turns):
        C_si = turn @ C_si
        sights.append(viewer.at(C_si, START_NS + k * PERIOD_NS))
        error = rotation.exp(TURN_ERROR * rng.standard_normal(3))
        measured[sights[-1].stamp_ns] = error @ turn if gyro else None
    identifier = Identifier(CameraGuess.of_focal_length(DETECTOR, TRUE[2] * 1.01, 0.02))
    result = score(sights, lambda s: identifier.identify(
        s.uv_raster, s.flux, s.stamp_ns, measured[s.stamp_ns]))
    line(f'{rate_deg_s} deg/s, {result.stars / frames:4.1f} stars, '
         f'gyro {"yes" if gyro else "no"}', result)


def main() -> None:
    """Run both studies."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    lost_in_space(frames)
    for limit, rate_deg_s, gyro in product((6.4, 5.2), (0.5, 2.0), (True, False)):
        track(frames, limit, rate_deg_s, gyro)


if __name__ == '__main__':
    main()
