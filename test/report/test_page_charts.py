# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the charts of the report say: residuals, coverage, whiteness, projection, change."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import DETECTOR, INTRINSICS, PITCH_MM, TAN2018
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.units import ARCSEC
from starcal_ros.filter import verdict
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import CALIBRATED, UNIT
from starcal_ros.report import coverage_charts, projection_charts, residual_charts, time_charts
from starcal_ros.report.calibration import Calibration, facts
from starcal_ros.report.page_tables import change
from starcal_ros.report.residual_charts import StarResiduals
from starcal_ros.report.states import Row, rows, short, table
from starcal_ros.results import projection, result
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog

RUN = TAN2018.replace({'simulation.duration_s': 120.0})
STARS = 20_000
LENS = Tan2018Lens(PITCH_MM)


@pytest.fixture(scope='module')
def calibration():
    """Return a calibration of two minutes, without a truth."""
    gyro, tracker = sensors.gyro(RUN), sensors.star_tracker(RUN)
    calibrator, history = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), RUN)
    outcome = result.result(calibrator, {'bag': '.', 'version': '9.8.7'})
    return Calibration(outcome, None, history, verdict.of(calibrator), RUN, [],
                       command='starcal calibrate x')


def stars(residual_of=lambda uv, hip: np.zeros_like(uv), sigma=0.1):
    """Return residuals of noise and of what depends on the place and the star."""
    rng = np.random.default_rng(7)
    uv = rng.uniform(-500.0, 500.0, (STARS, 2))
    known = catalog.load(5.0)
    hip = rng.choice(known.hip[np.isfinite(known.colour)][:200], STARS)
    residual = sigma * rng.normal(size=uv.shape) + residual_of(uv, hip)
    return StarResiduals(residual, np.full(STARS, sigma), uv, np.array([511.5, 511.5]), hip)


def worst(chart, part=0):
    """Return the largest mean of a chart, in its own standard errors."""
    trace = chart.figure.data[part]
    return np.max(np.abs(trace.y) / (0.5 * np.array(trace.error_y.array)))


def test_residuals_of_noise_depend_on_nothing():
    """Of 24 bins of each of 10 curves the worst is below 5 sigma but once in 7000 runs."""
    charts = residual_charts.against(stars(), np.linspace(0.0, 60.0, STARS))
    assert len(charts) == 10
    for chart in charts[:6]:
        for part in range(len(chart.figure.data)):
            assert worst(chart, part) < 5.0, chart.title
    for chart in charts[6:]:
        np.testing.assert_allclose(chart.figure.data[0].y, 0.1, rtol=0.15)
        np.testing.assert_allclose(chart.figure.data[-1].y, 0.1)        # the stated sigma


@pytest.mark.parametrize(('title', 'cause'), [
    ('Mean outward and across [px] over distance from the centre',
     lambda uv, hip: 4e-5 * uv * np.linalg.norm(uv, axis=-1)[:, None] / 500.0),
    ('Mean u [px] over place in the pixel',
     lambda uv, hip: 0.03 * np.sin(2.0 * np.pi * (uv + 511.5)) * [1.0, 0.0]),
    ('Mean u and v [px] over magnitude Hp',
     lambda uv, hip: 0.02 * (magnitude(hip) - 3.5)[:, None] * [1.0, 0.0]),
    ('Mean u and v [px] over colour B − V', lambda uv, hip: 0.03 * colour(hip)[:, None]),
], ids=lambda value: value.split(' over ')[1] if isinstance(value, str) else '')
def test_residuals_show_what_they_depend_on(title, cause):
    charts = {chart.title: chart for chart in residual_charts.against(stars(cause), None)}
    assert not any('time' in name for name in charts)
    assert worst(charts[title]) > 8.0


def magnitude(hip):
    known = catalog.load(5.0)
    return known.magnitude[known.rows(hip)]


def colour(hip):
    known = catalog.load(5.0)
    return known.colour[known.rows(hip)]


def test_a_displaced_star_is_named_and_others_are_not():
    clean, found, told = residual_charts.star_by_star(stars())
    assert told.startswith('0 of 200 stars') and len(found) == 8
    hip = catalog.load(5.0).hip[3]
    shifted = stars(lambda uv, hips: np.where((hips == hip)[:, None], 0.15, 0.0))
    _, found, told = residual_charts.star_by_star(shifted)
    assert told.startswith('1 of 200 stars') and found[0][0] == str(hip)
    assert float(found[0][4]) == pytest.approx(0.15, abs=0.05)
    few = stars()._replace(catalog_id=np.arange(1, STARS + 1))
    assert residual_charts.star_by_star(few)[:2] == (None, [])


def test_coverage_counts_cells_and_is_level_where_stars_are_everywhere():
    detector = Detector(1024, 768, 0.005)
    rng = np.random.default_rng(3)
    uv = rng.uniform([-0.5, -0.5], [1023.5, 767.5], (200_000, 2))
    chart, told = coverage_charts.star_counts(uv, detector)
    z = np.array(chart.figure.data[0].z)
    assert z.shape == (16, 16) and z.sum() == len(uv) and 'none' not in told
    radial = np.array(coverage_charts.radial_counts(uv, detector).figure.data[0].y)
    # 2543 stars an area of 100 x 100 px; the outermost ring is a few pixels of the corners.
    np.testing.assert_allclose(radial[:-2], 1e4 * len(uv) / (1024 * 768), rtol=0.1)
    _, told = coverage_charts.star_counts(uv[uv[:, 0] < 511.5], detector)
    assert '128 cells have none' in told


def test_turns_of_a_run_are_white_and_such_that_hang_together_are_not(calibration):
    rng = np.random.default_rng(5)
    history, n = calibration.history, 4000
    base = {'every': 1, 'turn': rng.normal(size=(n, 3))}
    chart, told = time_charts.whiteness(replace(history, **base))
    # Of 40 lags 38 are expected inside; less than 33 have a chance of 1 in 8000.
    assert int(told.split()[3]) >= 33
    coloured = base['turn'].copy()
    for k in range(1, n):
        coloured[k] = 0.5 * coloured[k - 1] + np.sqrt(0.75) * base['turn'][k]
    chart, told = time_charts.whiteness(replace(history, turn=coloured, every=2))
    bars = chart.figure.data[2]
    assert bars.x[0] == 2 and bars.y[0] == pytest.approx(0.5, abs=0.05)
    assert bars.y[1] == pytest.approx(0.25, abs=0.06)
    none = np.full((n, 3), np.nan)
    assert 'too few frames' in time_charts.whiteness(replace(history, turn=none))[1]


def test_projection_sigmas_are_those_of_drawn_cameras():
    """Scatter of 4000 cameras and mountings out of a covariance: 3 sigma are 3.4 %."""
    rng = np.random.default_rng(11)
    scale = np.array([20.0 * ARCSEC] * 3 + [0.5, 0.5, 1e-3, 1e-6, 1e-8, 1e-6, 1e-6])
    mix = np.eye(10)
    mix[4, 0], mix[3, 1] = -0.9, 0.9                    # as principal point and mounting are
    root = scale[:, None] * mix
    covariance = root @ root.T
    uv = np.array([[0.0, 0.0], [450.0, -300.0], [-500.0, 500.0]])
    drawn = rng.normal(size=(4000, 10)) @ root.T
    r_s = camera.unproject(uv, INTRINSICS, PITCH_MM)
    # The direction in the gyro axes that a pixel has, the true mounting being none.
    found = np.array([camera.unproject(uv, INTRINSICS + d[3:], PITCH_MM) @ rotation.exp(d[:3])
                      for d in drawn])
    angle = np.sqrt(0.5 * np.mean(np.sum((found - r_s)**2, axis=-1), axis=0))
    np.testing.assert_allclose(projection.sigma_direction(uv, INTRINSICS, covariance, PITCH_MM),
                               angle, rtol=0.034)


def test_projection_of_the_camera_does_not_count_a_turn():
    grid = np.stack(np.meshgrid(*(np.linspace(-511.0, 511.0, 9),) * 2), axis=-1).reshape(-1, 2)
    shift = np.zeros((7, 7))
    shift[0, 0] = 1.0                                   # a pixel of the principal point
    sigma = projection.sigma_px(grid, INTRINSICS, shift, LENS)
    assert sigma.max() < 0.1                            # all but what bends in a wide field
    focal = np.zeros((7, 7))
    focal[2, 2] = 1e-3**2
    sigma = projection.sigma_px(grid, INTRINSICS, focal, LENS)
    corner = np.hypot(511.0, 511.0) * 1e-3 / INTRINSICS[2]
    assert sigma[0] == pytest.approx(corner / np.sqrt(2.0), rel=0.05)


def test_change_map_is_of_what_a_turn_leaves():
    before = INTRINSICS.copy()
    before[:2] -= 3.0                                   # as a turn shifts all stars
    chart = projection_charts.change_map('Change', DETECTOR, before, INTRINSICS)
    assert np.max(chart.figure.data[0].z) < 0.3
    before[2] *= 1.001
    chart = projection_charts.change_map('Change', DETECTOR, before, INTRINSICS)
    assert np.max(chart.figure.data[0].z) > 0.5


def test_what_has_changed_is_counted_from_what_it_began_with(calibration):
    part = change(calibration)[0].parts[-1]
    found = {row.label: row for row in rows(calibration.outcome, None)}
    differ = calibration.change
    assert f'<th>u0</th><td>px</td><td>{short(differ[6])}</td><td>20</td>' in part
    assert differ[6] == found['u0'].estimate - RUN.camera.principal_point_px[0]
    assert differ[8] == pytest.approx(found['f'].estimate - RUN.camera.focal_length_mm)
    # A prior that is much too sure of itself is said to have been wrong.
    assert 'was not as good as it was said to be' not in str(change(calibration))
    scale = np.array([row.sigma for row in found.values()])
    sure = calibration._replace(prior=np.diag((1.1 * scale * UNIT[CALIBRATED])**2))
    said = str(change(sure))
    assert 'was not as good as it was said to be' in said and 'Farther than 3.5: ' in said


def test_facts_say_when_how_long_which_camera_and_command(calibration):
    told = dict(facts(calibration))
    assert told['Recorded'] == '2026-07-02T12:00:00 to 2026-07-02T12:01:59 UTC, 119.5 s'
    assert told['Camera'].startswith('1024 × 1024 px of 6.45 µm, f = 25.6 mm, 14.7° × 14.7°')
    assert told['Command'] == 'starcal calibrate x' and told['Page made'].endswith('9.8.7')


def test_numbers_that_round_to_nothing_have_no_sign():
    row = Row('u0', 'px', -1e-5, 1e-5, -2e-5, 0.02)
    assert row.places(-1e-5) == '0.000' and row.places(-0.5) == '-0.500'
    assert short(-0.0) == '0' and short(-99.99) == '-100' and short(-0.012) == '-0.012'


def test_only_the_instrument_of_t18_has_the_errors_of_t18(calibration):
    truth = Truth.from_scenario(RUN).as_dict()
    heads = [column.header for column in table(rows(calibration.outcome, truth), '').columns]
    assert heads[-1] == 'T18 error (2 h)'
    other = Truth.from_scenario(RUN.replace({'truth.camera.focal_length_mm': 25.7})).as_dict()
    heads = [column.header for column in table(rows(calibration.outcome, other), '').columns]
    assert heads[-1] == 'error/sigma'
