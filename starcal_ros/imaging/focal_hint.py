# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the file of an image tells of the focal length: EXIF of pictures, header of FITS.

Good to a tenth or so, where the image is as the camera gave it; what was cropped or scaled
afterwards may tell anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any
import warnings

from PIL import Image
import numpy as np

_EXIF = 0x8769
_FOCAL_MM, _FOCAL_35MM = 37386, 41989
_PIXELS_PER, _UNIT, _WIDTH = 41486, 41488, 40962
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))
_ARCSEC = 206264.806
_SCALES = ('SCALE', 'PIXSCALE', 'SECPIX', 'SECPIX1', 'PIXSCAL1')
_PLAUSIBLE = 0.2, 200.0         # focal lengths in widths of the image: a whole sky to 0.3 deg


def of_exif(exif: Image.Exif, width: int, height: int) -> float | None:
    """Return the focal length of a picture [px]; None where it is not told."""
    tags = exif.get_ifd(_EXIF)
    focal_mm, film_mm = _number(tags, _FOCAL_MM), _number(tags, _FOCAL_35MM)
    per_unit, unit_mm = _number(tags, _PIXELS_PER), _UNIT_MM.get(tags.get(_UNIT, 2))
    long_side = max(width, height)
    found = None
    if focal_mm and per_unit and unit_mm:
        taken = _number(tags, _WIDTH)
        found = focal_mm * per_unit / unit_mm * (long_side / taken if taken else 1.0)
    if film_mm and (found is None or not 0.5 < found * _FILM_DIAGONAL_MM / (
            film_mm * np.hypot(width, height)) < 2.0):
        found = film_mm / _FILM_DIAGONAL_MM * float(np.hypot(width, height))
    return _plausible(found, width)


def of_fits(header: Mapping[str, Any], width: int) -> float | None:
    """Return the focal length of a FITS image [px]; None where it is not told."""
    scale = _wcs_scale(header)
    focal_mm, pixel_um = _number(header, 'FOCALLEN'), (
        _number(header, 'XPIXSZ') or _number(header, 'PIXSIZE1'))
    if scale is None and focal_mm and pixel_um:
        return _plausible(1000.0 * focal_mm / pixel_um, width)
    for key in _SCALES:
        scale = scale or _number(header, key)
    return _plausible(_ARCSEC / scale if scale else None, width)


def _wcs_scale(header: Mapping[str, Any]) -> float | None:
    """Return arcsec a pixel of the world coordinates of a header."""
    if 'CTYPE1' not in header or not ('CD1_1' in header or 'CDELT1' in header):
        return None
    from astropy.wcs import WCS
    from astropy.wcs.utils import proj_plane_pixel_scales
    with suppress(Exception), warnings.catch_warnings():    # a header may be wrong in any way
        warnings.simplefilter('ignore')
        world = WCS(header, naxis=2).celestial
        if world.has_celestial:
            return float(np.mean(proj_plane_pixel_scales(world))) * 3600.0
    return None


def _number(tags: Mapping[Any, Any], key: object) -> float | None:
    try:
        value = float(tags[key])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return value if np.isfinite(value) and value > 0.0 else None


def _plausible(focal_px: float | None, width: int) -> float | None:
    if focal_px is None or not _PLAUSIBLE[0] < focal_px / width < _PLAUSIBLE[1]:
        return None
    return focal_px
