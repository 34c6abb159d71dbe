# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identified stars of still images as a table, and as frames in the order of their times."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.parameter import ConfigError
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.utc import unix_ns
from starcal_ros.measurements.samples import Frames

_COLUMNS = ('image', 'u', 'v', 'catalog_id')
_LARGEST_ID = 2**31
_STEP_NS = 10**6        # between images without a time of their own: methods want an order


@dataclass(frozen=True)
class StillImages:
    """Images and the stars found in them.

    Attributes
    ----------
    names : tuple of str
        Images, in the order of the frames.
    frames : Frames
        Their stars.
    heldout : (n,) bool array
        Images that judge a calibration and take no part in it.
    """

    names: tuple[str, ...]
    frames: Frames
    heldout: Mask

    def which(self, part: Mask) -> StillImages:
        """Return some of the images."""
        return StillImages(tuple(np.array(self.names)[part].tolist()), self.frames.take(part),
                           self.heldout[part])


def read_centroids(path: str | Path, epoch_utc: str) -> StillImages:
    """Read a table of identified stars.

    Parameters
    ----------
    path : path
        CSV with a head: ``image``, ``u``, ``v`` [raster px], ``catalog_id`` (Hipparcos), and
        optionally ``split``, ``fit`` or ``heldout``, the same for all stars of an image, and
        ``sigma`` of a centroid, right but for a factor that all share [px]; a factor of more than
        one and a half is held against the camera (`residual_tests`).
    epoch_utc : str
        Time of the images, for the proper motions, ISO 8601.

    Raises
    ------
    ConfigError
        Where a column is missing or a row is not what it should be.
    """
    try:
        text = Path(path).read_text(encoding='utf-8-sig')
    except UnicodeDecodeError as error:
        raise ConfigError(f'{path}: is not UTF-8: byte {error.start} is '
                          f'0x{error.object[error.start]:02x}') from None
    except OSError as error:
        raise ConfigError(f'{path}: cannot be read: {error.strerror}') from None
    try:
        return _read(text, path, epoch_utc)
    except csv.Error as error:
        raise ConfigError(f'{path}: not CSV: {error}') from None


def _read(text: str, path: str | Path, epoch_utc: str) -> StillImages:
    rows: dict[str, list[tuple[float, float, int, float]]] = {}
    splits: dict[str, str] = {}
    table = csv.DictReader(StringIO(text, newline=''))
    missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        raise ConfigError(f'{path}: no column {", ".join(missing)}; needs '
                          f'{", ".join(_COLUMNS)}')
    for row in table:
        image, split = row['image'], row.get('split') or 'fit'
        try:
            star = (float(row['u']), float(row['v']), int(row['catalog_id']),
                    float(row.get('sigma') or 0.0))
            if not np.isfinite(star).all() or abs(star[2]) > _LARGEST_ID:
                raise ValueError('not finite')
        except (TypeError, ValueError, OverflowError):
            raise ConfigError(
                f'{path}, line {table.line_num}: got {row["u"]!r}, {row["v"]!r}, '
                f'{row["catalog_id"]!r}, needs two numbers and a Hipparcos number (and a '
                'number for sigma)') from None
        if split not in ('fit', 'heldout') or splits.setdefault(image, split) != split:
            raise ConfigError(f'{path}, line {table.line_num}: got split {split!r}, needs fit '
                              'or heldout, the same for all stars of an image')
        rows.setdefault(image, []).append(star)
    return assemble(list(rows), [np.array(stars)[:, :2] for stars in rows.values()],
                    [np.array(stars)[:, 2] for stars in rows.values()],
                    [splits[image] == 'heldout' for image in rows], epoch_utc,
                    [np.array(stars)[:, 3] for stars in rows.values()])


def assemble(names: list[str], uv_raster: list[Array], catalog_id: list[NDArray[Any]],
             heldout: list[bool], epoch_utc: str, sigma: list[Array] | None = None,
             stamp_ns: list[int | None] | None = None) -> StillImages:
    """Return images as frames, in the order of their times.

    Parameters
    ----------
    names : list of str
    uv_raster : list of (n, 2) arrays
        Centroids of each image [px].
    catalog_id : list of (n,) arrays
        Hipparcos numbers.
    heldout : list of bool
    epoch_utc : str
        Time of images without one, ISO 8601.
    sigma : list of (n,) arrays, optional
        Standard deviation of each centroid, right but for a factor that all share [px].
    stamp_ns : list of int or None, optional
        Time of each image, UTC since the Unix epoch.
    """
    counts = [len(stars) for stars in uv_raster]
    total, step = sum(counts), np.arange(len(names))
    stamps = unix_ns(epoch_utc) + _STEP_NS * step
    for k, own in enumerate(stamp_ns or ()):
        stamps[k] = stamps[k] if own is None else own
    frames = Frames(
        stamps, np.concatenate(([0], np.cumsum(counts, dtype=np.int64))),
        np.concatenate([np.empty((0, 2)), *uv_raster]),
        np.zeros(total) if sigma is None else np.concatenate([np.empty(0), *sigma]),
        np.full(total, np.nan), np.concatenate([np.empty(0), *catalog_id]).astype(np.int64))
    order = np.argsort(stamps, kind='stable')
    frames = frames.take(order)
    later = np.maximum.accumulate(frames.stamp_ns - step) + step    # no two at the same time
    return StillImages(tuple(names[k] for k in order), replace(frames, stamp_ns=later),
                       np.array(heldout, bool)[order])
