# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes that are all asked to end in the same moment, as by Ctrl-C, lose nothing."""

import re
import signal

import numpy as np
import pytest

pytest.importorskip('rclpy')

from instruments import TAN2018  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.recording import reader  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.workflows import live_run  # noqa: E402

SCENARIO = TAN2018.replace({
    'estimator.wait_for_subscribers': 1, 'simulation.wait_for_subscribers': 2,
    'simulation.wait_for_simulators': 1})
NAMES = ('recorder', 'estimator', 'star_tracker_sim', 'gyro_sim')


@pytest.mark.parametrize('factor, duration_s, percent, names', [
    (0.0, 6000.0, 4, NAMES), *(pytest.param(*rest, marks=pytest.mark.slow) for rest in (
        (0.0, 6000.0, 4, ('composed',)), (10.0, 300.0, 10, NAMES), (1.0, 60.0, 5, NAMES)))],
    ids=['as_fast_as_they_go', 'one_process', 'ten_times', 'real_time'])
def test_what_is_recorded_is_what_was_estimated_though_all_are_interrupted_at_once(
        start, tmp_path, factor, duration_s, percent, names):
    """Who should end last is asked first."""
    config, recording = tmp_path / 'config.yaml', tmp_path / 'run.mcap'
    scenario = SCENARIO.replace({
        'simulation.real_time_factor': factor, 'simulation.duration_s': duration_s,
        'recorder.output': str(recording)})
    config.write_text(parameter_file.dump(scenario))
    processes = [start(name, '--params-file', str(config),
                       names=NAMES if name == 'composed' else ()) for name in names]
    for line in processes[-1].stderr:
        if (reached := re.search(r' (\d+) %$', line.rstrip())) and int(reached[1]) >= percent:
            break
    for process in processes:
        process.send_signal(signal.SIGINT)
    said = [process.communicate(timeout=PATIENCE_S)[1] for process in processes]
    assert [process.returncode for process in processes] == [0] * len(processes), said

    counts = {topic.topic: topic.count for topic in reader.summary(recording).topics}
    read = reader.read(recording)
    n = len(read.gyro)
    assert 0.5 * percent * duration_s < n < 100.0 * duration_s and not read.warnings
    np.testing.assert_array_equal(read.gyro.rate, sensors.gyro(scenario).next(n).rate)
    calibrator, _ = calibrate(read.gyro, read.frames, scenario)
    assert counts['/starcal/imu'] == counts['/imu/data_raw'] == n
    assert counts['/starcal/state'] == calibrator.counts.frames > 0
    assert live_run.compare(recording, calibrator) == 0.0
    assert not any(' lost' in text or 'ERROR' in text for text in said)


def test_a_sensor_that_goes_on_is_not_waited_for(start, tmp_path):
    """It is not asked to end: those that are hear it for a second, and leave it."""
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO.replace({
        'simulation.real_time_factor': 1.0, 'simulation.wait_for_simulators': 0,
        'simulation.duration_s': 200.0,
        'recorder.output': str(tmp_path / 'run.mcap')})))
    recorder, estimator, sensor = (start(name, '--params-file', str(config))
                                   for name in ('recorder', 'estimator', 'gyro_sim'))
    assert any(line.rstrip().endswith(' 1 %') for line in sensor.stderr)
    for process in (recorder, estimator):
        process.send_signal(signal.SIGINT)
    for process in (recorder, estimator):
        assert process.wait(PATIENCE_S) == 0
    assert sensor.poll() is None
