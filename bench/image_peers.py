# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection and centroids beside those of other programs: `python bench/image_peers.py`.

The same frames of 1024 x 1024 pixels with 30 stars, magnitudes 2.5 to 6.4, at rest and with the
trail of 0.5 deg/s, given to `imaging.centroids.extract`, to sep (windowed centroids), to photutils
(DAOStarFinder) and to tetra3rs, each at five sigmas, with its own background and one thread.
Processor time of a frame; stars found within 2 px of 30, spots that are none, and the rms error in
u and v of the stars that all of them found. Needs ``pip install sep photutils tetra3rs``; what is
absent is said and left out.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from time import process_time
from typing import Any

from images import CONFIG, DETECTOR, EXPOSURE_S, NODES, place, PX_PER_DEG_S, STARS
import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.image import CentroidConfig
from starcal_ros.imaging.centroids import extract
from starcal_ros.simulation.render import Renderer

Array = NDArray[np.float64]
Finder = Callable[[NDArray[Any]], Array]

FRAMES, RATES = 20, (0.0, 0.5)
THRESHOLD, WITHIN_PX = 5.0, 2.0
FWHM_PX = 2.355


def ours(image: NDArray[Any]) -> Array:
    """Return raster positions (n, 2) of this package."""
    return extract(image, CentroidConfig(gain_electrons=CONFIG.gain_electrons)).uv_raster


def of_sep(image: NDArray[Any]) -> Array:
    """Return those of sep."""
    import sep
    light = image.astype(np.float32)
    background = sep.Background(light)
    light -= background.back()
    found = sep.extract(light, THRESHOLD, err=background.globalrms)
    radius, _ = sep.flux_radius(light, found['x'], found['y'], 6.0 * found['a'], 0.5)
    x, y, _ = sep.winpos(light, found['x'], found['y'], 2.0 / 2.35 * radius)
    return np.stack((x, y), axis=-1)


def of_photutils(image: NDArray[Any]) -> Array:
    """Return those of photutils."""
    from astropy.stats import sigma_clipped_stats
    from photutils.detection import DAOStarFinder
    _, median, deviation = sigma_clipped_stats(image, sigma=3.0)
    found = DAOStarFinder(fwhm=FWHM_PX, threshold=THRESHOLD * deviation)(image - median)
    return (np.empty((0, 2)) if found is None else
            np.stack((found['x_centroid'], found['y_centroid']), axis=-1))


def of_tetra3rs(image: NDArray[Any]) -> Array:
    """Return those of tetra3rs, whose origin is the middle of the image."""
    from tetra3rs import extract_centroids
    found = extract_centroids(image.astype(np.float32), sigma_threshold=THRESHOLD, threads=1)
    return np.array([(each.x, each.y) for each in found.centroids]) + DETECTOR.centre_raster


FINDERS: dict[str, Finder] = {'starcal_ros': ours, 'sep': of_sep, 'photutils': of_photutils,
                              'tetra3rs': of_tetra3rs}


def frames(rate_deg_s: float) -> list[tuple[NDArray[Any], Array]]:
    """Return images, and the raster positions (30, 2) of their stars."""
    rng = np.random.default_rng(1)
    camera = Renderer(CONFIG, DETECTOR, EXPOSURE_S, rng)
    trail = rate_deg_s * PX_PER_DEG_S * np.array([np.cos(0.4), np.sin(0.4)])
    made = []
    for _ in range(FRAMES):
        uv = place(rng)
        light = camera.light(uv + NODES[:, None, None] * trail, rng.uniform(2.5, 6.4, STARS))
        made.append((camera.counts(light), uv + DETECTOR.centre_raster))
    return made


def study(rate_deg_s: float, finders: dict[str, Finder]) -> None:
    """Print a line for each program."""
    made = frames(rate_deg_s)
    miss = {name: np.full((FRAMES, STARS, 2), np.nan) for name in finders}
    false, took = dict.fromkeys(finders, 0), dict.fromkeys(finders, np.inf)
    for k, (image, truth) in enumerate(made):
        for name, finder in finders.items():
            begin = process_time()
            found = finder(image)
            took[name] = min(took[name], process_time() - begin)
            if len(found):
                off = found[:, None] - truth
                near = np.linalg.norm(off, axis=-1) < WITHIN_PX
                nearest = np.linalg.norm(off, axis=-1).argmin(axis=0)
                seen = near.any(axis=0)
                miss[name][k, seen] = off[nearest, np.arange(STARS)][seen]
                false[name] += int((~near.any(axis=1)).sum())
    everywhere = np.all([np.isfinite(each[..., 0]) for each in miss.values()], axis=0)
    for name, each in miss.items():
        rms = np.sqrt(np.mean(each[everywhere]**2, axis=0))
        print(f'| {rate_deg_s:.1f} | {name} | {1e3 * took[name]:.1f} | '
              f'{np.isfinite(each[..., 0]).mean() * STARS:.1f} | {false[name] / FRAMES:.1f} | '
              f'{rms[0]:.4f} | {rms[1]:.4f} |')


def main() -> None:
    """Print the table."""
    finders = {name: finder for name, finder in FINDERS.items() if find_spec(name)}
    for name in FINDERS.keys() - finders.keys():
        print(f'{name} is not installed and left out')
    print('| deg/s | program | ms a frame | stars of 30 | no stars | rms u [px] | rms v [px] |')
    print('|---|---|---|---|---|---|---|')
    for rate_deg_s in RATES:
        study(rate_deg_s, finders)


if __name__ == '__main__':
    main()
