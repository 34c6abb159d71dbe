# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal compare`` of the parts of a recording, and of results at temperatures."""

import json

import numpy as np
import pytest

from instruments import CONFIG, TAN2018
from starcal_ros.cli import main
from starcal_ros.results import comparison
from starcal_ros.results.read import StoredResult
from starcal_ros.results.document import CalibrationError
from starcal_ros.simulation import sensors
from starcal_ros.workflows.cross_validation import calibrate_parts, hardly_seen

RUN = TAN2018.replace({'simulation.duration_s': 180.0, 'motion.dwell_s': 5.0})


@pytest.fixture(scope='module')
def sensed():
    """Return the messages of three minutes."""
    gyro, tracker = sensors.gyro(RUN), sensors.star_tracker(RUN)
    return gyro.next(gyro.count), tracker.next(tracker.count)


def test_parts_of_an_instrument_that_stays_agree_and_what_they_hardly_see_is_named(sensed):
    told = []
    parts = calibrate_parts(*sensed, RUN, 3, told.append)
    assert [each.name for each in parts] == ['part 1', 'part 2', 'part 3']
    assert told == sorted(told) and told[-1] == 1.0
    assert sorted(each.stamp_ns for each in parts) == [each.stamp_ns for each in parts]
    found = comparison.agreements(parts)
    assert comparison.differing(found) == []
    # Nothing of a minute is hardly seen here; of an initial sigma that is small, everything.
    sure = RUN.replace({'estimator.initial_sigma.focal_length_mm': 1e-5})
    assert any(' hardly sees f' in text for text in hardly_seen(parts, sure))
    assert not any(' f' in text for text in hardly_seen(parts, RUN))


def test_parts_between_which_the_camera_changed_differ(sensed):
    """Of the last third the stars are magnified by 2e-4: 5 um of focal length."""
    gyro, frames = sensed
    late = np.arange(len(frames.uv_raster)) >= frames.first[2 * len(frames) // 3]
    centre = np.array([RUN.camera.width - 1, RUN.camera.height - 1]) / 2.0
    uv = np.where(late[:, None], centre + (frames.uv_raster - centre) * (1.0 + 2e-4),
                  frames.uv_raster)
    changed = type(frames)(frames.stamp_ns, frames.first, uv, frames.sigma, frames.magnitude,
                           frames.catalog_id)
    parts = calibrate_parts(gyro, changed, RUN, 3)
    assert 'camera' in comparison.differing(comparison.agreements(parts))
    differ = {each.name: each.difference / each.sigma
              for each in comparison.states(parts[0], parts[2])}
    assert differ['f'] > 5.0


def test_too_many_parts_are_refused(sensed):
    with pytest.raises(CalibrationError, match='360 frames in 10 parts: each needs 40'):
        calibrate_parts(*sensed, RUN, 10)


def test_command_compares_the_parts_of_a_recording(tmp_path, capsys):
    bag = tmp_path / 'run.mcap'
    assert main(['simulate', '--config', str(CONFIG), '--duration', '60', '--out', str(bag)]) == 0
    capsys.readouterr()
    assert main(['compare', str(bag), '--cross-validate', '2', '--json']) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert [each['name'] for each in found['results']] == ['part 1', 'part 2'] and found['agree']
    assert found['less_the_first'][0]['over_the_detector']['rms_px'] < 0.5
    assert 'part 2 hardly sees epsilon_y' in err        # half a minute of one axis


@pytest.mark.parametrize(('words', 'said'), [
    (['a.mcap', 'b.mcap', '--cross-validate', '2'], 'takes one recording, got 2 names'),
    (['a.mcap', '--cross-validate', '1'], 'got 1, needs 2 or more'),
    (['a.json'], 'or --cross-validate N for a recording')])
def test_mistakes_are_named(words, said, capsys):
    assert main(['compare', *words]) == 2
    assert said in capsys.readouterr().err


def results(values):
    """Return cameras whose focal lengths are given."""
    sigma = np.array([0.1, 0.1, 1e-4, 1e-6, 1e-8, 1e-6, 1e-6])
    return [StoredResult(str(k), np.array([0.0, 0.0, f, 0.0, 0.0, 0.0, 0.0]), np.diag(sigma**2),
                         None, None, None, None, '', '', '') for k, f in enumerate(values)]


def test_focal_length_that_goes_with_the_temperature_has_its_slope():
    """A straight line through four points by hand: 2e-4 mm/K, sigma 1e-4 / sqrt(500)."""
    warm = np.array([-10.0, 0.0, 10.0, 20.0])
    found = {each.name: each for each in comparison.trends_over(results(25.0 + 2e-4 * warm), warm)}
    assert found['f'].slope == pytest.approx(2e-4, rel=1e-6)
    assert found['f'].sigma == pytest.approx(1e-4 / np.sqrt(500.0))
    assert found['f'].constant.probability < 1e-6 < found['f'].line.probability
    assert found['k1'].slope == 0.0
    assert comparison.trends_over(results([25.0, 25.0]), np.array([1.0, 2.0])) == []


def test_temperatures_are_one_a_result(tmp_path, capsys):
    bag = tmp_path / 'run.mcap'
    assert main(['simulate', '--config', str(CONFIG), '--duration', '60', '--out', str(bag)]) == 0
    words = ['compare', str(bag), '--cross-validate', '3', '--temperature']
    for given in ('1,2', 'cold,1,2', '1,2,nan'):
        assert main([*words, given]) == 2
        assert 'needs 3 numbers, one for each result' in capsys.readouterr().err
    assert main([*words, '5,10,20']) == 0
    assert 'With temperature' in capsys.readouterr().out
