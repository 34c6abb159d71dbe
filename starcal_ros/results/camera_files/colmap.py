# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera and its images as COLMAP's text model.

Its pixels begin at the corner of the image: the centre of the top-left one is (0.5, 0.5). The
world is i, in which nothing has a place but directions: all images stand in its origin.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.messages import conventions
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

_MODELS = {'plumb_bob': ('OPENCV', 4), 'rational': ('FULL_OPENCV', 8),
           'equidistant': ('OPENCV_FISHEYE', 4), 'kannala_brandt': ('OPENCV_FISHEYE', 4)}
_CORNER = 0.5
_CAMERA_ID = 1


class AimedImage(NamedTuple):
    """An image of known attitude.

    Attributes
    ----------
    name : str
    C_si : (3, 3) array
        Attitude.
    values : (p,) array
        Of the lens model, with the focal length that the image has for itself.
    uv_raster : (n, 2) array
        Its stars [px].
    """

    name: str
    C_si: Array
    values: Array
    uv_raster: Array


def cameras(camera: ForeignCamera) -> str | None:
    """Return cameras.txt; None of a lens that COLMAP has not."""
    if camera.lens not in _MODELS:
        return None
    model, count = _MODELS[camera.lens]
    coefficients = (*camera.coefficients, *(0.0,) * (count - len(camera.coefficients)))
    values = (camera.f_px, camera.f_px, *(part + _CORNER for part in camera.centre_px),
              *coefficients)
    return ('# Camera list with one line of data per camera:\n'
            '#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n'
            f'{_CAMERA_ID} {model} {camera.width} {camera.height} {_listed(values)}\n')


def images(aimed: Iterable[AimedImage]) -> str:
    """Return images.txt: attitudes, and stars that are no points in space."""
    lines = ['# Image list with two lines of data per image:',
             '#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME',
             '#   POINTS2D[] as (X, Y, POINT3D_ID)']
    for number, image in enumerate(aimed, 1):
        x, y, z, w = rotation.to_quaternion(conventions.C_os @ image.C_si).tolist()
        lines += [f'{number} {_listed((w, x, y, z))} 0 0 0 {_CAMERA_ID} {image.name}',
                  ' '.join(f'{_listed(place)} -1' for place in
                           (image.uv_raster + _CORNER).tolist())]
    return '\n'.join(lines) + '\n'


def _listed(values: Iterable[float]) -> str:
    return ' '.join(repr(value) for value in values)
