# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What becomes of a recording when the recorder is killed or stopped, or its place is gone."""

import resource
import shutil
import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from peer import PATIENCE_S  # noqa: E402
from starcal_ros.measurements.samples import Frames, GyroSamples  # noqa: E402
from starcal_ros.recording.bag import open_bag  # noqa: E402
from starcal_ros.recording.losses import LOSSES  # noqa: E402
from starcal_ros.recording.mcap_reader import McapFile  # noqa: E402
from starcal_ros.recording.mcap_tail import McapTail  # noqa: E402
from starcal_ros.recording.reader import summary  # noqa: E402
from starcal_ros.recording.writer import Writer  # noqa: E402

START_NS, SECOND = 1_782_993_600_000_000_000, 10**9


def samples(low, high):
    """Return gyro readings of 100 Hz by their numbers."""
    stamps = START_NS + 10_000_000 * np.arange(low, high)
    return GyroSamples(stamps, np.zeros((high - low, 3)))


def no_stars():
    """Return no star frame."""
    return Frames(np.empty(0, np.int64), np.zeros(1, np.int64), np.empty((0, 2)), np.empty(0),
                  np.empty(0), np.empty(0, np.int64))


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a recording of 200 s of gyro readings."""
    path = tmp_path_factory.mktemp('bag') / 'original.mcap'
    with Writer(path) as writer:
        writer.write_imu('/imu/data_raw', samples(0, 20_000))
    return path


def recording(start, tmp_path, *words, names=(), name='recorder', file='run.mcap'):
    """Start a recorder and return it when it is ready, and its file."""
    path = tmp_path / file
    process = start(name, '-p', f'recorder.output:={path}', *words, names=names)
    assert any('recording to' in line for line in process.stderr)
    return process, path


def end(process, number=signal.SIGINT):
    """End a process; return its status and what it said."""
    if process.poll() is None:
        process.send_signal(number)
    said = process.communicate(timeout=PATIENCE_S)[1]
    return process.returncode, said


def publish(peer, low, high):
    """Publish gyro readings to a recorder, and wait until it has them."""
    peer.until(peer.gyro.get_subscription_count)
    peer.send(samples(low, high), no_stars())


@pytest.mark.parametrize('factor', [5.0, 20.0])
def test_a_killed_recorder_has_lost_a_second_of_the_stamps_at_most(
        start, peer, tmp_path, bag, factor):
    recorder, path = recording(start, tmp_path)
    heard = peer.listen(Imu, 'imu/data_raw', QoSProfile(depth=1000))
    start('player', '-p', f'player.bag:={bag}', '-p', f'player.rate:={factor}', '-p',
          'player.wait_for_subscribers:=2')
    peer.until(lambda: len(heard) > 800)
    recorder.kill()
    recorder.wait()
    stamp = heard[-1].header.stamp
    lost_ns = stamp.sec * SECOND + stamp.nanosec - McapTail(path).newest_ns()
    assert lost_ns < SECOND
    log_times = open_bag(path).log_times('/imu/data_raw')
    assert (np.diff(log_times) == 10_000_000).all() and log_times[0] == START_NS


def test_a_folder_that_is_removed_ends_the_recorder_with_status_1(start, peer, tmp_path):
    folder = tmp_path / 'folder'
    folder.mkdir()
    recorder, path = recording(start, tmp_path, file='folder/run.mcap')
    publish(peer, 0, 200)
    shutil.rmtree(folder)
    said = recorder.communicate(timeout=PATIENCE_S)[1]      # it ends by itself
    assert recorder.returncode == 1
    assert '[ERROR]' in said and f'{path} was removed while it was written' in said
    assert 'messages recorded' not in said and 'Traceback' not in said


def test_a_full_disk_ends_the_recorder_alone_and_what_is_on_it_can_be_read(
        start, peer, tmp_path, monkeypatch):
    """In one process with an estimator, which goes on: it answers and ends when it is asked."""
    monkeypatch.setenv('PYTHONDONTWRITEBYTECODE', '1')      # Python's cache would not be whole
    process, path = recording(start, tmp_path, name='composed', names=['recorder', 'estimator'])
    peer.until(lambda: peer.gyro.get_subscription_count() == 2)
    publish(peer, 0, 200)
    tail = McapTail(path)
    peer.until(tail.newest_ns)
    limit = path.stat().st_size + 5000
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
    for k in range(2, 30):
        peer.send(samples(100 * k, 100 * k + 100), no_stars())
    peer.until(lambda: peer.gyro.get_subscription_count() == 1)     # the recorder is gone
    assert peer.status()
    status, said = end(process)
    assert status == 1 and 'Traceback' not in said
    assert '[ERROR]' in said and 'cannot be written any further: File too large' in said
    assert path.stat().st_size <= limit
    log_times = open_bag(path).log_times('/imu/data_raw')
    assert len(log_times) >= 200 and (np.diff(log_times) == 10_000_000).all()


@pytest.mark.slow
def test_a_recorder_that_is_stopped_for_long_says_so_in_the_file(start, peer, tmp_path):
    """What was lost after the last message that came, no stamp tells."""
    recorder, path = recording(start, tmp_path)
    publish(peer, 0, 300)
    peer.until(McapTail(path).newest_ns)
    recorder.send_signal(signal.SIGSTOP)
    time.sleep(11.0)
    recorder.send_signal(signal.SIGCONT)
    assert any('recorder: held up for 1' in line for line in recorder.stderr)
    assert end(recorder)[0] == 0
    assert any('recorder: held up for 1' in text for text in summary(path).warnings)


def test_the_recorder_counts_what_is_missing_and_says_so_in_the_file(start, peer, tmp_path):
    """Readings that never came show in the stamps of those that do."""
    recorder, path = recording(start, tmp_path)
    publish(peer, 0, 300)
    publish(peer, 1300, 1600)
    publish(peer, 1650, 1700)
    time.sleep(0.5)
    status, said = end(recorder)
    assert status == 0
    assert ('/imu/data_raw: 1050 messages are missing by their stamps, the longest gap is 10.01 s'
            in said)
    assert '/imu/data_raw' in McapFile(path).metadata[LOSSES]
    assert any('1050 messages are missing' in text for text in summary(path).warnings)


def test_the_recorder_splits(start, peer, tmp_path):
    recorder, path = recording(start, tmp_path, '-p', 'recorder.max_bagfile_duration:=2',
                               file='split')
    publish(peer, 0, 500)
    time.sleep(0.5)
    assert end(recorder)[0] == 0
    assert sorted(each.name for each in path.iterdir()) == [
        'metadata.yaml', 'split_0.mcap', 'split_1.mcap', 'split_2.mcap']
    topic, = [topic for topic in summary(path).topics if topic.topic == '/imu/data_raw']
    assert topic.count == 500 and not summary(path).warnings


def test_a_split_recorder_that_is_killed_leaves_all_its_files(start, peer, tmp_path):
    recorder, path = recording(start, tmp_path, '-p', 'recorder.max_bagfile_duration:=2',
                               file='split')
    publish(peer, 0, 500)
    peer.until(lambda: (path / 'split_2.mcap').is_file()
               and McapTail(path / 'split_2.mcap').newest_ns() == START_NS + 499 * 10_000_000)
    end(recorder, signal.SIGKILL)
    topic, = [topic for topic in summary(path).topics if topic.topic == '/imu/data_raw']
    assert topic.count == 500
