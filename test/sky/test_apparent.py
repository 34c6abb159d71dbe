# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Apparent places: against astropy, and against what is known of aberration and orbits."""

import socket
import subprocess
import sys

import erfa
import numpy as np
from numpy.typing import NDArray
import pytest

from starcal_ros.sky.apparent import GM_EARTH, Observer, apparent_places
from starcal_ros.sky.catalog import Catalog, load, load_containing
from starcal_ros.sky.time_scales import _leap_seconds, tai_ns, tt_julian_date

Array = NDArray[np.float64]

DAY = 86400 * 10**9  # ns
T0 = 1782907200 * 10**9  # 2026-07-01T12:00:00 UTC
J1991_25 = 670_598_941_816_000_000  # 1991-04-02T13:30:00 TT, which is UTC + 58.184 s
ARCSEC, MAS = erfa.DAS2R, erfa.DMAS2R
ORBIT = Observer('orbit', altitude_km=500.0, inclination_deg=97.4, raan_deg=40.0,
                 argument_of_latitude_deg=10.0, epoch_utc='2026-07-01T12:00:00')
OBSERVERS = [Observer('barycentre'), Observer('geocentre'), ORBIT]


def angle(a_i: Array, b_i: Array) -> Array:
    """Return the angle between unit vectors [rad]; exact for small ones (Kahan)."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(a_i - b_i, axis=-1),
                                       np.linalg.norm(a_i + b_i, axis=-1)))


def fixed_stars(u_i: Array, parallax_arcsec: float = 0.0) -> Catalog:
    """Return invented stars in these directions, without proper motion."""
    ra, dec = erfa.c2s(u_i)
    zero = np.zeros(len(u_i))
    return Catalog(np.arange(1, len(u_i) + 1), ra, dec, zero, zero, zero + parallax_arcsec, zero,
                   zero)


def see(stars: Catalog, stamp_ns: int, observer: Observer) -> Array:
    """Return the apparent places of all stars of a catalogue at one time."""
    return apparent_places(stars, np.arange(len(stars)), [stamp_ns], [len(stars)], observer)


def barycentric_velocity(stamp_ns: int, observer: Observer) -> Array:
    """Return the observer's velocity [m/s] from ERFA's Earth."""
    _, earth = erfa.epv00(*tt_julian_date([stamp_ns]))
    return np.asarray(earth['v'][0] * erfa.DAU / erfa.DAYSEC
                      + observer.geocentric_state([stamp_ns])[1][0])


# Against astropy

@pytest.mark.parametrize('observer', OBSERVERS[1:], ids=lambda observer: observer.velocity)
@pytest.mark.parametrize('stamp_ns', [J1991_25, T0, T0 + 91 * DAY, T0 - 3650 * DAY])
def test_places_agree_with_astropy_gcrs(observer: Observer, stamp_ns: int) -> None:
    from astropy import units as u
    from astropy.coordinates import GCRS, CartesianRepresentation, Distance, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    stars = load()
    rows = np.flatnonzero(stars.parallax_arcsec > 1e-3)  # astropy wants a distance
    rows = np.union1d(rows[::20], rows[np.argsort(stars.pm_dec[rows])[[0, 1, -2, -1]]])
    position, velocity = observer.geocentric_state([stamp_ns])
    day, fraction = tt_julian_date([stamp_ns])
    with iers.conf.set_temp('auto_download', False):
        when = Time(day[0], fraction[0], format='jd', scale='tt')
        icrs = SkyCoord(
            ra=stars.ra[rows] * u.rad, dec=stars.dec[rows] * u.rad,
            distance=Distance(parallax=stars.parallax_arcsec[rows] * u.arcsec),
            pm_ra_cosdec=stars.pm_ra[rows] * np.cos(stars.dec[rows]) * u.rad / u.yr,
            pm_dec=stars.pm_dec[rows] * u.rad / u.yr, radial_velocity=0 * u.km / u.s,
            obstime=Time('J1991.25', scale='tt'))
        gcrs = icrs.apply_space_motion(new_obstime=when).transform_to(GCRS(
            obstime=when, obsgeoloc=CartesianRepresentation(position[0] * u.m),
            obsgeovel=CartesianRepresentation(velocity[0] * u.m / u.s)))
    expected = erfa.s2c(gcrs.ra.rad, gcrs.dec.rad)
    found = apparent_places(stars, rows, [stamp_ns], [len(rows)], observer)
    # ERFA counts proper motion from the light's arrival at the barycentre, up to 1 au (499 s)
    # from here, astropy from its arrival here. The rest is rounding: 0.01 mas is 5e-11 rad.
    proper_motion = np.hypot(stars.pm_ra[rows] * np.cos(stars.dec[rows]), stars.pm_dec[rows])
    tolerance = 0.01 * MAS + proper_motion * 1.02 * 499.0 / (365.25 * 86400.0)
    assert np.all(angle(found, expected) < tolerance)
    assert np.percentile(angle(found, expected), 99) < 0.1 * MAS


@pytest.mark.parametrize('utc', ['1972-01-01T00:00:00', '1999-12-31T23:59:59.999999999',
                                 '2016-12-31T23:59:59', '2017-01-01T00:00:00',
                                 '2026-07-01T12:34:56.789012345'])
def test_terrestrial_time_agrees_with_astropy_to_the_nanosecond(utc: str) -> None:
    from astropy.time import Time
    from astropy.utils import iers
    with iers.conf.set_temp('auto_download', False):
        expected = Time(utc, scale='utc').tt
    day, fraction = tt_julian_date([np.datetime64(utc, 'ns').astype(np.int64)])
    difference = (day[0] - expected.jd1) + (fraction[0] - expected.jd2)
    assert abs(difference) * 86400.0 < 1e-9


# Time

def test_the_leap_second_of_2016_lies_between_two_stamps_one_second_apart() -> None:
    new_year = np.datetime64('2017-01-01T00:00:00', 'ns').astype(np.int64)
    before, after = tai_ns(np.array([new_year - 10**9, new_year]))
    assert after - before == 2 * 10**9
    # IERS Bulletin C 52: TAI - UTC is 36 s until, 37 s from 2017-01-01.
    assert before - (new_year - 10**9) == 36 * 10**9
    assert after - new_year == 37 * 10**9


def test_a_clock_that_starts_at_zero_is_accepted() -> None:
    assert tai_ns([0]).tolist() == [10 * 10**9]
    assert np.isfinite(see(load(2.0), 0, ORBIT)).all()


# Proper motion

def test_barnards_star_moves_10_4_arcsec_a_year() -> None:
    stars = load_containing([87937])
    row = stars.rows([87937])
    if row[0] < 0:
        pytest.skip('the full catalogue is not installed')
    stamps = J1991_25 + np.array([0, 8766 * 3600 * 10**9])  # a Julian year
    u_i = apparent_places(stars, np.repeat(row, 2), stamps, [1, 1], Observer('barycentre'))
    motion = angle(u_i[0], u_i[1]) / ARCSEC
    # Gaia DR3: 10.393"/yr at J2016.0. Perspective makes it grow by 1.25 mas/yr each year, for
    # 24.75 years; Hipparcos knows it to 1.2-1.7 mas/yr (here three times that).
    assert motion == pytest.approx(10.393 - 24.75 * 1.25e-3, abs=5e-3)


def test_at_the_catalogue_epoch_the_barycentre_sees_the_catalogue_places() -> None:
    stars = load(5.0)
    catalogue_i = erfa.s2c(stars.ra, stars.dec)
    assert np.all(angle(see(stars, J1991_25, Observer('barycentre')), catalogue_i) < 1e-15)


# Aberration

def test_the_barycentre_sees_no_aberration_parallax_or_deflection() -> None:
    u_i = np.random.default_rng(2).normal(size=(100, 3))
    u_i /= np.linalg.norm(u_i, axis=1)[:, np.newaxis]
    stars = fixed_stars(u_i, parallax_arcsec=0.5)
    for stamp_ns in (T0, T0 + 91 * DAY):
        assert np.all(angle(see(stars, stamp_ns, Observer('barycentre')), u_i) < 1e-15)


def test_a_star_at_the_ecliptic_pole_draws_the_circle_of_annual_aberration() -> None:
    obliquity = 84381.406 * ARCSEC  # IAU 2006
    pole_i = np.array([[0.0, -np.sin(obliquity), np.cos(obliquity)]])
    stars = fixed_stars(pole_i)
    stamps = T0 + DAY * np.arange(0, 366)
    u_i = apparent_places(stars, np.zeros(366, np.int64), stamps, np.ones(366, int),
                          Observer('geocentre'))
    radius = angle(u_i, pole_i) / ARCSEC
    # Constant of aberration 20.49552" (IAU 1976), eccentricity 0.0167; the Earth moves 13 m/s
    # about the Earth-Moon barycentre and the Sun up to 16 m/s: 0.02". Deflection adds 0.004".
    assert radius.min() == pytest.approx(20.49552 * (1 - 0.0167), abs=0.025)
    assert radius.max() == pytest.approx(20.49552 * (1 + 0.0167), abs=0.025)


@pytest.mark.parametrize('observer', OBSERVERS[1:], ids=lambda observer: observer.velocity)
@pytest.mark.parametrize('from_apex_deg', [0.0, 60.0, 90.0, 120.0, 180.0])
def test_aberration_rescales_a_small_field_by_up_to_1e_4(observer: Observer,
                                                         from_apex_deg: float) -> None:
    velocity = barycentric_velocity(T0, observer)
    beta = np.linalg.norm(velocity) / erfa.CMPS
    apex = velocity / np.linalg.norm(velocity)
    side = np.cross(apex, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    a = np.radians(from_apex_deg + np.array([-0.5, 0.5]))[:, np.newaxis]
    stars = fixed_stars(np.cos(a) * apex + np.sin(a) * side)
    scale = (angle(*see(stars, T0, observer))
             / angle(*see(stars, T0, Observer('barycentre'))))
    # tan(a'/2) = sqrt((1 - beta)/(1 + beta)) tan(a/2): special relativity, exact
    shrink = np.sqrt((1.0 - beta) / (1.0 + beta))
    seen = 2.0 * np.arctan(shrink * np.tan(a[:, 0] / 2.0))
    if from_apex_deg == 180.0:
        seen[1] += 2.0 * np.pi
    # The Sun's deflection, 4.07 mas cot(b/2) at b from it, adds at most 4.07 mas/(2 sin^2(b/2)),
    # here b > 20 deg: 3.3e-7.
    assert scale == pytest.approx((seen[1] - seen[0]) / np.radians(1.0), abs=3.5e-7)
    assert scale - 1.0 == pytest.approx(-beta * np.cos(np.radians(from_apex_deg)), abs=4e-7)


def test_half_an_orbit_later_the_orbits_own_aberration_is_opposite() -> None:
    stars = load(3.0)
    half_period = round(1e9 * np.pi / ORBIT.mean_motion)
    own = [see(stars, stamp_ns, ORBIT) - see(stars, stamp_ns, Observer('geocentre'))
           for stamp_ns in (T0, T0 + half_period)]
    beta = ORBIT.radius * ORBIT.mean_motion / erfa.CMPS
    assert np.linalg.norm(own[0], axis=1).max() == pytest.approx(beta, rel=2e-2)
    # What is odd in the orbit's velocity cancels, and so does its parallax; left over is twice
    # the second order, which is at most beta^2 / 2. (The Earth's own velocity turns by 17 m/s
    # in the meantime: 1.4e-12.)
    assert np.linalg.norm(own[0] + own[1], axis=1).max() < beta ** 2


# Orbit

def test_the_orbit_is_a_circle_of_its_radius_at_the_two_body_speed() -> None:
    position, velocity = ORBIT.geocentric_state(T0 + 10**9 * np.arange(0, 86400, 60))
    radius = 6378136.6 + 500e3
    assert np.allclose(np.linalg.norm(position, axis=1), radius, rtol=1e-14)
    assert np.allclose(np.linalg.norm(velocity, axis=1), np.sqrt(GM_EARTH / radius),
                       rtol=1e-14)
    assert np.abs(np.sum(position * velocity, axis=1)).max() < 1e-14 * radius * 7613.0


def test_the_orbit_stands_at_its_elements_at_its_epoch() -> None:
    position, velocity = ORBIT.geocentric_state([T0])
    normal = np.cross(position[0], velocity[0])
    normal /= np.linalg.norm(normal)
    node = np.cross([0.0, 0.0, 1.0], normal)
    assert np.degrees(np.arccos(normal[2])) == pytest.approx(97.4, abs=1e-12)
    assert np.degrees(np.arctan2(node[1], node[0])) == pytest.approx(40.0, abs=1e-12)
    along = np.arctan2(position[0] @ np.cross(normal, node), position[0] @ node)
    assert np.degrees(along) == pytest.approx(10.0, abs=1e-12)


def test_the_orbit_closes_after_keplers_period() -> None:
    period_ns = round(2e9 * np.pi * np.sqrt(ORBIT.radius ** 3 / GM_EARTH))
    start, end = ORBIT.geocentric_state([T0, T0 + period_ns])[0]
    # Half a nanosecond of rounding at 7.6 km/s is 4 um; cos and sin round at 1e-9 m.
    assert np.linalg.norm(end - start) < 1e-5


def test_a_geostationary_orbit_takes_a_sidereal_day() -> None:
    observer = Observer('orbit', altitude_km=42164.17 - 6378.1366)
    # 86164.09 s; the radius of 42164.17 km is known here to 5 m, the period so to 0.016 s.
    assert 2.0 * np.pi / observer.mean_motion == pytest.approx(86164.09, abs=0.02)


def test_velocity_is_the_derivative_of_position() -> None:
    h_ns = 10**8
    position, velocity = ORBIT.geocentric_state(T0 + h_ns * np.array([-1, 0, 1]))
    # Central difference: v (n h)^2 / 6 = 1.6e-5 m/s.
    assert np.allclose((position[2] - position[0]) / (2e-9 * h_ns), velocity[1], atol=2e-5)


def test_the_orbit_does_not_stop_in_a_leap_second() -> None:
    observer = Observer('orbit', epoch_utc='2016-12-31T23:59:59')
    new_year = np.datetime64('2017-01-01T00:00:00', 'ns').astype(np.int64)
    start, end = observer.geocentric_state([new_year - 10**9, new_year])[0]
    assert angle(start / observer.radius, end / observer.radius) == pytest.approx(
        2.0 * observer.mean_motion, rel=1e-9)


# Use

@pytest.mark.parametrize('observer', OBSERVERS, ids=lambda observer: observer.velocity)
def test_frames_together_and_one_by_one_give_the_same_bits(observer: Observer) -> None:
    stars = load()
    counts = np.array([3, 0, 25, 1, 7])
    stamps = T0 + 500_000_000 * np.arange(5)
    rows = np.random.default_rng(3).integers(0, len(stars), counts.sum())
    together = apparent_places(stars, rows, stamps, counts, observer)
    ends = np.cumsum(counts)
    one_by_one = [apparent_places(stars, rows[end - count:end], [stamp], [count], observer)
                  for stamp, count, end in zip(stamps, counts, ends)]
    assert np.array_equal(together, np.concatenate(one_by_one))
    assert np.abs(np.linalg.norm(together, axis=1) - 1.0).max() < 1e-15


@pytest.mark.parametrize('observer', OBSERVERS, ids=lambda observer: observer.velocity)
def test_no_frames_give_no_places(observer: Observer) -> None:
    nothing = apparent_places(load(), np.empty(0, np.int64), np.empty(0, np.int64),
                              np.empty(0, np.int64), observer)
    assert nothing.shape == (0, 3)


def test_a_star_without_a_row_is_refused() -> None:
    with pytest.raises(ValueError, match='1 of 2 stars are not in the catalogue'):
        apparent_places(load(), np.array([5, -1]), [T0], [2], Observer())


def test_an_unknown_observer_is_refused() -> None:
    with pytest.raises(ValueError, match="velocity 'moon': one of barycentre, geocentre, orbit"):
        Observer('moon')


def test_an_epoch_that_is_not_a_time_is_refused() -> None:
    with pytest.raises(ValueError, match='yesterday'):
        Observer(epoch_utc='yesterday')


def test_the_epoch_is_utc_unless_it_says_otherwise() -> None:
    stated = [Observer('orbit', epoch_utc=text).geocentric_state([T0])[0].tolist()
              for text in ('2026-07-01T12:00:00', '2026-07-01T12:00:00Z',
                           '2026-07-01T14:00:00+02:00')]
    assert stated[0] == stated[1] == stated[2]


def test_the_barycentre_has_no_geocentric_state() -> None:
    with pytest.raises(ValueError, match='geocentre or orbit expected'):
        Observer('barycentre').geocentric_state([T0])


def test_nothing_is_downloaded(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError('network used')
    monkeypatch.setattr(socket, 'socket', refuse)
    monkeypatch.setattr(socket, 'create_connection', refuse)
    _leap_seconds.cache_clear()
    assert np.isfinite(see(load(4.0), T0, ORBIT)).all()


def test_importing_the_sky_does_not_import_astropy() -> None:
    command = 'import sys, starcal_ros.sky.apparent; sys.exit("astropy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', command]).returncode == 0
