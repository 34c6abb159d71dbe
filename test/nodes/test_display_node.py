# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `display` beside a running estimator: its drawings are of what the estimator says."""

import signal

import pytest

pytest.importorskip('rclpy')

import numpy as np  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

from instruments import TAN2018  # noqa: E402
from peer import LATCHED, PATIENCE_S  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.filter.states import CALIBRATED, UNIT  # noqa: E402
from starcal_ros.live.display import LAYOUT  # noqa: E402
from starcal_ros.messages import topics  # noqa: E402
from starcal_ros.nodes.base.qos import message_type  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 40.0, 'simulation.real_time_factor': 10.0,
    'simulation.wait_for_subscribers': 1, 'simulation.wait_for_simulators': 1})


@pytest.mark.slow
def test_it_draws_each_frame_and_gives_the_numbers_of_the_estimator(start, peer, tmp_path):
    markers_type = message_type(topics.MARKERS.type_name)
    if markers_type is None:
        pytest.skip('visualization_msgs is not installed')
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    frames = tracker.next(tracker.count)
    calibrator = calibrate(gyro.next(gyro.count), frames, SCENARIO)[0]
    parameters = tmp_path / 'scenario.yaml'
    parameters.write_text(parameter_file.dump(SCENARIO))
    given = '--params-file', str(parameters)
    markers = peer.listen(markers_type, topics.MARKERS.name, LATCHED)
    values = peer.listen(Float64MultiArray, topics.VALUES.name, LATCHED)
    display = start('display')
    peer.until(lambda: peer.node.count_publishers(topics.VALUES.name) == 1)
    estimator = start('estimator', *given)
    peer.until(lambda: peer.node.count_publishers(topics.RESIDUALS.name) == 1
               and peer.node.count_subscribers(topics.RESIDUALS.name) == 1)
    simulators = [start(name, *given) for name in ('star_tracker_sim', 'gyro_sim')]

    last_ns = calibrator.stamp_ns
    sigma = calibrator.belief.sigma[CALIBRATED] / UNIT[CALIBRATED]
    single = np.finfo(np.float32).eps       # as which the sigmas of the stars travel
    begin = sum(size for _, size in LAYOUT[:-3])

    def stamp_ns(message):
        stamp = message.markers[0].header.stamp if message.markers else None
        return stamp and stamp.sec * 10**9 + stamp.nanosec
    peer.until(lambda: markers and stamp_ns(markers[-1]) == last_ns)
    peer.until(lambda: np.allclose(values[-1].data[begin:begin + 13], sigma, single, 0.0)
               and values[-1].data[1] == 1.0)       # not yet
    assert len({stamp_ns(each) for each in markers} - {None}) > len(frames) - 5
    assert [each.label for each in values[-1].layout.dim] == [label for label, _ in LAYOUT]
    assert [each.wait(PATIENCE_S) for each in simulators] == [0, 0]
    for process in (display, estimator):
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    told = display.stderr.read()
    assert 'Traceback' not in told
    if message_type(topics.ANNOTATIONS.type_name) is None:
        assert 'foxglove_msgs is not installed: no starcal/display/annotations' in told
