# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulators as processes, as fast as they go: neither leaves the other behind."""

import signal
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import Imu, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from instruments import TAN2018  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.core.utc import unix_ns  # noqa: E402
from starcal_ros.nodes.base.convoy import LEAD_S, Convoy  # noqa: E402
from starcal_ros.nodes.base.pacing import Feed, SimulatedClock  # noqa: E402
from starcal_ros.nodes.base.qos import LATCHED  # noqa: E402

SCENARIO = TAN2018.replace({'simulation.real_time_factor': 0.0,
                            'simulation.wait_for_subscribers': 1,
                            'simulation.wait_for_simulators': 1})
START_S = unix_ns(SCENARIO.simulation.start_utc) * 1e-9
NAMES = ('gyro_sim', 'star_tracker_sim')
PERIOD_S = {'gyro_sim': 1.0 / SCENARIO.gyro.rate_hz,
            'star_tracker_sim': 1.0 / SCENARIO.star_tracker.rate_hz}


@pytest.fixture
def heard(peer):
    """Return stamp, since the start [s], and time of sending [ns] of what simulators publish."""
    found = {name: [] for name in NAMES}

    def keep(name):
        def take(message, info):
            stamp = message.header.stamp
            found[name].append((stamp.sec - START_S + stamp.nanosec * 1e-9,
                                info['source_timestamp']))
        return take
    for name, kind, topic in (('gyro_sim', Imu, 'imu/data_raw'),
                              ('star_tracker_sim', PointCloud2, 'star_tracker/centroids')):
        peer.node.create_subscription(kind, topic, keep(name), QoSProfile(depth=1000))
    return found


@pytest.fixture
def newest(heard):
    """Return a function that gives the newest stamp of a simulator, since the start [s]."""
    return lambda name: heard[name][-1][0] if heard[name] else -1.0


def passes(peer, seconds):
    """Let a time pass."""
    ends = time.monotonic() + seconds
    peer.until(lambda: time.monotonic() > ends)


@pytest.mark.parametrize('slow, fast', [
    NAMES, pytest.param(*NAMES[::-1], marks=pytest.mark.slow)])
def test_one_that_stands_holds_up_the_other_until_it_goes_on_or_leaves(
        start, peer, heard, newest, tmp_path, slow, fast):
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO))
    processes = {fast: start(fast, '--params-file', str(config))}
    peer.until(lambda: peer.node.count_publishers('simulation/progress') == 1)
    passes(peer, 1.0)
    assert newest(fast) < 0.0                   # alone it does not begin
    processes[slow] = start(slow, '--params-file', str(config))
    peer.until(lambda: min(map(newest, NAMES)) > 2.0 * LEAD_S)
    processes[slow].send_signal(signal.SIGSTOP)
    # Alone it would go on by hundreds of seconds a second.
    stood = []

    def stands():
        stood.append(newest(fast))
        passes(peer, 0.7)
        return newest(fast) == stood[-1]
    peer.until(stands)
    resumed_ns = time.time_ns()
    processes[slow].send_signal(signal.SIGCONT)
    # What the other published last may have been lost on the way: going on, it repeats that first.
    peer.until(lambda: heard[slow][-1][1] > resumed_ns)
    reached = max(stamp for stamp, sent_ns in heard[slow] if sent_ns < resumed_ns)
    # It told that nothing comes before its next stamp.
    assert stood[-1] <= reached + PERIOD_S[slow] + LEAD_S + 1e-6
    peer.until(lambda: min(map(newest, NAMES)) > stood[-1] + 3.0 * LEAD_S)
    processes[slow].send_signal(signal.SIGINT)
    assert processes[slow].wait(PATIENCE_S) == 0
    left = newest(slow)
    peer.until(lambda: newest(fast) > left + 3.0 * LEAD_S)
    assert processes[fast].poll() is None
    processes[fast].send_signal(signal.SIGINT)
    assert processes[fast].wait(PATIENCE_S) == 0


@pytest.mark.parametrize('factor', [0.0, 10.0])
def test_clock_stands_at_its_limit_and_goes_on_from_there(factor):
    """It does not make up for the time in which it stood, which would be a burst."""
    real_ns, limit_ns = 0, 2**62
    clock = SimulatedClock(1000, factor, lambda: real_ns + 10**9, lambda: limit_ns)
    clock.begin()
    assert clock.now_ns() == (2**62 if factor == 0.0 else 1000)
    limit_ns, real_ns = 1500, 100
    assert clock.now_ns() == 1500
    real_ns = 10_000
    assert clock.now_ns() == 1500
    limit_ns = 2000
    assert clock.now_ns() == (2000 if factor == 0.0 else 1500)
    real_ns += 30
    assert clock.now_ns() == (2000 if factor == 0.0 else 1800)


@pytest.mark.parametrize('factor', [0.0, 10.0])
def test_clock_tells_how_long_it_takes_to_a_stamp(factor):
    limit_ns = 1100
    clock = SimulatedClock(1000, factor, lambda: 10**9, lambda: limit_ns)
    assert clock.seconds_to(1000) == np.inf         # it has not begun
    clock.begin()
    assert clock.seconds_to(1000) == 0.0
    assert clock.seconds_to(1100) == (0.0 if factor == 0.0 else pytest.approx(1e-8))
    assert clock.seconds_to(1200) == np.inf         # beyond the limit
    limit_ns = 1200
    assert clock.seconds_to(1200) == (0.0 if factor == 0.0 else pytest.approx(2e-8))
    clock.stop()
    limit_ns = 1300
    assert clock.seconds_to(1300) == np.inf


def test_who_looks_at_a_feed_needs_no_timer(peer):
    clock, published = SimulatedClock(1000, 0.0), []

    class Publisher:
        acknowledged = True

        def publish(self, message):
            published.append(message)
            return True

    to = Publisher()
    feed = Feed(peer.node, clock, iter([(1000, to, 'a'), (2000, to, 'b')]))
    timers = len([*peer.node.timers])
    assert (feed.look_again(), feed.rests_s) == (0, np.inf)
    assert len([*peer.node.timers]) == timers - 1
    clock.begin()
    assert feed.rests_s == 0.0
    assert (feed.look_again(), published, feed.finished) == (2, ['a', 'b'], True)


def test_who_is_over_says_so_once(peer):
    """Two that waited for their subscribers told each other thousands of times."""
    heard = peer.listen(Header, 'simulation/progress', QoSProfile(
        depth=100, durability=LATCHED.durability))
    convoy = Convoy(peer.node, 0)
    for stamp_ns in (10**9, None, None, None):
        convoy.tell(stamp_ns)
    peer.until(lambda: any(header.stamp.sec > 1 for header in heard))
    passes(peer, 0.2)
    assert sum(header.stamp.sec > 1 for header in heard) == 1


def test_a_recorder_of_another_kind_does_not_stand_in_for_the_node_that_is_waited_for(
        start, peer, newest):
    """As `ros2 bag record`, which is there first: the estimator missed 1.5 s of the gyro."""
    start('gyro_sim', '-p', 'simulation.wait_for_nodes:=[listener]',
          '-p', 'simulation.real_time_factor:=1.0')
    peer.until(lambda: peer.node.count_publishers('imu/data_raw') == 1)
    passes(peer, 1.5)
    assert newest('gyro_sim') < 0.0
    awaited = rclpy.create_node('listener', namespace=peer.node.get_namespace())
    heard = []
    awaited.create_subscription(Imu, 'imu/data_raw', heard.append, QoSProfile(depth=1000))
    peer.until(lambda: newest('gyro_sim') > 0.0)
    while len(heard) < 5:
        rclpy.spin_once(awaited, timeout_sec=PATIENCE_S)
    awaited.destroy_node()
    assert heard[0].header.stamp.nanosec == 10_000_000
