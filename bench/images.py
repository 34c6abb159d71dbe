# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rendering and centroids: time, errors and bound: `python bench/images.py`.

Frames of 1024 x 1024 pixels with 30 stars, at rest and with the smear of 0.5 and 1 deg/s (180 ms,
T18's camera). Times are of the processor, the best of twenty, beside their limits. With
`--figure FILE.png` it draws one star at each rate instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import process_time

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.image import CentroidConfig, ImageConfig
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.centroids import extract
from starcal_ros.simulation.render import Renderer
from starcal_ros.simulation.star_images import instants_ns

Array = NDArray[np.float64]

DETECTOR = Detector(1024, 1024, 0.00645)
CONFIG = ImageConfig(zero_point_electrons_s=5e6)
EXPOSURE_S, STARS, FRAMES = 0.18, 30, 60
RATES = (0.0, 0.5, 1.0)         # deg/s
RENDER_LIMIT_MS, EXTRACT_LIMIT_MS = 50.0, 40.0
NODES = np.array(instants_ns(1.0)) * 1e-9
PX_PER_DEG_S = np.radians(1.0) * EXPOSURE_S * 25.6 / DETECTOR.pitch_mm


def best_ms(work: Callable[[], object]) -> float:
    """Return the shortest of twenty runs."""
    times = []
    for _ in range(20):
        begin = process_time()
        work()
        times.append(process_time() - begin)
    return 1e3 * min(times)


def place(rng: np.random.Generator) -> Array:
    """Return stars (n, 2) at least 70 px from each other, at any phase of a pixel."""
    at = np.arange(-450.0, 451.0, 100.0)
    cells = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    return (cells[rng.choice(len(cells), STARS, replace=False)]
            + rng.uniform(-15.0, 15.0, (STARS, 2)))


def study(rate_deg_s: float, gain: float | None) -> None:
    """Print times and errors at one rate."""
    rng = np.random.default_rng(1)
    camera = Renderer(CONFIG, DETECTOR, EXPOSURE_S, rng)
    trail = rate_deg_s * PX_PER_DEG_S * np.array([np.cos(0.4), np.sin(0.4)])
    config = CentroidConfig(gain_electrons=gain)
    errors, scores = [], []
    for _ in range(FRAMES):
        uv, magnitude = place(rng), rng.uniform(2.5, 6.4, STARS)
        image = camera.counts(camera.light(uv + NODES[:, None, None] * trail, magnitude))
        found = extract(image, config)
        miss = found.uv_raster[:, None] - uv - DETECTOR.centre_raster
        of = np.linalg.norm(miss, axis=-1).argmin(axis=0)
        of_star = miss[of, np.arange(STARS)]
        clean = (found.flags[of] == 0) & (np.linalg.norm(of_star, axis=1) < 2.0)
        root = np.linalg.cholesky(found.covariance[of][clean])
        errors.append(of_star[clean])
        scores.append(np.linalg.solve(root, of_star[clean][..., None])[..., 0])
    error, score = np.concatenate(errors), np.concatenate(scores)
    rendering = best_ms(lambda: camera.counts(
        camera.light(uv + NODES[:, None, None] * trail, magnitude)))
    extracting = best_ms(lambda: extract(image, config))
    print(f'{rate_deg_s:3.1f} deg/s, gain {"known" if gain else "found"}: '
          f'render {rendering:4.1f} ms of {RENDER_LIMIT_MS:.0f}, '
          f'centroids {extracting:4.1f} ms of {EXTRACT_LIMIT_MS:.0f}; '
          f'{len(error)} of {FRAMES * STARS} stars clean, rms u, v '
          f'{error[:, 0].std():.4f}, {error[:, 1].std():.4f} px, '
          f'variance over sigma {score.var():.3f}')


def figure(path: str) -> None:
    """Draw the same star, Hp 4 through the default camera, at rest and with its trails."""
    from matplotlib import pyplot as plt

    rng = np.random.default_rng(4)
    camera = Renderer(ImageConfig(), DETECTOR, EXPOSURE_S, rng)
    uv = place(rng)
    drawing, axes = plt.subplots(1, len(RATES), figsize=(10.0, 3.6), layout='constrained')
    for rate_deg_s, ax in zip(RATES, axes):
        trail = rate_deg_s * PX_PER_DEG_S * np.array([np.cos(0.4), np.sin(0.4)])
        image = camera.counts(camera.light(uv + NODES[:, None, None] * trail,
                                           np.full(STARS, 4.0)))
        found = extract(image, CentroidConfig(gain_electrons=1.0))
        truth = uv[0] + DETECTOR.centre_raster
        star = np.linalg.norm(found.uv_raster - truth, axis=1).argmin()
        ax.imshow(image, cmap='gray_r', vmin=190, vmax=600)
        ax.plot(*truth, '+', color='tab:blue', markersize=18, label='truth')
        ax.plot(*found.uv_raster[star], 'x', color='tab:orange', markersize=9, label='centroid')
        ax.set_xlim(truth[0] - 11, truth[0] + 11)
        ax.set_ylim(truth[1] + 9, truth[1] - 9)
        sigma = np.sqrt(np.linalg.eigvalsh(found.covariance[star]))
        miss = np.linalg.norm(found.uv_raster[star] - truth)
        ax.set_title(f'{rate_deg_s} deg/s: {miss:.3f} px off\n'
                     f'sigma {sigma[1]:.3f} px along, {sigma[0]:.3f} across', fontsize=9)
        ax.set_xlabel('u [px]')
    axes[0].set_ylabel('v [px]')
    axes[0].legend(fontsize=8)
    drawing.savefig(path, dpi=130)


def main() -> None:
    """Measure at three rates, with and without the gain, or draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--figure', metavar='FILE.png')
    options = parser.parse_args()
    if options.figure:
        figure(options.figure)
        return
    for gain in (CONFIG.gain_electrons, None):
        for rate_deg_s in RATES:
            study(rate_deg_s, gain)


if __name__ == '__main__':
    main()
