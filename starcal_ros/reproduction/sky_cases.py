# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sky that others brought and that were hard: each beside what is right.

They are in the folder ``sky_cases``, in the one of ``STARCAL_REAL_SKY`` or beside it. Each of its
sub-folders has images, or a table of stars, and ``truth.json``: ``f_px`` with ``tolerance_px`` or
``sigma``, or ``joint`` with ``honest_sigma_of_joint`` for a camera that moves, and the words of
the command, ``args``, or the ``size`` of the images.
"""

from __future__ import annotations

from datetime import timedelta, timezone
import json
from pathlib import Path
import re
from typing import Any, NamedTuple

from starcal_ros.reproduction import real_images
from starcal_ros.sky.refraction import Site
from starcal_ros.workflows.still_images import pipeline
from starcal_ros.workflows.still_images.calibration import StillImageCamera
from starcal_ros.workflows.still_images.pipeline import Conditions

FOLDER = 'sky_cases'


class SkyCase(NamedTuple):
    """A case and its camera.

    Attributes
    ----------
    name : str
        Sub-folder.
    found : StillImageCamera
    f_px, tolerance_px : float
        What is right, and within what [px].
    """

    name: str
    found: StillImageCamera
    f_px: float
    tolerance_px: float


def folders() -> list[Path]:
    """Return the sub-folders of the cases; none where the folder is not there.

    Raises
    ------
    ConfigError
        Where nothing says where it would be.
    """
    top = real_images.folder()
    home = next((path for path in (top / FOLDER, top.parent / FOLDER) if path.is_dir()), None)
    return [] if home is None else sorted(
        path for path in home.iterdir() if (path / 'truth.json').is_file())


def calibrate(folder: Path) -> SkyCase:
    """Calibrate the camera of a case.

    Raises
    ------
    ValueError
        Where no image can be used.
    """
    truth = json.loads((folder / 'truth.json').read_text())
    conditions, stars = _conditions(truth.get('args', '')), folder / 'stars.csv'
    width, height = truth.get('size', (0, 0))
    source = (pipeline.of_table(stars, width, height, conditions) if stars.is_file()
              else pipeline.of_folder(folder, conditions))
    return SkyCase(folder.name, pipeline.calibrate(source).camera, *_right(truth))


def _right(truth: dict[str, Any]) -> tuple[float, float]:
    if 'joint' in truth:
        return truth['joint'][0], truth['honest_sigma_of_joint']
    return truth['f_px'], truth.get('tolerance_px', 3.0 * truth.get('sigma', 0.0))


def _conditions(words: str) -> Conditions:
    """Return what the words of a command say: field, site, zone of the clock."""
    fov = re.search(r'--fov ([\d.]+)', words)
    site = re.search(r'--site ([-\d.]+),([-\d.]+),([-\d.]+)', words)
    zone = re.search(r'UTC([-+]\d+)', words)
    return Conditions(
        float(fov[1]) if fov else None,
        site=Site(*(float(word) for word in site.groups())) if site else None,
        zone=timezone(timedelta(hours=float(zone[1]))) if zone else None)
