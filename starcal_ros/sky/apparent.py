# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Apparent places: where a moving observer sees the stars, as unit vectors in i.

Model
-----
From catalogue place to the direction in which light arrives, in this order (IAU SOFA's astrometry
tools, chapter 3; here their free edition ERFA):

1. proper motion from J1991.25 to the epoch of the stamp, and annual parallax  (``pmpx``)
2. deflection of light by the Sun, 4 mas at 90 deg from it                     (``ldsun``)
3. stellar aberration, rigorous, for the observer's barycentric velocity v     (``ab``)
4. refraction, where the observer is at a site on the ground                   (`refraction`)

Aberration is v/c = 20.5" for the Earth and 5" more in low orbit, and it is not a mere rotation:
at the angle a from v, angles shrink or grow by 1 / (gamma (1 + v/c cos a)), up to 1e-4.

Observers
---------
``barycentre``  at rest at the solar system's barycentre: proper motion only
``geocentre``   at the Earth's centre, moving with it (``epv00``)
``orbit``       on a circular two-body orbit about the Earth, in GCRS axes

Nothing is downloaded. Left out: radial velocities, which are not in the catalogue (in 2026 they
have moved 61 Cygni by 0.13", the worst of the shipped stars), deflection by the planets and by
the Earth (0.6 mas at its limb), TDB - TT (2 ms), orbital perturbations.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.utc import unix_ns
from starcal_ros.sky.catalog import Catalog
from starcal_ros.sky.earth import earth
from starcal_ros.sky.refraction import Site, refracted
from starcal_ros.sky.time_scales import tai_ns, tt_julian_date

GM_EARTH = 3.986004418e14
"""Geocentric gravitational constant [m^3/s^2]: IERS Conventions (2010), Table 1.1."""

EARTH_RADIUS = 6378136.6
"""Equatorial radius, from which altitudes count [m]: IERS Conventions (2010), Table 1.1."""

OBSERVERS = ('barycentre', 'geocentre', 'orbit')

_JD_J1991_25 = 2448349.0625


@dataclass(frozen=True)
class Observer:
    """Where the camera is and how fast it moves.

    Attributes
    ----------
    velocity : str
        One of `OBSERVERS`; the elements below matter to ``orbit`` only.
    altitude_km : float
        Height of the orbit above the equatorial radius [km].
    inclination_deg, raan_deg : float
        Inclination and right ascension of the ascending node, GCRS [deg].
    argument_of_latitude_deg : float
        Angle from the ascending node at `epoch_utc` [deg].
    epoch_utc : str
        ISO 8601; UTC unless it says otherwise.
    site : Site, optional
        Where on the ground, with the air above; not with ``orbit``.
    """

    velocity: str = 'geocentre'
    altitude_km: float = 500.0
    inclination_deg: float = 97.4
    raan_deg: float = 0.0
    argument_of_latitude_deg: float = 0.0
    epoch_utc: str = '2026-07-01T00:00:00'
    site: Site | None = None

    def __post_init__(self) -> None:
        if self.velocity not in OBSERVERS:
            raise ValueError(f'observer velocity {self.velocity!r}: '
                             f'one of {", ".join(OBSERVERS)} expected')
        if self.velocity == 'orbit' and self.site is not None:
            raise ValueError('an observer in orbit has no site on the ground')
        unix_ns(self.epoch_utc)

    @property
    def radius(self) -> float:
        """Radius of the orbit [m]."""
        return EARTH_RADIUS + 1e3 * self.altitude_km

    @property
    def mean_motion(self) -> float:
        """Angular rate along the orbit, sqrt(GM / r^3) [rad/s]."""
        return float(np.sqrt(GM_EARTH / self.radius ** 3))

    def geocentric_state(self, stamp_ns: ArrayLike) -> tuple[Array,
                                                             Array]:
        """Return position and velocity relative to the Earth's centre.

        Parameters
        ----------
        stamp_ns : (n,) int64 array
            UTC since the Unix epoch [ns].

        Returns
        -------
        position, velocity : (n, 3) float64 array
            In GCRS axes, which are those of i [m, m/s]; zero for ``geocentre``.

        Raises
        ------
        ValueError
            For ``barycentre``, which does not move with the Earth.
        """
        stamp_ns = np.asarray(stamp_ns, np.int64)
        if self.velocity == 'barycentre':
            raise ValueError('an observer at the barycentre has no geocentric state; '
                             'geocentre or orbit expected')
        if self.velocity == 'geocentre':
            return np.zeros((len(stamp_ns), 3)), np.zeros((len(stamp_ns), 3))
        elapsed_ns = tai_ns(stamp_ns) - tai_ns([unix_ns(self.epoch_utc)])
        latitude = (np.radians(self.argument_of_latitude_deg)
                    + self.mean_motion * (1e-9 * elapsed_ns))[:, np.newaxis]
        inclination, node = np.radians([self.inclination_deg, self.raan_deg])
        to_node = np.array([np.cos(node), np.sin(node), 0.0])
        to_apex = np.array([-np.cos(inclination) * np.sin(node),  # 90 deg past the node
                            np.cos(inclination) * np.cos(node), np.sin(inclination)])
        radial = np.cos(latitude) * to_node + np.sin(latitude) * to_apex
        along = np.cos(latitude) * to_apex - np.sin(latitude) * to_node
        return self.radius * radial, self.radius * self.mean_motion * along


def apparent_places(catalog: Catalog, rows: Ints, stamp_ns: ArrayLike,
                    counts: ArrayLike, observer: Observer) -> Array:
    """Return where the observer sees the stars of one or many frames.

    Parameters
    ----------
    catalog : Catalog
        The stars.
    rows : (n_stars,) int64 array
        Their rows in `catalog`, frame after frame.
    stamp_ns : (n_frames,) int64 array
        UTC since the Unix epoch [ns].
    counts : (n_frames,) int array
        Number of stars in each frame; they add up to n_stars.
    observer : Observer
        Who looks.

    Returns
    -------
    u_i : (n_stars, 3) float64 array
        Unit vectors towards the stars.

    Raises
    ------
    ValueError
        If a row is negative: a star that `Catalog.rows` did not find.
    """
    if np.any(rows < 0):
        raise ValueError(f'{np.sum(rows < 0)} of {len(rows)} stars are not in the catalogue: '
                         'rows from 0 expected')
    counts = np.asarray(counts, np.int64)
    place = (catalog.ra[rows], catalog.dec[rows], catalog.pm_ra[rows], catalog.pm_dec[rows])
    stamp_ns = np.asarray(stamp_ns, np.int64)
    day, fraction = tt_julian_date(stamp_ns)
    years = np.repeat(((day - _JD_J1991_25) + fraction) / erfa.DJY, counts)
    if observer.velocity == 'barycentre':
        u_i = erfa.pmpx(*place, 0.0, 0.0, years, np.zeros(3))
        return _through_air(u_i, stamp_ns, counts, observer.site)

    earth_heliocentric, earth_barycentric = earth(stamp_ns)
    state = np.empty(len(day), erfa.dt_pv)
    state['p'], state['v'] = observer.geocentric_state(stamp_ns)
    frame = erfa.apcs(day, fraction, state, earth_barycentric, earth_heliocentric)
    from_barycentre, from_sun, sun_distance_au, v_over_c, inverse_gamma = (
        np.repeat(frame[name], counts, axis=0) for name in ('eb', 'eh', 'em', 'v', 'bm1'))
    u_i = erfa.pmpx(*place, catalog.parallax_arcsec[rows], 0.0, years, from_barycentre)
    u_i = erfa.ldsun(u_i, from_sun, sun_distance_au)
    return _through_air(erfa.ab(u_i, v_over_c, sun_distance_au, inverse_gamma), stamp_ns, counts,
                        observer.site)


def _through_air(u_i: Array, stamp_ns: Ints, counts: Ints, site: Site | None) -> Array:
    if site is None:
        return np.asarray(u_i)
    return refracted(u_i, np.repeat(stamp_ns, counts), site)
