# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sky with what was found in them drawn over: spots, stars, a grid, a reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from itertools import groupby
from textwrap import wrap
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont
import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.models import detector
from starcal_ros.core import lenses
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.report import sky_grid
from starcal_ros.sky import catalog
from starcal_ros.sky.star_names import name_of
from starcal_ros.workflows.still_images.calibration import StillImageCamera
from starcal_ros.workflows.still_images.measured import Measured, pictures_of

LONGEST_PX = 1200
"""Longer side of a picture as it is drawn."""

LEGEND = ('green: star of the fit · red: refused by the fit · yellow: spot that is no star of '
          'it · orange: saturated, blended, cut or of another shape')

Font = ImageFont.ImageFont | ImageFont.FreeTypeFont

_STAR, _REFUSED, _SPOT, _UNFIT, _GRID = '#40ff60', '#ff4040', '#ffe060', '#ff9020', '#5080c0'
_NAMED = 25             # the brightest stars have their names beside them
_BRIGHT, _NEAR_PX = 6.0, 5.0    # Hp of a star that an unfit spot may be, and how near
_RADIUS, _TEXT = 9, 13
_LOW, _HIGH, _GAMMA = 60.0, 99.8, 0.7      # percentiles that become black and white


class ImageSky(NamedTuple):
    """The stars of an image, as the camera was fitted to them.

    Attributes
    ----------
    uv_raster : (n, 2) array
        Their centroids [px].
    catalog_id : (n,) int64 array
        Their numbers.
    used : (n,) bool array
        Which were not refused.
    C_si : (3, 3) array
        Attitude.
    intrinsics : (p,) array
        With the focal length that the image has for itself, where it has one.
    lens : LensModel
    pixels : Detector
    flipped : bool
        Whether all of this is of the image flipped, top to bottom.
    """

    uv_raster: Array
    catalog_id: Ints
    used: Mask
    C_si: Array
    intrinsics: Array
    lens: LensModel
    pixels: Detector
    flipped: bool


class Annotated(NamedTuple):
    """A picture that is drawn.

    Attributes
    ----------
    name : str
        Image.
    caption : str
        What became of it.
    image : PIL.Image.Image
    """

    name: str
    caption: str
    image: Image.Image

    def jpeg(self, longest_px: int = LONGEST_PX, quality: int = 80) -> bytes:
        """Return it as JPEG, its longer side not longer than some pixels."""
        small, stream = self.image.copy(), BytesIO()
        small.thumbnail((longest_px, longest_px))
        small.save(stream, 'JPEG', quality=quality)
        return stream.getvalue()


def skies(found: StillImageCamera, flipped: bool) -> dict[str, ImageSky]:
    """Return the stars of the images of a camera, by name."""
    pixels, skies_ = detector(found.scenario.camera), {}
    for refit in (found.fit, found.heldout):
        for k, name in enumerate(refit.names if refit else ()):
            assert refit is not None
            mine = refit.spots.frame == k
            skies_[name] = ImageSky(
                refit.spots.uv[mine] + pixels.centre_raster, refit.catalog_id[mine],
                refit.adjusted.used[mine], refit.adjusted.C_si[k],
                refit.adjusted.intrinsics_of(np.array([k]))[0], found.lens, pixels, flipped)
    return skies_


def annotate(images: Sequence[Measured], known: dict[str, ImageSky], left_out: Mapping[str, str]
             ) -> Iterator[Annotated]:
    """Read images once more and draw what was found in each.

    Parameters
    ----------
    images : sequence of Measured
    known : dict of ImageSky
        By name, of those that a camera was fitted to.
    left_out : mapping
        By name, why the others were not.
    """
    for path, those in groupby(images, lambda image: image.path):
        wanted = {image.plane: image for image in those}
        for plane, picture in enumerate(pictures_of(path)):
            if isinstance(picture, str) or (image := wanted.pop(plane, None)) is None:
                continue
            sky = known.get(image.name)
            caption = _caption(image, sky, left_out.get(image.name, 'not used'))
            yield Annotated(image.name, caption, _drawn(
                picture.shown, image, sky, f'{image.name}: {caption}'))
            if not wanted:
                break


def _caption(image: Measured, sky: ImageSky | None, why: str) -> str:
    if sky is None:
        return f'left out: {why}'
    return (f'{sky.used.sum()} stars, {(~sky.used).sum()} refused, of '
            f'{len(image.centroids.flux)} spots')


def _drawn(counts: NDArray[np.float32], image: Measured, sky: ImageSky | None, text: str
           ) -> Image.Image:
    """Return the picture with its marks, above the text."""
    height, width = image.shape
    flip = sky is not None and sky.flipped
    grey = Image.fromarray(_stretched(counts[::-1] if flip else counts))
    scale = LONGEST_PX / max(height, width)
    scale = float(np.floor(scale)) if scale > 1.0 else scale
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    canvas = grey.resize(size, Image.Resampling.BOX).convert('RGB')
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(_TEXT)

    def at(uv_raster: Array) -> list[tuple[float, float]]:
        return [(u, v) for u, v in ((uv_raster + 0.5) * scale).tolist()]

    if sky is not None:
        for line in sky_grid.lines(sky.C_si, sky.intrinsics, sky.lens, sky.pixels):
            points = at(line.uv_raster)
            draw.line(points, fill=_GRID)
            if inside := [point for point in points
                          if 4 < point[0] < size[0] - 60 and 4 < point[1] < size[1] - 20]:
                draw.text(inside[0], line.label, fill=_GRID, font=font)
    spots = image.centroids.uv_raster
    if flip:
        spots = spots * [1.0, -1.0] + [0.0, height - 1.0]
    taken = np.empty((0, 2)) if sky is None else sky.uv_raster
    free = (np.linalg.norm(spots[:, None] - taken, axis=-1) > 0.5).all(axis=1)
    for row, point in zip(np.flatnonzero(free).tolist(), at(spots[free])):
        _ring(draw, point, _UNFIT if image.centroids.flags[row] else _SPOT, _RADIUS - 3)
    if sky is not None:
        for point, good in zip(at(sky.uv_raster), sky.used.tolist()):
            _ring(draw, point, _STAR if good else _REFUSED, _RADIUS)
        for row in _brightest(sky.catalog_id):
            colour = _STAR if sky.used[row] else _REFUSED
            _name(draw, at(sky.uv_raster[row:row + 1])[0], int(sky.catalog_id[row]), colour, font)
        for spot, hip in _unfit_stars(spots[free & (image.centroids.flags > 0)], sky):
            _name(draw, at(spot[None])[0], hip, _UNFIT, font)
    return _above(canvas, text, font)


def _brightest(hip: Ints) -> list[int]:
    stars = catalog.load_containing(hip)
    return [int(row) for row in np.argsort(stars.magnitude[stars.rows(hip)],
                                           kind='stable')[:_NAMED]]


def _unfit_stars(spots: Array, sky: ImageSky) -> Iterator[tuple[Array, int]]:
    """Yield spots near a bright star that took no part, and its number."""
    stars = catalog.load(_BRIGHT)
    u_i = np.stack((np.cos(stars.dec) * np.cos(stars.ra), np.cos(stars.dec) * np.sin(stars.ra),
                    np.sin(stars.dec)), axis=-1)
    r_s = u_i @ sky.C_si.T
    ahead = np.flatnonzero(lenses.in_field(sky.lens, r_s, sky.intrinsics, sky.pixels))
    uv = sky.lens.project(r_s[ahead], sky.intrinsics) + sky.pixels.centre_raster
    for spot in spots:
        away = np.linalg.norm(uv - spot, axis=-1)
        if len(away) and away.min() < _NEAR_PX:
            yield spot, int(stars.hip[ahead[away.argmin()]])


def _name(draw: ImageDraw.ImageDraw, at: tuple[float, float], hip: int, colour: str, font: Font
          ) -> None:
    draw.text((at[0] + _RADIUS + 1, at[1] - _TEXT), name_of(hip), font=font, fill=colour)


def _ring(draw: ImageDraw.ImageDraw, at: tuple[float, float], colour: str, radius: int) -> None:
    u, v = at
    draw.ellipse((u - radius, v - radius, u + radius, v + radius), outline=colour, width=2)


def _above(canvas: Image.Image, text: str, font: Font) -> Image.Image:
    """Return a picture with lines of text under it."""
    rows = [row for each in (text, LEGEND) for row in wrap(each, max(20, canvas.width // 7))]
    step = _TEXT + 4
    page = Image.new('RGB', (canvas.width, canvas.height + step * len(rows) + 6), '#101418')
    page.paste(canvas)
    draw = ImageDraw.Draw(page)
    for k, row in enumerate(rows):
        draw.text((6, canvas.height + 3 + k * step), row, fill='#ffffff', font=font)
    return page


def _stretched(counts: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return counts as grey, the faint lifted; what is not known is black."""
    known = np.isfinite(counts)
    if not known.any():
        return np.zeros(counts.shape, np.uint8)
    low, high = np.percentile(counts[known], [_LOW, _HIGH])
    part = np.clip((np.where(known, counts, low) - low) / max(high - low, 1e-9), 0.0, 1.0)
    return np.rint(255.0 * part**_GAMMA).astype(np.uint8)
