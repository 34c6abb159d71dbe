# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether stars trail is told from the data, where it is not as stated."""

import pytest

from instruments import TAN2018, calibrated, failed

RUN = {'simulation.duration_s': 150.0, 'star_tracker.smear': True}
DENIED = 'star_tracker.smear is taken for false'


def said(calibrator):
    return [text for text in calibrator.take_notices() if DENIED in text]


@pytest.mark.parametrize('seed', range(3))
def test_stars_that_do_not_trail_contradict_nothing(seed):
    calibrator = calibrated(TAN2018.replace({
        **RUN, 'truth.star_tracker.smear': False, 'simulation.seed': seed}))
    assert len(said(calibrator)) == 1 and failed(calibrator) == set()
    assert not calibrator.filter.model.trails


@pytest.mark.parametrize('seed', range(3))
def test_stars_that_trail_are_believed_to(seed):
    calibrator = calibrated(TAN2018.replace({**RUN, 'simulation.seed': seed}))
    assert said(calibrator) == [] and failed(calibrator) == set()
    assert calibrator.filter.model.trails


def test_what_is_stated_false_stays_and_a_trail_is_then_noticed():
    calibrator = calibrated(TAN2018.replace({
        **RUN, 'truth.star_tracker.smear': True, 'star_tracker.smear': False}))
    assert said(calibrator) == [] and failed(calibrator)
    assert not calibrator.filter.model.trails
