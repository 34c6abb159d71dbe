# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of the calibration are numbers that any viewer can plot."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.clock import Clock  # noqa: E402

from instruments import TAN2018  # noqa: E402
from starcal_ros.filter import verdict  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.filter.progress import Progress  # noqa: E402
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT  # noqa: E402
from starcal_ros.live.heard import Seen  # noqa: E402
from starcal_ros.nodes.estimator_diagnostics import Diagnostics  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SCENARIO = TAN2018.replace(
    {'simulation.duration_s': 20.0})


@pytest.fixture(scope='module')
def calibrator():
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return calibrate(gyro.next(gyro.count), tracker.next(tracker.count), SCENARIO)[0]


@pytest.fixture(scope='module')
def values(calibrator):
    node = SimpleNamespace(get_namespace=lambda: '/', get_clock=Clock)
    status = Diagnostics(node, []).message(calibrator, enabled=True).status[0]
    return {item.key: item.value for item in status.values}


def numbers(values, *names):
    return [float(values[name]) for name in names]


def test_every_value_but_units_and_advice_is_a_number(values):
    texts = {'not_told_apart', 'verdict', 'advice', *(f'unit_{name}' for name in STATE_NAMES)}
    assert texts < values.keys()
    for name in values.keys() - texts:
        float(values[name])


def test_sigmas_units_and_tolerances_are_those_of_the_states(values, calibrator):
    np.testing.assert_allclose(numbers(values, *(f'sigma_{name}' for name in STATE_NAMES)),
                               calibrator.belief.sigma / UNIT, rtol=1e-5)
    assert tuple(values[f'unit_{name}'] for name in STATE_NAMES) == STATE_UNITS
    expected = np.full(len(STATE_NAMES), np.nan)
    expected[CALIBRATED] = calibrator.filter.tolerance / UNIT[CALIBRATED]
    np.testing.assert_allclose(Seen(values=values).tolerances(), expected, rtol=1e-5)


def test_advice_and_time_to_go_are_those_of_the_verdict(values, calibrator):
    judged = verdict.of(calibrator)
    assert values['advice'] == judged.advice and values['advice'].startswith('rotate about ')
    assert values['time_to_go_s'] == 'nan'          # 20 s do not tell
    assert values['not_told_apart'] == '; '.join(each.sentence for each in judged.couplings)
    node = SimpleNamespace(get_namespace=lambda: '/', get_clock=Clock)
    sigma = calibrator.belief.sigma
    seen = Progress([(0, 1.5 * sigma), (90 * 10**9, 1.2 * sigma), (180 * 10**9, sigma)])
    status = Diagnostics(node, []).message(calibrator, True, seen).status[0]
    told = {item.key: item.value for item in status.values}
    assert float(told['time_to_go_s']) == pytest.approx(
        seen.remaining_s(calibrator.filter, sigma).max(), rel=1e-5)
    assert told['advice'] in status.message and '; as it is ' in told['advice']


def test_principal_point_and_residuals_have_a_number_for_each_axis(values, calibrator):
    judged = verdict.of(calibrator)
    for name, expected in (
            ('sigma_equivalent_principal_point_{}_px', judged.equivalent_sigma_px),
            ('reprojection_rms_{}_px', calibrator.reprojection_rms_px)):
        np.testing.assert_allclose(numbers(values, *(name.format(axis) for axis in 'uv')),
                                   expected, rtol=1e-5)
