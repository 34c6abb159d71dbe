# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time scales of stamps: UTC, TAI and TT.

Stamps are ROS's: ns since 1970-01-01 UTC without leap seconds. TAI - UTC comes from ERFA's table;
before 1972 its first whole value, 10 s, is used. A stamp inside a leap second cannot be told from
the second beside it.
"""

from __future__ import annotations

from functools import cache

import erfa
import numpy as np
from numpy.typing import ArrayLike

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.utc import unix_ns

DAY_NS = 86_400_000_000_000
"""A day [ns]."""
JD_1970 = 2440587.5
"""Julian date of the Unix epoch."""

_TT_MINUS_TAI_NS = 32_184_000_000


def tt_julian_date(stamp_ns: ArrayLike) -> tuple[Array, Array]:
    """Return the Julian date in TT, in two parts to keep the nanoseconds.

    Parameters
    ----------
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch [ns].

    Returns
    -------
    day, fraction : (n,) float64 array
        Julian date of the preceding midnight, and the part of the day since [d].
    """
    day, rest_ns = np.divmod(tt_ns(stamp_ns), DAY_NS)
    return JD_1970 + day, rest_ns / DAY_NS


def tt_ns(stamp_ns: ArrayLike) -> Ints:
    """Return TT since 1970-01-01 TT of UTC stamps [ns].

    Parameters
    ----------
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch [ns].
    """
    return tai_ns(stamp_ns) + _TT_MINUS_TAI_NS


def tai_ns(stamp_ns: ArrayLike) -> Ints:
    """Return TAI since 1970-01-01 TAI of UTC stamps [ns]: a count without gaps or repetition.

    Parameters
    ----------
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch [ns].
    """
    stamp_ns = np.asarray(stamp_ns, np.int64)
    since_ns, tai_minus_utc_ns = _leap_seconds()
    row = np.searchsorted(since_ns, stamp_ns, 'right') - 1
    return stamp_ns + tai_minus_utc_ns[np.maximum(row, 0)]


@cache
def _leap_seconds() -> tuple[Ints, Ints]:
    """Return when each TAI - UTC came into force, from 1972, and its value, both in ns."""
    table = erfa.leap_seconds.get()
    table = table[table['year'] >= 1972]
    since_ns = [unix_ns(f'{year:04d}-{month:02d}-01')
                for year, month in zip(table['year'], table['month'])]
    return np.array(since_ns, np.int64), np.rint(1e9 * table['tai_utc']).astype(np.int64)
