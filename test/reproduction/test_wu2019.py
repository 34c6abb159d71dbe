# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""W19's simulation: its sky, criteria and bound; both weightings held against them."""

from functools import cache
import math

import numpy as np
import pytest

from starcal_ros.calibration import invariants
from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import consistency
from starcal_ros.measurements.samples import Stars
from starcal_ros.reproduction import published, published_cameras, wu2019
from starcal_ros.reproduction.wu2019 import DETECTOR, GROUPS, METHODS, TRUTH, PerfectFrame
from starcal_ros.reproduction.wu2019_study import HEAD, UNITS, Study, rows

SHORT = Scenario().replace({'simulation.duration_s': 50.0})        # 100 frames
RUNS = 40


@cache
def study(group='group3', runs=RUNS, sigma_px=0.5):
    return Study(SHORT, GROUPS[group], runs, sigma_px)


@cache
def result(method, weighting):
    return study().run(METHODS[method][weighting])


EACH = pytest.mark.parametrize('method', ['AD', 'SVD'])


@pytest.mark.parametrize('group', GROUPS)
def test_frames_show_as_many_stars_as_the_papers(group):
    """Of 2500 frames; the mean of 100 at random scatters by a twentieth."""
    views = sum(wu2019.sky(Scenario().replace({'simulation.duration_s': 1200.0}), GROUPS[group]),
                [])
    assert len(views) == 2500
    counts = [len(view.uv) for view in views]
    assert np.mean(counts) == pytest.approx(GROUPS[group].stars, rel=0.03)


def test_stars_are_on_the_detector_where_the_true_camera_sees_them():
    for view in wu2019.sky(SHORT, GROUPS['group2']).judge:
        assert DETECTOR.contains(view.uv - DETECTOR.centre_raster).all()
        w = published_cameras.unproject_w19(view.uv, TRUTH, DETECTOR.pitch_mm)
        np.testing.assert_allclose(w @ w.T, view.u_i @ view.u_i.T, atol=1e-12)


def test_criteria_of_the_truth_are_nothing_and_the_noise():
    """A pair has the noise of both of its stars: sqrt(2) sigma on the sphere."""
    case = study()
    A = case.criterion_A(TRUTH[None])
    assert A.shape == (1, 100) and A.max() < 1e-6
    # Off the axis a pixel is less: cos^2 along the radius, cos across it.
    pixel_arcsec = math.degrees(DETECTOR.pitch_mm / TRUTH[1]) * 3600.0
    assert case.bound()['B'] == pytest.approx(math.sqrt(2.0) * 0.5 * pixel_arcsec, rel=0.03)
    assert case.bound()['B'] == pytest.approx(26.4, rel=0.03)


def test_criterion_B_of_the_paper_fits_0_2_px():
    assert study('group2', 4, 0.2).bound()['B'] == pytest.approx(10.6, rel=0.03)   # W19 Table 4


def test_bound_is_the_inverse_of_what_all_frames_tell():
    views = study().sky.calibrate
    information = np.diag(wu2019.START_SIGMA**-2.0)
    for view in views:
        if len(view.uv) >= 3:
            frame = invariants.linearize(
                Stars(view.u_i, view.uv, np.full(len(view.uv), 0.5)), TRUTH, wu2019.LENS)
            information += frame.H.T @ frame.H
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    # Stars are turned to their places to 1e-5 or better, and the slopes follow.
    np.testing.assert_allclose(np.sqrt(np.diag(wu2019.cramer_rao(views, 0.5))) / sigma, 1.0,
                               atol=1e-4)


@EACH
def test_full_weighting_reaches_the_bound_and_knows_it(method):
    end = result(method, 'full')
    assert float(end.nees.mean()) in consistency.mean_interval(6, RUNS, 0.999)
    ratio = np.sqrt(np.mean(end.error**2, axis=0) / np.diag(study().covariance))
    interval = consistency.rms_interval(RUNS, 1.0 - 0.001 / 6)
    # SVD lacks one of the 2 n - 3 numbers of a frame, and the second order: 5 % of 8 stars.
    assert (ratio < (1.05 if method == 'SVD' else 1.0) * interval.high).all()


@EACH
def test_published_weighting_does_not_know_its_error(method):
    end = result(method, 'diagonal')
    assert end.nees.mean() > 2.0 * consistency.mean_interval(6, RUNS, 0.999).high
    assert end.A.mean() > result(method, 'full').A.mean()


@pytest.mark.parametrize('model, chosen', [(1, (1, 2, 3)), (4, (2, 3)), (4, (1,))])
def test_observability_is_that_of_differences(model, chosen):
    view = next(view for view in study('group2', 4, 0.2).sky.judge if len(view.uv) >= 12)

    def values(parameters):
        w = published_cameras.unproject_w19(view.uv, parameters, DETECTOR.pitch_mm)
        groups = [w[k:k + 3] if model == 1 else w[:k + 3] for k in range(len(w) - 2)]
        return np.array([np.linalg.svd(group, compute_uv=False)[np.array(chosen) - 1]
                         for group in groups]).ravel()

    H = np.stack([(values(TRUTH + step) - values(TRUTH - step)) / 2.0
                  for step in np.diag(wu2019.PRECISION)], axis=-1)
    # Differences round at 1e-15 of values of order 1, and the least column is 1e-8.
    assert wu2019.least_observable(view, model, chosen) == pytest.approx(
        np.linalg.svd(H, compute_uv=False)[-1], rel=1e-4)


def test_fewer_residuals_than_parameters_observe_nothing():
    view = study('group2', 4, 0.2).sky.judge[0]
    assert wu2019.least_observable(PerfectFrame(view.u_i[:4], view.uv[:4]), 4, (2, 3)) == 0.0


def test_rows_put_the_numbers_side_by_side():
    quantities = result('AD', 'full').quantities()
    assert set(quantities) | {'time'} == set(UNITS)
    row, = rows('case', ('A',), {'A': 0.5}, {'A': 2.0}, {'A': 1.0}, {'A': 0.8})
    assert dict(zip(HEAD, row)) == {'case': 'case', 'quantity': 'A', 'unit': '"', 'paper': 0.5,
                                    'published': 2.0, 'full': 1.0, 'bound': 0.8, 'ratio': 1.25}
    time, = rows('case', ('time',), {}, {}, {'time': 0.3}, {})
    assert time == ('case', 'time', 'ms', '', '', 0.3, '', '')


def test_table_4_has_the_values_that_others_rely_on(tmp_path):
    table = published.load('w19-table4').reproduce(
        SHORT.replace({'simulation.duration_s': 2.0}), 1, tmp_path, lambda part: None).as_dict()
    for level in (table, table['at_0.2_px']):
        for group in GROUPS:
            for method in METHODS:
                values = level[group][method]
                assert {'A_mean_arcsec', 'A_std_arcsec', 'B_mean_arcsec', 'B_std_arcsec',
                        'ms_per_frame'} <= set(values)
                assert all(np.isfinite(value) and value >= 0.0 for value in values.values())
    assert table['sigma_px'] == 0.5
