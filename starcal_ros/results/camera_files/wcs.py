# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A world coordinate system of an image: a FITS header with SIP.

Model
-----
With (U, V) a pixel from CRPIX, the intermediate world coordinates are (Shupe et al., ADASS XIV,
2005; Calabretta and Greisen, A&A 395, 1077, 2002) ::

    (x, y) = CD (U + sum A_pq U^p V^q, V + sum B_pq U^p V^q),   2 <= p + q <= order       (W.1)

of the gnomonic projection (TAN), or, of a fisheye, of the equidistant one (ARC), about the
direction that CRPIX sees. CD, A and B are fitted by least squares to directions all over the
image, with the order that leaves `ENOUGH_PX` at most, if one of 9 does.

FITS counts pixels from (1, 1), the centre of the first one; the first row is the top one here.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel

ENOUGH_PX = 1e-3

_ORDERS = range(2, 10)
_GRID = 31              # directions along each side of the image
_ARC = ('equidistant', 'kannala_brandt')
_WIDEST = np.radians(100.0)     # off the axis, of a fisheye; there is no sky behind it
_DEG = np.degrees(1.0)


class Wcs(NamedTuple):
    """A world coordinate system.

    Attributes
    ----------
    content : bytes
        Of a FITS file without data.
    order : int
        Of its polynomials.
    worst_px : float
        By which it misses the camera, at most [px].
    """

    content: bytes
    order: int
    worst_px: float


def of_image(lens: LensModel, values: Array, C_si: Array, detector: Detector,
             seen: Callable[[Array], Array] = lambda u_i: u_i, flipped: bool = False,
             cards: tuple[tuple[str, str, str], ...] = ()) -> Wcs:
    """Return the world coordinate system of an image.

    Parameters
    ----------
    lens, values
        The camera.
    C_si : (3, 3) array
        Attitude.
    detector : Detector
        Pixels.
    seen : callable
        Where the observer sees ICRS directions (n, 3): aberration and refraction.
    flipped : bool
        Whether the camera is that of the flipped image, top to bottom.
    cards : tuple of (str, str, str)
        Further cards of the header: keyword, value, comment.
    """
    r_s = _directions(lens, values, detector)
    if lens.name in _ARC:
        r_s = r_s[r_s[:, 2] > np.cos(_WIDEST)]
    u_i = r_s @ C_si

    def raster(u: Array) -> Array:
        uv = lens.project(seen(u) @ C_si.T, values) + detector.centre_raster
        return uv * [1.0, -1.0] + [0.0, detector.height - 1.0] if flipped else uv

    crpix, pole = raster(u_i[:1])[0], u_i[0]
    world = _projected(u_i[1:], pole, lens.name in _ARC)
    pixel = raster(u_i[1:]) - crpix
    size = 0.5 * float(np.hypot(detector.width, detector.height))
    for order in _ORDERS:
        powers = _powers(1, order)
        terms = _terms(pixel / size, powers)
        slopes = np.linalg.lstsq(terms, world, rcond=None)[0]
        CD = np.asarray(slopes[:2].T / size, np.float64)
        miss = np.linalg.solve(CD, (terms @ slopes - world).T).T
        worst = float(np.linalg.norm(miss, axis=1).max())
        if worst <= ENOUGH_PX:
            break
    to_pixels = (slopes[2:] / size ** np.sum(powers[2:], axis=1)[:, None]) @ np.linalg.inv(CD).T
    ideal: Array = np.asarray(np.linalg.solve(CD, world.T).T, np.float64)
    back = _powers(0, order)
    inverse = np.linalg.lstsq(_terms(ideal / size, back), pixel - ideal, rcond=None)[0] / (
        size ** np.sum(back, axis=1)[:, None])
    return Wcs(_fits(detector, 'ARC' if lens.name in _ARC else 'TAN', crpix + 1.0, pole, CD,
                     [('A', 'B', powers[2:], to_pixels), ('AP', 'BP', back, inverse)], order,
                     cards), order, worst)


def _directions(lens: LensModel, values: Array, detector: Detector) -> Array:
    """Return the directions of the middle of the image, and of places all over it."""
    half = 0.5 * np.array([detector.width, detector.height])
    side = np.linspace(-1.0, 1.0, _GRID)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * half
    return lens.unproject(np.concatenate((np.zeros((1, 2)), places)), values)


def _projected(u_i: Array, pole: Array, arc: bool) -> Array:
    """Return intermediate world coordinates, (n, 2) [deg]: east and north about a direction."""
    east = np.array([-pole[1], pole[0], 0.0])
    east /= np.linalg.norm(east)
    along = u_i @ pole
    across = np.stack((u_i @ east, u_i @ np.cross(pole, east)), axis=-1)
    if not arc:
        return np.asarray(_DEG * across / along[:, None])
    sine = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(sine, along)
    return np.asarray(_DEG * across * np.where(sine > 0.0, angle / np.maximum(sine, 1e-30), 1.0)[
        :, None])


def _powers(lowest: int, order: int) -> Ints:
    """Return p and q of all terms from a lowest order on, (k, 2), in the order of their sum."""
    return np.array([(total - q, q) for total in range(lowest, order + 1)
                     for q in range(total + 1)])


def _terms(uv: Array, powers: Ints) -> Array:
    return np.asarray(uv[:, :1] ** powers[:, 0] * uv[:, 1:] ** powers[:, 1])


def _fits(detector: Detector, projection: str, crpix: Array, pole: Array, CD: Array,
          tables: list[tuple[str, str, Ints, Array]], order: int,
          cards: tuple[tuple[str, str, str], ...]) -> bytes:
    from astropy.io import fits
    header = fits.Header()
    header['WCSAXES'] = 2
    header['CTYPE1'], header['CTYPE2'] = f'RA---{projection}-SIP', f'DEC--{projection}-SIP'
    header['CUNIT1'] = header['CUNIT2'] = 'deg'
    header['CRVAL1'] = float(np.degrees(np.arctan2(pole[1], pole[0]))) % 360.0
    header['CRVAL2'] = float(np.degrees(np.arcsin(np.clip(pole[2], -1.0, 1.0))))
    header['CRPIX1'], header['CRPIX2'] = crpix.tolist()
    for i in range(2):
        for j in range(2):
            header[f'CD{i + 1}_{j + 1}'] = float(CD[i, j])
    header['RADESYS'] = 'ICRS'
    header['IMAGEW'], header['IMAGEH'] = detector.width, detector.height
    for keyword, value, comment in cards:
        header[keyword] = value, comment
    for first, second, powers, values in tables:
        for name, column in zip((first, second), values.T):
            header[f'{name}_ORDER'] = order
            for (p, q), value in zip(powers.tolist(), column.tolist()):
                header[f'{name}_{p}_{q}'] = value
    stream = BytesIO()
    fits.PrimaryHDU(header=header).writeto(stream)
    return stream.getvalue()
