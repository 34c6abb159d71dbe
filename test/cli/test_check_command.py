# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal check``: what a recording denies, what is proposed, and that it calibrates with it."""

import json

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.simulation import sensors
from starcal_ros.simulation.write_recording import simulate

SCENARIO = TAN2018.replace({'simulation.duration_s': 150.0, 'motion.dwell_s': 2.0,
                            'motion.rate_deg_s': 1.5})


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a recording of the scenario."""
    path = tmp_path_factory.mktemp('check') / 'run.mcap'
    simulate(SCENARIO, path)
    return path


@pytest.fixture
def starcal(capsys):
    """Return a function that runs the command and returns status and standard output."""
    def run(*words):
        try:
            status = main([str(word) for word in words])
        except SystemExit as end:
            status = end.code or 0
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return status, out, err
    return run


def inverse(folder):
    """Write a configuration whose mounting goes from the star tracker to the gyros."""
    x, y, z, w = SCENARIO.mounting.quaternion_xyzw
    path = folder / 'inverse.yaml'
    path.write_text(parameter_file.dump(SCENARIO.replace(
        {'mounting.quaternion_xyzw': (-x, -y, -z, w)})))
    return path


def test_a_right_recording_gives_status_0(starcal, bag):
    status, out, _ = starcal('check', bag)
    assert (status, out.strip()) == (0, 'Nothing found')
    status, out, _ = starcal('check', bag, '--json')
    assert status == 0 and json.loads(out)['findings'] == []


def test_a_wrong_mounting_is_found_and_its_proposal_calibrates(starcal, bag, tmp_path):
    wrong, fixed = inverse(tmp_path), tmp_path / 'fixed.yaml'
    status, out, _ = starcal('check', bag, '--config', wrong, '--write', fixed)
    assert status == 4 and out.startswith('mounting: the mounting is off by 60.1 deg about y')
    assert 'inverse' in out
    verdicts = []
    for config, name in ((wrong, 'wrong.json'), (fixed, 'right.json')):
        starcal('calibrate', bag, '--config', config, '--out', tmp_path / name)
        verdicts.append(json.loads((tmp_path / name).read_text())['verdict'])
    assert verdicts[0] in ('lost', 'inconsistent') and verdicts[1] == 'not yet'
    status, out, _ = starcal('check', bag, '--config', fixed)
    assert status == 0


def test_rates_in_degrees_and_frames_that_are_late_are_told_as_json(starcal, tmp_path):
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    path, config = tmp_path / 'spoilt.mcap', tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO))
    with Writer(path) as writer:
        writer.write_batches(imu_batch('/imu/data_raw', type(samples)(
            samples.stamp_ns - 20_000_000, np.degrees(samples.rate))),
            centroids_batch('/star_tracker/centroids', frames))
    status, out, _ = starcal('check', path, '--config', config, '--json')
    unit, late = json.loads(out)['findings']
    assert status == 4 and unit['kind'] == 'unit of the rates'
    assert abs(unit['driver']['rates_times'] - np.pi / 180.0) < 1e-9
    assert late['kind'] == 'time offset' and abs(late['value'][0] + 20.0) < 5.0 * late['sigma'][0]
    assert late['gain'] > 100.0 and late['rival']


def test_wrong_input_is_refused(starcal, bag, tmp_path):
    assert starcal('check', tmp_path / 'none.mcap')[0] == 2
    assert starcal('check', bag, '--config', tmp_path / 'none.yaml')[0] == 2
    status, _, err = starcal('check', bag, '--write', bag)
    assert status == 2 and str(bag) in err


def test_calibrate_warns_of_the_same_and_can_be_told_not_to(starcal, bag, tmp_path):
    wrong, out = inverse(tmp_path), tmp_path / 'result.json'
    words = ('calibrate', bag, '--config', wrong, '--out', out, '--overwrite')
    assert 'warning: mounting: the mounting is off by 60.1 deg' in starcal(*words)[2]
    assert 'the mounting is off' not in starcal(*words, '--no-check')[2]


def test_info_tells_of_stamps_that_are_odd(starcal, bag, tmp_path):
    assert 'stamps:' not in starcal('info', bag)[1]
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    samples, frames = gyro.next(2000), tracker.next(40)
    path = tmp_path / 'zone.mcap'
    with Writer(path) as writer:
        writer.write_batches(imu_batch('/imu/data_raw', type(samples)(
            samples.stamp_ns + 3600 * 10**9, samples.rate)),
            centroids_batch('/star_tracker/centroids', frames))
    assert 'stamps: gyro from' in starcal('info', path)[1]
