# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Cameras from folders of images of which nothing is known: `python bench/folder.py`.

Images of a rendered sky in FITS, 11 of half a megapixel (14 deg across) and 3 of 24 megapixels
(53 deg), go through `starcal intrinsics`, which finds field, stars and camera, in a process of its
own. Prints the seconds from its start until its file is there, the best of three, and how far the
focal length is off. The first run of all builds the database of stars, where there is none in the
cache yet. What is aimed at is meant for two cores.
"""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from astropy.io import fits
from bars import told
import numpy as np

from starcal_ros.config.image import ImageConfig
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.utc import unix_ns, utc_text
from starcal_ros.simulation.render import Renderer
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places
from starcal_ros.workflows.still_images.calibration import PITCH_MM

EPOCH = '2026-03-05T22:10:00'
EXPOSURE_S, APART_S = 0.3, 60
FOLDERS = (('11 images of 0.5 Mpx', 11, (816, 612), 3230.0, 6.0, 1),
           ('an image of 24 Mpx', 3, (6000, 4000), 6000.0, 3.0, 3))
"""Name, images, pixels, focal length [px], seconds aimed at, and for how many images these are."""
TURNS = 3


def write(folder: Path, images: int, pixels: tuple[int, int], f_px: float) -> None:
    """Write the images of a camera that looks anywhere."""
    rng, stars = np.random.default_rng(1), catalog.load(8.0)
    detector = Detector(*pixels, PITCH_MM)
    eye = Renderer(ImageConfig(full_well_electrons=5e4), detector, EXPOSURE_S, rng)
    intrinsics = np.array([7.0, -5.0, f_px * PITCH_MM, 2e-5, 0.0, 1e-6, -1e-6])
    least = np.cos(1.05 * np.arctan(0.5 * np.hypot(*pixels) / f_px))
    for k in range(images):
        stamp_ns = unix_ns(EPOCH) + k * APART_S * 10**9
        u_i = apparent_places(stars, np.arange(len(stars)), [stamp_ns], [len(stars)], Observer())
        r_s = u_i @ rotation.exp(3.0 * rng.standard_normal(3)).T
        ahead = r_s[:, 2] > least
        uv = camera.project(r_s[ahead], intrinsics, PITCH_MM)
        light = eye.light(np.repeat(uv[None], 5, axis=0), stars.magnitude[ahead])
        unit = fits.PrimaryHDU(eye.counts(light)[::-1])
        unit.header['DATE-OBS'] = utc_text(stamp_ns)
        unit.writeto(folder / f'{k:02}.fits')


def seconds(folder: Path, out: Path) -> float:
    """Return how long the camera of a folder takes."""
    begin = time.time()
    done = subprocess.run(
        [sys.executable, '-m', 'starcal_ros.cli', 'intrinsics', str(folder), '--aberration',
         '--out', str(out), '--overwrite'], capture_output=True, text=True)
    if not out.exists():
        raise SystemExit(done.stderr)
    return out.stat().st_mtime - begin


def main() -> int:
    """Measure all folders."""
    met = []
    for name, images, pixels, f_px, aim_s, of in FOLDERS:
        with tempfile.TemporaryDirectory() as place:
            folder, out = Path(place, 'images'), Path(place, 'camera.json')
            folder.mkdir()
            write(folder, images, pixels, f_px)
            best = min(seconds(folder, out) for _ in range(TURNS)) / of
            found = json.loads(out.read_text())
        sigma_px = found['sigma']['f_px']
        print(f'{name:<21} {best:5.2f} s; {found["verdict"]}, f '
              f'{(found["f_px"] - f_px) / sigma_px:+.1f} sigma off, +- {sigma_px:.2f} px')
        met.append(told(f'{name}, unknown camera', best, aim_s, 's'))
    return 0 if all(met) else 1


if __name__ == '__main__':
    sys.exit(main())
