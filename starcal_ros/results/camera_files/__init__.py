# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A calibrated camera in the files of other programs, one program a file.

::

    camera_info.yaml   camera_info_manager and the image pipelines of ROS       ros.py
    camchain.yaml      Kalibr                                                   kalibr.py
    opencv.yaml        OpenCV's FileStorage                                     opencv.py
    cameras.txt        COLMAP                                                   colmap.py

and for images with attitudes ``images.txt`` of COLMAP and a world coordinate system each (`wcs`).
Not every program has every lens model: what it has not is left out, and said.
"""

from __future__ import annotations

from typing import Any

import yaml

from starcal_ros.results.camera_files import colmap, kalibr, opencv, ros
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

NAMES = ('camera_info.yaml', 'camchain.yaml', 'opencv.yaml', 'cameras.txt')


def files(camera: ForeignCamera) -> tuple[dict[str, str], list[str]]:
    """Return files of a camera, by name, and which ones can not have it.

    Parameters
    ----------
    camera : ForeignCamera

    Returns
    -------
    texts : dict
    notices : list of str
    """
    chain = kalibr.camera(camera)
    texts = dict(zip(NAMES, (
        _dump(ros.camera_info(camera)), _dump(None if chain is None else {'cam0': chain}),
        opencv.text(camera), colmap.cameras(camera))))
    missing = [name for name, text in texts.items() if text is None]
    notices = [f'{", ".join(missing)} not written: no such lens as {camera.lens} there'
               ] if missing else []
    return {name: text for name, text in texts.items() if text is not None}, notices


def _dump(tree: dict[str, Any] | None) -> str | None:
    """Return YAML as it is read and written by hand; None of nothing."""
    return None if tree is None else str(
        yaml.safe_dump(tree, sort_keys=False, default_flow_style=None))
