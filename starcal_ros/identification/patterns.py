# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which stars these are, when nothing is known of the attitude: patterns of four bright stars.

The search is that of `tetra3rs` (G. Pettersson, *Tetra3*, ESA GNC 2023): the ratios of the six
distances in a pattern of four stars are a key that neither attitude nor scale changes. Its
database is built here from our own catalogue, so that its numbers are Hipparcos's: once for a
range of fields, in some two seconds for a field that is known to 10 %, and then kept
(`files.cache`), some 40 MB each.
"""

from __future__ import annotations

from contextlib import suppress
import functools
import hashlib
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.files import cache
from starcal_ros.sky import catalog

_STEP = 1.5             # fields of one database are whole powers of it, from one to the next
_NARROW = 3             # power of it from which on databases are dense
_DENSE, _SPARSE = (25, 100), (6, 40)    # lattice oversampling, patterns a field of the lattice
_STAR = np.dtype([('number', '<i8'), ('ra_deg', '<f8'), ('dec_deg', '<f8'), ('magnitude', '<f4'),
                  ('pm_ra', '<f4'), ('pm_dec', '<f4')])
_MAX_PATTERNS = 200_000  # tried before giving up: some 0.2 s


class PatternMatch(NamedTuple):
    """Spots that were recognised, some 0.5 % of them wrongly.

    Attributes
    ----------
    spot : (m,) int64 array
        Row of each in what was given.
    hip : (m,) int64 array
        Its Hipparcos number.
    focal_px : float
        Focal length that fits them [px].
    mirrored : bool
        The stars match in the mirror only.
    """

    spot: Ints
    hip: Ints
    focal_px: float
    mirrored: bool


def search(uv: Array, flux: Array, detector: Detector, focal_px: tuple[float, float],
           limiting_magnitude: float = catalog.SHIPPED_LIMIT) -> PatternMatch | None:
    """Return spots that form a pattern of the catalogue; None where no pattern is found.

    Parameters
    ----------
    uv : (n, 2) array
        Spots, from the centre of the detector [px].
    flux : (n,) array
        Of the spots, in any unit, NaN where unknown; patterns are made of the brightest.
    detector : Detector
        Its width and height.
    focal_px : (float, float)
        Range in which the focal length lies [px].
    limiting_magnitude : float
        Faintest star of the catalogue, Hp.
    """
    width = detector.width
    low, high = _fields(detector, focal_px)
    # A lens that is off its centre or distorts shows a scale of its own: some 3 % wider.
    middle, margin = (low + high) / 2.0, (high - low) / 2.0 + 0.03 * high
    order = np.argsort(-np.nan_to_num(flux, nan=-np.inf), kind='stable')
    patterns = database(*_steps(low, high), limiting_magnitude)
    found = patterns.solve_from_centroids(
        np.ascontiguousarray(uv[order]), fov_estimate_deg=middle, fov_max_error_deg=margin,
        image_shape=(detector.height, width), solve_timeout_ms=None,
        max_patterns_checked=_MAX_PATTERNS)
    if not found:
        return None
    return PatternMatch(order[found.matched_centroids.astype(np.int64)],
                        found.matched_catalog_ids,
                        width / (2.0 * np.tan(np.radians(found.fov_deg) / 2.0)),
                        found.parity_flip)


def prepare(detector: Detector, focal_px: tuple[float, float],
            limiting_magnitude: float = catalog.SHIPPED_LIMIT) -> None:
    """Build the database that `search` needs, which it would else do itself the first time.

    Raises
    ------
    ImportError, ValueError
        As `database`.
    """
    database(*_steps(*_fields(detector, focal_px)), limiting_magnitude)


def _fields(detector: Detector, focal_px: tuple[float, float]) -> tuple[float, float]:
    """Return the narrowest and the widest field [deg]."""
    low, high = sorted(
        2.0 * float(np.degrees(np.arctan(detector.width / (2.0 * f)))) for f in focal_px)
    return low, high


def _steps(low_deg: float, high_deg: float) -> tuple[int, int]:
    """Return the powers of _STEP between which patterns fill a good part of the field."""
    low, high = np.floor(np.log([low_deg, high_deg]) / np.log(_STEP)).astype(int).tolist()
    return low - 1, high


@functools.cache
def database(low: int, high: int, limiting_magnitude: float) -> Any:
    """Return a `tetra3rs.SolverDatabase` of fields of 1.5**low to 1.5**high degrees.

    Raises
    ------
    ImportError
        Where tetra3rs is missing.
    ValueError
        Where the catalogue does not reach down to the limiting magnitude.
    """
    try:
        tetra3rs = import_module('tetra3rs')
    except ImportError:
        raise ImportError('to identify stars, tetra3rs is needed: '
                          "pip install 'starcal_ros[identify]'") from None
    # The sky has so many narrow fields that dense patterns of all take minutes.
    oversampling, patterns = _DENSE if low >= _NARROW else _SPARSE
    stars = catalog.load(limiting_magnitude)
    table = np.zeros(len(stars), _STAR)
    table['number'], table['magnitude'] = stars.hip, stars.magnitude
    table['ra_deg'], table['dec_deg'] = np.degrees(stars.ra), np.degrees(stars.dec)
    sky = (b'GDR3' + np.array(1, '<u4').tobytes() + np.array(len(table), '<u8').tobytes()
           + table.tobytes())               # laid out as tetra3rs reads it
    options = {'max_fov_deg': _STEP**high, 'min_fov_deg': _STEP**low,
               'epoch_proper_motion_year': None, 'lattice_field_oversampling': oversampling,
               'patterns_per_lattice_field': patterns}
    told = f'{version("tetra3rs")} {options}'
    name = 'patterns_' + hashlib.sha256(sky + told.encode()).hexdigest()
    kept = cache.find(name)
    if kept is not None:
        with suppress(RuntimeError):        # of another build of the library
            return tetra3rs.SolverDatabase.load_from_file(str(kept))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'stars.bin')
        path.write_bytes(sky)
        found = tetra3rs.SolverDatabase.generate_from_gaia(str(path), **options)
    cache.keep(name, lambda draft: found.save_to_file(str(draft)))
    return found
