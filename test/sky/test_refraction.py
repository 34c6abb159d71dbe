# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Refraction against astropy and the formulas of textbooks, and its standard atmosphere."""

from astropy.coordinates import GCRS, ICRS, AltAz, EarthLocation, SkyCoord
from astropy.time import Time
import astropy.units as u
from astropy.utils import iers
import numpy as np
import pytest

from starcal_ros.core.utc import unix_ns
from starcal_ros.sky.refraction import Site, altitude, refracted, refraction

ARCSEC = np.pi / 180.0 / 3600.0
TIME = '2024-03-05T22:10:00'
SITE = Site(47.0, 8.5, 500.0, 950.0, 5.0)
ALTITUDES = np.array([10.0, 15.0, 20.0, 30.0, 60.0, 85.0])
STAMPS = np.full(len(ALTITUDES), unix_ns(TIME))


@pytest.fixture(scope='module')
def seen():
    """Return directions without air, in i, and their altitudes through it, by astropy [deg]."""
    with iers.conf.set_temp('auto_download', False):
        where = {'obstime': Time(TIME), 'location': EarthLocation.from_geodetic(
            8.5 * u.deg, 47.0 * u.deg, 500.0 * u.m)}
        stars = SkyCoord(az=[0, 40, 100, 200, 300, 20] * u.deg, alt=ALTITUDES * u.deg,
                         frame=AltAz(**where)).transform_to(ICRS())
        through = stars.transform_to(AltAz(
            **where, pressure=950.0 * u.hPa, temperature=5.0 * u.deg_C, relative_humidity=0.5,
            obswl=0.55 * u.um))
        apparent = stars.transform_to(GCRS(obstime=Time(TIME)))
        return np.stack(apparent.cartesian.xyz.value, axis=-1), through.alt.deg


def test_altitudes_are_those_of_astropy(seen):
    """But for UT1 - UTC, polar motion and diurnal aberration: 0.3" on that day."""
    assert np.abs(np.degrees(altitude(seen[0], STAMPS, SITE)) - ALTITUDES).max() < 1.0 / 3600.0


def test_stars_are_raised_as_astropy_does_it(seen):
    u_i, through = seen
    found = refracted(u_i, STAMPS, SITE)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-14)
    raised = np.radians(through - ALTITUDES)
    np.testing.assert_allclose(refraction(np.radians(90.0 - ALTITUDES), SITE), raised,
                               atol=0.02 * ARCSEC)
    np.testing.assert_allclose(altitude(found, STAMPS, SITE) - altitude(u_i, STAMPS, SITE),
                               raised, atol=0.02 * ARCSEC)


@pytest.mark.parametrize('altitude_deg', [10.0, 30.0, 60.0])
def test_refraction_is_that_of_the_textbook(altitude_deg):
    """Saemundsson's formula (Sky and Telescope 72, 1986), for 1010 hPa and 10 deg C.

    It is rounded for the eye: at great altitudes 1.02' where the air has 0.98'.
    """
    expected = 1.02 / np.tan(np.radians(altitude_deg + 10.3 / (altitude_deg + 5.11)))
    found = refraction(np.radians([90.0 - altitude_deg]), Site(0.0, 0.0, 0.0, 1010.0, 10.0))[0]
    assert found / ARCSEC / 60.0 == pytest.approx(expected, rel=0.05)


def test_nothing_happens_at_the_zenith_nor_without_air():
    assert refraction(np.array([0.0]), SITE)[0] == 0.0
    u_i = np.eye(3)
    np.testing.assert_allclose(refracted(u_i, STAMPS[:3], Site(47.0, 8.5, 0.0, 0.0)), u_i,
                               atol=1e-15)


def test_below_the_horizon_it_stays_finite():
    low = refraction(np.radians([85.0, 90.0, 120.0, 180.0]), SITE)
    np.testing.assert_allclose(low, low[0])


@pytest.mark.parametrize('height_m, pressure, temperature', [
    (0.0, 1013.25, 15.0), (500.0, 954.61, 11.75), (5000.0, 540.2, -17.5),
    (11000.0, 226.32, -56.5), (20000.0, 54.75, -56.5)])
def test_air_is_the_standard_atmosphere(height_m, pressure, temperature):
    found = Site(0.0, 0.0, height_m).air
    assert found == pytest.approx((pressure, temperature), rel=1e-3)
    assert Site(0.0, 0.0, height_m, 900.0, 1.0).air == (900.0, 1.0)


@pytest.mark.parametrize('numbers, culprit', [
    ((91.0, 0.0), 'latitude of the site: got 91 deg'),
    ((0.0, np.nan), 'longitude of the site: got nan'),
    ((0.0, 0.0, 6e4), 'height of the site: got 60000 m'),
    ((0.0, 0.0, 0.0, 101325.0), 'pressure of the site: got 101325 hPa'),
    ((0.0, 0.0, 0.0, 1000.0, 288.0), 'temperature of the site: got 288 deg C'),
])
def test_an_impossible_site_is_refused(numbers, culprit):
    with pytest.raises(ValueError, match=culprit):
        Site(*numbers)
