# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera as OpenCV's FileStorage, with the names of its sample camera_calibration."""

from __future__ import annotations

from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

_LENSES = ('plumb_bob', 'rational', 'thin_prism')
_FISHEYES = ('equidistant', 'kannala_brandt')
_COUNT = 4              # coefficients of cv::fisheye


def text(camera: ForeignCamera) -> str | None:
    """Return the file; None of a lens that OpenCV has not.

    ``fisheye_model`` 1 is for ``cv::fisheye``, 0 for ``cv::projectPoints``.
    """
    if camera.lens not in (*_LENSES, *_FISHEYES):
        return None
    f, (cu, cv) = camera.f_px, camera.centre_px
    fisheye = camera.lens in _FISHEYES
    coefficients = [*camera.coefficients]
    if fisheye:
        coefficients += [0.0] * (_COUNT - len(coefficients))
    return '\n'.join((
        '%YAML:1.0', '---', f'image_width: {camera.width}', f'image_height: {camera.height}',
        f'fisheye_model: {int(fisheye)}',
        *_matrix('camera_matrix', 3, [f, 0.0, cu, 0.0, f, cv, 0.0, 0.0, 1.0]),
        *_matrix('distortion_coefficients', len(coefficients), coefficients), ''))


def _matrix(name: str, rows: int, data: list[float]) -> tuple[str, ...]:
    return (f'{name}: !!opencv-matrix', f'   rows: {rows}', f'   cols: {len(data) // rows}',
            '   dt: d', f'   data: [ {", ".join(map(_number, data))} ]')


def _number(value: float) -> str:
    """Return a number that FileStorage takes for a double."""
    shown = repr(float(value))
    return shown if any(mark in shown for mark in '.en') else f'{shown}.'
