# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorder and player: what one wrote, the other publishes again, nothing lost and in order."""

import math
import signal
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout  # noqa: E402

from peer import PATIENCE_S  # noqa: E402
from starcal_ros.measurements.samples import Frames, GyroSamples  # noqa: E402
from starcal_ros.messages import topics  # noqa: E402
from starcal_ros.messages.cdr_imu import encode_imu  # noqa: E402
from starcal_ros.messages.cdr_results import encode_transforms  # noqa: E402
from starcal_ros.messages.conventions import STATE_LAYOUT  # noqa: E402
from starcal_ros.nodes.base.stamps import stamp_reader  # noqa: E402
from starcal_ros.nodes.recorder import Recorder  # noqa: E402
from starcal_ros.nodes.recorder_channel import Channel, RunTime  # noqa: E402
from starcal_ros.recording import reader  # noqa: E402
from starcal_ros.recording.bag import open_bag  # noqa: E402
from starcal_ros.recording.qos import LATCHED  # noqa: E402
from starcal_ros.recording.writer import Writer, serialize, typestore  # noqa: E402

START_NS, N_GYRO, N_FRAMES = 1_782_993_600_000_000_000, 3000, 60
EMPTY_ARRAY = b'\0\1\0\0' + bytes(12)       # a Float64MultiArray in CDR


def node(name: str, **parameters: object) -> subprocess.Popen:
    """Start a node with parameters of the group of its own name; it is killed after 30 s."""
    words = [f'{name}.{key}:={value}' for key, value in parameters.items()]
    process = subprocess.Popen(
        [sys.executable, '-m', 'starcal_ros.nodes.programs', name, '--ros-args',
         *(word for pair in words for word in ('-p', pair))], stderr=subprocess.PIPE, text=True)
    timer = threading.Timer(30.0, process.kill)
    timer.daemon = True
    timer.start()
    return process


def ready(recorder: subprocess.Popen) -> subprocess.Popen:
    """Return a recorder when it has subscribed."""
    assert any('recording to' in line for line in recorder.stderr)
    return recorder


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a recording of 30 s with sensors, truth, an old result and another topic."""
    path = tmp_path_factory.mktemp('bag') / 'original.mcap'
    gyro = GyroSamples(START_NS + 10_000_000 * np.arange(1, N_GYRO + 1),
                       np.arange(3.0 * N_GYRO).reshape(-1, 3))
    frames = Frames(START_NS + 500_000_000 * np.arange(N_FRAMES),
                    np.arange(0, 5 * N_FRAMES + 1, 5), np.ones((5 * N_FRAMES, 2)),
                    np.ones(5 * N_FRAMES), np.ones(5 * N_FRAMES), np.arange(5 * N_FRAMES))
    with Writer(path) as writer:
        writer.write('/truth/parameters', 'std_msgs/msg/Float64MultiArray',
                     EMPTY_ARRAY, START_NS, qos=LATCHED)
        writer.write('/other', 'std_msgs/msg/Float64MultiArray', EMPTY_ARRAY, START_NS)
        writer.write_imu('/imu/data_raw', gyro)
        writer.write_imu('/starcal/imu', gyro)
        writer.write_centroids('/star_tracker/centroids', frames)
    return path


@pytest.fixture(scope='module')
def copy(bag, tmp_path_factory):
    """Return what the recorder wrote while the player played at full speed."""
    path = tmp_path_factory.mktemp('bag') / 'copy.mcap'
    recorder = ready(node('recorder', output=path))
    player = node('player', bag=bag, rate=0.0, wait_for_subscribers=1)
    assert player.wait(30) == 0, player.stderr.read()
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(10) == 0, recorder.stderr.read()
    return path


def test_copy_equals_the_original(bag, copy):
    before, after = reader.read(bag), reader.read(copy)
    assert not after.warnings
    for name in ('stamp_ns', 'rate'):
        np.testing.assert_array_equal(getattr(after.gyro, name), getattr(before.gyro, name))
    for name in ('stamp_ns', 'first', 'uv_raster', 'catalog_id'):
        np.testing.assert_array_equal(getattr(after.frames, name), getattr(before.frames, name))


def test_copy_has_the_time_base_of_the_stamps(copy):
    topics = {topic.topic: topic for topic in reader.summary(copy).topics}
    assert topics['/imu/data_raw'].rate_hz == pytest.approx(100.0)
    assert topics['/imu/data_raw'].last_ns == START_NS + 10_000_000 * N_GYRO


def test_copy_has_truth_qos_and_configuration_but_no_old_result(copy):
    summary = reader.summary(copy)
    topics = {topic.topic: topic for topic in summary.topics}
    assert {*topics} == {'/imu/data_raw', '/star_tracker/centroids', '/truth/parameters'}
    assert topics['/truth/parameters'].qos.startswith('reliable, transient_local')
    assert topics['/imu/data_raw'].qos.startswith('reliable, volatile')
    assert {*summary.attachments} == {'config.yaml'}


def test_recorder_records_chosen_topics_of_any_type(bag, tmp_path):
    path, topics = tmp_path / 'chosen.mcap', "['/starcal/imu', 'other']"
    recorder = ready(node('recorder', output=path, topics=topics))
    player = node('player', bag=bag, rate=0.0, topics=topics, wait_for_subscribers=1)
    assert player.wait(30) == 0, player.stderr.read()
    recorder.send_signal(signal.SIGTERM)
    assert recorder.wait(10) == 0, recorder.stderr.read()
    counts = {topic.topic: topic.count for topic in reader.summary(path).topics}
    assert counts == {'/starcal/imu': N_GYRO, '/other': 1}


def test_one_wrong_stamp_does_not_spoil_the_log_times_and_a_new_time_is_taken(tmp_path):
    """Handed to the node's own method, message by message; it takes what rclpy's Node takes."""
    path, second = tmp_path / 'run.mcap', 10**9
    stamps = START_NS + second * np.array([0, 1, 10**8, 2, 3, 10**8, 10**8 + 1, 10**8 + 2])
    rclpy.init()
    recorder = Recorder(namespace='here', parameter_overrides=[
        Parameter('recorder.output', value=str(path)),
        Parameter('recorder.topics', value=['imu/data_raw'])])
    recorder._subscribe(topics.IMU._replace(name='/here/imu/data_raw'))
    for message in encode_imu(GyroSamples(stamps, np.zeros((8, 3)))):
        recorder._take(recorder._channels['/here/imu/data_raw'], [message.tobytes()])
    recorder.close()
    recorder.destroy_node()
    rclpy.shutdown()
    log_times = open_bag(path).log_times('/here/imu/data_raw')
    assert ((log_times - START_NS) // second).tolist() == [0, 1, 1, 2, 3, 3, 10**8 + 1, 10**8 + 2]


def log_times_s(channel, stamps_s):
    """Return the log times that stamps get, both in seconds after the start."""
    before = len(channel.log_times_ns)
    channel.take([struct.pack('<q', START_NS + round(1e9 * stamp)) for stamp in stamps_s], None)
    return [(time_ns - START_NS) / 1e9 for time_ns in channel.log_times_ns[before:]]


def channels(*names):
    """Return channels of one recording whose messages are their stamps."""
    run = RunTime()
    return [Channel(name, 'a/msg/B', False, lambda message: struct.unpack('<q', message)[0],
                    name == 'diagnostics', '', run) for name in names]


def test_log_times_go_on_where_the_clocks_are_set_back():
    """As by a replay in a loop: a lap in one instant could not be replayed, by any tool."""
    gyro, frames, status = channels('gyro', 'frames', 'diagnostics')
    assert log_times_s(gyro, [1, 2, 3, 4, 60]) == [1, 2, 3, 4, 60]
    assert log_times_s(frames, [2, 4, 59]) == [2, 4, 59]
    assert log_times_s(gyro, [1, 2, 3, 4, 60]) == [60, 60, 61, 62, 118]
    assert log_times_s(frames, [2, 4, 59]) == [60, 62, 117]
    assert [(status._near(START_NS + t * 10**9, START_NS + 118 * 10**9) - START_NS) // 10**9
            for t in (60, 118, 10**8)] == [118, 118, 118]
    assert log_times_s(frames, [2, 4, 6]) == [117, 117, 119]
    assert log_times_s(gyro, [1, 2, 5]) == [118, 118, 121]
    late, = channels('late')
    late.run = gyro.run                     # subscribed to by now
    assert log_times_s(late, [7]) == [123]


def test_stamps_that_are_late_or_wrong_for_once_move_no_log_time():
    gyro, = channels('gyro')
    assert log_times_s(gyro, [10, 11, 10.5, 12, 3, 13, 11.5, 14]) == [
        10, 11, 11, 12, 12, 13, 13, 14]
    assert gyro.run.offset_ns == 0
    # Two publishers by clocks of which one is behind, in turn and not: time does not run away.
    assert log_times_s(gyro, [15, 5, 5.5, 16, 6, 6.5, 17]) == [15, 15, 15, 16, 16, 16, 17]


@pytest.mark.parametrize('size', [2, 7, 100])
def test_messages_that_come_together_get_the_log_times_of_single_ones(size):
    rng = np.random.default_rng(size)
    stamps = np.cumsum(rng.choice([0.5, 0.5, 0.5, 0.5, 0.0, -0.5, -3.0, 5000.0], 400)) + 10000.0
    singly, together = channels('singly')[0], channels('together')[0]
    expected = [each for stamp in stamps for each in log_times_s(singly, [stamp])]
    assert [each for low in range(0, 400, size)
            for each in log_times_s(together, stamps[low:low + size])] == expected
    assert together.own_stamps_ns == singly.own_stamps_ns
    assert (together.newest_ns, together.is_odd) == (singly.newest_ns, singly.is_odd)


def test_log_time_is_the_stamp_inside_and_that_of_the_run_for_another_clock(
        start, peer, tmp_path):
    """All is published before the recorder is awake again, so it comes in batches, by topic.

    A process that is stopped may have to be sent a message again: acknowledged, it is there.
    """
    path, second = tmp_path / 'run.mcap', 10**9
    recorder = start('recorder', '-p', f'recorder.output:={path}')
    state = peer.node.create_publisher(Float64MultiArray, 'starcal/state', 100)
    camera = peer.node.create_publisher(CameraInfo, 'starcal/camera_info', 100)
    status = peer.node.create_publisher(DiagnosticArray, 'diagnostics', 100)
    peer.until(lambda: min(each.get_subscription_count() for each in (state, camera)) == 1
               and status.get_subscription_count() == 2)
    recorder.send_signal(signal.SIGSTOP)
    stamps = [START_NS + k * second for k in range(20)]
    for stamp in stamps:
        layout = MultiArrayLayout(dim=[MultiArrayDimension(label=STATE_LAYOUT[0][0], size=1)])
        state.publish(Float64MultiArray(layout=layout, data=[stamp * 1e-9]))
        for publisher, message, shift in (
                (camera, CameraInfo(), 0), (status, DiagnosticArray(), 1),
                (status, DiagnosticArray(), 10**8)):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(
                stamp + shift * second, second)
            publisher.publish(message)
    recorder.send_signal(signal.SIGCONT)
    assert all(publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))
               for publisher in (state, camera, status))
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(PATIENCE_S) == 0
    log_times = {name: sorted(open_bag(path).log_times(name).tolist())
                 for name in ('/starcal/state', '/starcal/camera_info', '/diagnostics')}
    assert log_times['/starcal/state'] == log_times['/starcal/camera_info'] == stamps
    assert set(log_times['/diagnostics']) <= {*stamps, stamps[-1] + second}
    assert {stamp + second for stamp in stamps} <= set(log_times['/diagnostics'])


class Transforms:
    """Stands for tf2_msgs/TFMessage, which is not among the packages of the tests."""

    @staticmethod
    def get_fields_and_field_types():
        return {'transforms': 'sequence<geometry_msgs/TransformStamped>'}


def test_stamp_of_transforms_is_that_of_the_first():
    named = typestore().types['tf2_msgs/msg/TFMessage']
    of_transforms = stamp_reader(Transforms)
    assert of_transforms(encode_transforms(START_NS + 7, np.eye(3))) == START_NS + 7
    assert of_transforms(serialize('tf2_msgs/msg/TFMessage', named([]))) is None


@pytest.mark.parametrize('stamp_s, stamp_ns', [
    (1.5, 1_500_000_000), (math.nan, None), (math.inf, None), (-1.0, None), (1e300, None)])
def test_stamp_of_an_array_is_one_only_where_it_is_a_time(stamp_s, stamp_ns):
    array = Float64MultiArray(data=[stamp_s, 1.0])
    array.layout.dim = [MultiArrayDimension(label='stamp_s', size=1, stride=1)]
    assert stamp_reader(Float64MultiArray)(serialize_message(array)) == stamp_ns


def test_only_topics_that_somebody_publishes_are_in_the_graph(start, peer, tmp_path):
    recorder = start('recorder', '-p', f'recorder.output:={tmp_path}/run.mcap')
    assert any('recording to' in line for line in recorder.stderr)
    truth = peer.node.create_publisher(Float64MultiArray, 'truth/parameters', 10)
    peer.until(truth.get_subscription_count)
    own = {'/star_tracker/centroids', '/imu/data_raw'}
    for name, _ in peer.node.get_topic_names_and_types():
        assert peer.node.count_publishers(name) or peer.node.count_subscribers(name) == (
            name in ('/starcal/state', '/diagnostics')), name       # the peer itself listens
        own.discard(name)
    assert not own


def test_recorder_refuses_to_overwrite(bag):
    recorder = node('recorder', output=bag)
    assert recorder.wait(20) == 2
    assert f'{bag} exists' in recorder.stderr.read()


@pytest.mark.parametrize('parameters, text', [
    ({}, 'player.bag: not given'),
    ({'bag': 'none.mcap'}, 'none.mcap does not exist'),
])
def test_player_names_what_is_wrong_with_the_bag(parameters, text):
    player = node('player', **parameters)
    assert player.wait(20) == 2
    assert text in player.stderr.read()


def test_player_names_a_topic_that_the_bag_has_not(bag):
    player = node('player', bag=bag, topics="['imu/other']")
    assert player.wait(20) == 2
    assert 'player.topics: got /imu/other' in player.stderr.read()


def test_player_keeps_the_rate(bag):
    """Played at ten times its speed, 30 s take 3 s, and the start of a process."""
    began = time.monotonic()
    player = node('player', bag=bag, rate=10.0)
    assert player.wait(20) == 0
    assert 2.9 < time.monotonic() - began < 10.0
