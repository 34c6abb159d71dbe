# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Refraction: where an observer on the ground sees the stars through the air.

Model
-----
A star at the zenith distance z without air is seen at z_o, raised towards the zenith ::

    z_o = z - A tan z_o - B tan^3 z_o                                                    (A.1)

with A and B of pressure, temperature, humidity and wavelength (ERFA's ``refco``). For that air it
is good to 0.1" down to 15 deg above the horizon and to a few seconds of arc at 5 deg; below, the
refraction of 5 deg is taken. Where pressure or temperature are not stated they are those of the
standard atmosphere at the height of the site (ISA: 15 deg C, 1013.25 hPa at sea level).

Across a field of 10 deg at the altitude of 20 deg refraction differs by 1.5', and it shrinks a
field at the zenith by 2.8e-4: a camera that is calibrated through the air needs it.

The zenith follows from the Earth's rotation, UT1 taken as UTC and without polar motion, so that no
table has to be downloaded: 14" at most, which change a refraction by 0.04" at 20 deg. Left out:
diurnal aberration, 0.3", which moves all of a field alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from starcal_ros.core.arrays import Array
from starcal_ros.sky.time_scales import tt_julian_date

LOWEST_DEG = 5.0
"""Altitude down to which refraction is known."""

_DAY_NS = 86_400_000_000_000
_JD_1970 = 2440587.5
_TROPOPAUSE_M = 11000.0
_ITERATIONS = 4                 # of Newton's method: to nanoradians


@dataclass(frozen=True)
class Site:
    """A place on the Earth and its air.

    Attributes
    ----------
    latitude_deg, longitude_deg : float
        Geodetic; north and east are positive [deg].
    height_m : float
        Above the sea [m].
    pressure_hpa, temperature_c : float or None
        At the site; None for the standard atmosphere [hPa, deg C].
    humidity : float
        Relative, 0 to 1.
    wavelength_um : float
        In the middle of what the camera sees [um].
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    pressure_hpa: float | None = None
    temperature_c: float | None = None
    humidity: float = 0.5
    wavelength_um: float = 0.55

    def __post_init__(self) -> None:
        for name, low, high, unit in (
                ('latitude_deg', -90.0, 90.0, 'deg'), ('longitude_deg', -360.0, 360.0, 'deg'),
                ('height_m', -500.0, 50000.0, 'm'), ('pressure_hpa', 0.0, 1200.0, 'hPa'),
                ('temperature_c', -100.0, 60.0, 'deg C')):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f'{name.rpartition("_")[0]} of the site: got {value:g} {unit}, '
                                 f'allowed is {low:g} to {high:g}')

    @property
    def air(self) -> tuple[float, float]:
        """Pressure [hPa] and temperature [deg C] that count."""
        temperature = 15.0 - 0.0065 * min(self.height_m, _TROPOPAUSE_M)
        pressure = 1013.25 * ((temperature + 273.15) / 288.15)**5.25588
        if self.height_m > _TROPOPAUSE_M:
            pressure *= np.exp((_TROPOPAUSE_M - self.height_m) / 6341.6)
        return (float(pressure if self.pressure_hpa is None else self.pressure_hpa),
                float(temperature if self.temperature_c is None else self.temperature_c))


def altitude(u_i: Array, stamp_ns: ArrayLike, site: Site) -> Array:
    """Return the altitudes (n,) of directions u_i (n, 3), without air, at stamps (n,) [rad]."""
    return np.pi / 2.0 - _zenith_distance(u_i, _zenith(stamp_ns, site))


def refracted(u_i: Array, stamp_ns: ArrayLike, site: Site) -> Array:
    """Return where stars are seen through the air, Eq. (A.1).

    Parameters
    ----------
    u_i : (n, 3) array
        Apparent places without air, unit vectors.
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch, of each [ns].
    site : Site
        Where the observer is.

    Returns
    -------
    u_i : (n, 3) array
        Unit vectors, in the same axes.
    """
    zenith = _zenith(stamp_ns, site)
    z = _zenith_distance(u_i, zenith)
    sine = np.sin(z)
    raised = refraction(z, site)
    up = zenith - np.cos(z)[:, None] * u_i          # square to u_i, of length sin z
    up /= np.maximum(sine, 1e-12)[:, None]
    return np.cos(raised)[:, None] * u_i + np.sin(raised)[:, None] * up


def refraction(z: Array, site: Site) -> Array:
    """Return by how much stars at the zenith distances z without air are raised [rad]."""
    pressure, temperature = site.air
    A, B = erfa.refco(pressure, temperature, site.humidity, site.wavelength_um)
    z = np.minimum(z, np.radians(90.0 - LOWEST_DEG))
    seen = z
    for _ in range(_ITERATIONS):
        t = np.tan(seen)
        seen = seen - (seen + A * t + B * t**3 - z) / (1.0 + (A + 3.0 * B * t**2) * (1.0 + t**2))
    return np.asarray(z - seen)


def _zenith(stamp_ns: ArrayLike, site: Site) -> Array:
    """Return the zenith (n, 3) in the axes of i."""
    stamp_ns, place = np.unique(np.asarray(stamp_ns, np.int64), return_inverse=True)
    day, rest_ns = np.divmod(stamp_ns, _DAY_NS)
    C_ti = erfa.c2t06a(*tt_julian_date(stamp_ns), _JD_1970 + day, rest_ns / _DAY_NS, 0.0, 0.0)
    up = erfa.s2c(np.radians(site.longitude_deg), np.radians(site.latitude_deg))
    return np.asarray(up @ C_ti)[place]


def _zenith_distance(u_i: Array, zenith: Array) -> Array:
    return np.arctan2(np.linalg.norm(np.cross(u_i, zenith), axis=-1),
                      np.einsum('ij,ij->i', u_i, zenith))
