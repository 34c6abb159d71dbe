# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nothing is lost between processes, however slow a subscriber is."""

from collections.abc import Iterator
import json
import signal
import subprocess
import sys
import threading
import time

import pytest

pytest.importorskip('rclpy')

# Publishes numbered messages, in the stamp; argv: count, latched, subscribers to wait for.
PUBLISHER = """
import sys
from rclpy.node import Node
from sensor_msgs.msg import Imu
from starcal_ros.nodes.base.flow_publisher import FlowPublisher, when_subscribed
from starcal_ros.nodes.base.pacing import Feed, SimulatedClock
from starcal_ros.nodes.base.run_loop import run


class Numbers(Node):

    def __init__(self):
        super().__init__('numbers')
        count, latched, subscribers = (int(word) for word in sys.argv[1:])
        self.publisher = FlowPublisher(self, Imu, 'numbers', latched=bool(latched))
        self.clock = SimulatedClock(0, 0.0)
        self.feed = Feed(self, self.clock, self.items(count))
        when_subscribed(self, [self.publisher], subscribers, (), self.begin)
        self.stays = bool(latched)      # a latched message is there as long as its publisher

    def begin(self):
        print('matched', flush=True)
        self.clock.begin()

    def items(self, count):
        for number in range(count):
            message = Imu()
            message.header.stamp.sec = number
            yield number, self.publisher, message
        print('published', flush=True)

    @property
    def finished(self):
        return self.feed.finished and not self.stays

    def close(self):
        self.feed.close()


sys.exit(run(Numbers, sys.argv[:1]))
"""

# Reports as JSON what came, when it has the last number; argv: last, pause a batch, latched, raw.
SUBSCRIBER = """
import json
import sys
import time
from rclpy.node import Node
from sensor_msgs.msg import Imu
from starcal_ros.nodes.base.matched_subscription import MatchedSubscription
from starcal_ros.nodes.base.run_loop import run


class Listener(Node):
    finished = False

    def __init__(self):
        super().__init__('listener')
        self.last, self.pause_s, latched, self.raw = (json.loads(word) for word in sys.argv[1:])
        self.numbers, self.batches = [], []
        MatchedSubscription(self, Imu, 'numbers', self.take, latched=latched, raw=self.raw)
        print('ready', flush=True)

    def take(self, messages):
        self.numbers += [int.from_bytes(message[4:8], 'little') if self.raw
                         else message.header.stamp.sec for message in messages]
        self.batches.append(len(messages))
        time.sleep(self.pause_s)
        self.finished = self.numbers[-1] == self.last

    def close(self):
        missing = sorted(set(range(self.last + 1)) - set(self.numbers))
        print(json.dumps({'count': len(self.numbers), 'missing': len(missing),
                          'ordered': self.numbers == sorted(self.numbers),
                          'largest_batch': max(self.batches, default=0)}), flush=True)


sys.exit(run(Listener, sys.argv[:1]))
"""

BEST_EFFORT = """
import time
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
rclpy.init()
node = rclpy.create_node('driver')
qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
publisher = node.create_publisher(Imu, 'numbers', qos)
message = Imu()
message.header.stamp.sec = 7
while True:
    publisher.publish(message)
    time.sleep(0.02)
"""

# A subscriber with this profile is forgotten 2 s after it died, not 20 s.
SHORT_LEASE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <participant profile_name="short_lease" is_default_profile="true"><rtps><builtin>
    <discovery_config>
      <leaseDuration><sec>2</sec></leaseDuration>
      <leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
    </discovery_config>
  </builtin></rtps></participant>
</profiles></dds>
"""


class Processes:
    """Child processes that never outlive their test."""

    def __init__(self) -> None:
        self._all: list[subprocess.Popen] = []

    def start(self, source: str, *words: object) -> subprocess.Popen:
        """Start a script with arguments."""
        self._all.append(subprocess.Popen(
            [sys.executable, '-c', source, *(json.dumps(word) for word in words)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return self._all[-1]

    def listen(self, last: int, pause_s: float = 0.0, *, latched: bool = False,
               raw: bool = False) -> subprocess.Popen:
        """Start a subscriber; return when it has subscribed."""
        process = self.start(SUBSCRIBER, last, pause_s, latched, raw)
        assert process.stdout.readline() == 'ready\n'
        return process

    def kill(self) -> None:
        """End what still runs."""
        for process in self._all:
            process.kill()
            process.wait()


@pytest.fixture
def processes() -> Iterator[Processes]:
    """Return a starter of processes; what still runs after a minute is killed."""
    children = Processes()
    watchdog = threading.Timer(60.0, children.kill)
    watchdog.start()
    yield children
    watchdog.cancel()
    children.kill()


def result(process: subprocess.Popen, timeout_s: float = 40.0) -> dict[str, object]:
    """Return what a subscriber reports when it has the last message."""
    out, errors = process.communicate(timeout=timeout_s)
    assert process.returncode == 0, errors
    return json.loads(out)


@pytest.mark.slow
def test_slow_subscriber_slows_the_publisher_and_nothing_is_lost(processes):
    count = 20_000
    listeners = [processes.listen(count - 1), processes.listen(count - 1, 0.1),
                 processes.listen(count - 1, raw=True)]
    publisher = processes.start(PUBLISHER, count, 0, len(listeners))
    for listener in listeners:
        heard = result(listener)
        assert (heard['count'], heard['missing'], heard['ordered']) == (count, 0, True)
        assert heard['largest_batch'] <= 500
    out, errors = publisher.communicate(timeout=20)
    assert (publisher.returncode, out) == (0, 'matched\npublished\n'), errors


def test_no_result_is_lost_though_only_the_last_is_kept(processes):
    count = 1000
    listener = processes.listen(count - 1, latched=True)
    publisher = processes.start(PUBLISHER, count, 1, 1)
    assert publisher.stdout.readline() == 'matched\n'
    listener.send_signal(signal.SIGSTOP)
    time.sleep(0.5)
    listener.send_signal(signal.SIGCONT)
    heard = result(listener)
    assert (heard['count'], heard['missing'], heard['ordered']) == (count, 0, True)


def test_late_listener_gets_the_last_latched_message_and_none_before_it(processes):
    publisher = processes.start(PUBLISHER, 10, 1, 0)
    assert [publisher.stdout.readline() for _ in range(2)] == ['matched\n', 'published\n']
    heard = result(processes.listen(9, latched=True))       # ends when it has the last, 9
    assert heard['count'] == 1


@pytest.mark.parametrize('latched', [False, True])
def test_driver_that_offers_best_effort_only_is_heard(processes, latched):
    listener = processes.listen(7, latched=latched)
    processes.start(BEST_EFFORT)
    out, errors = listener.communicate(timeout=20)
    assert json.loads(out)['count'] > 0
    assert 'a publisher offers best effort only' in errors
    assert ('a publisher offers volatile only' in errors) == latched


def wait_until_it_waits(publisher: subprocess.Popen) -> None:
    """Return when a publisher says that it waits for a subscriber."""
    assert any('a subscriber is behind' in line for line in publisher.stderr)


@pytest.mark.slow
def test_stop_interrupts_a_publisher_that_waits(processes):
    processes.listen(10**6, 1000.0)
    publisher = processes.start(PUBLISHER, 10**6, 0, 1)
    wait_until_it_waits(publisher)
    publisher.terminate()
    assert publisher.wait(5) == 0


def test_latched_message_reaches_the_others_where_one_takes_nothing(processes):
    """The publisher is patient for a second; the stopped one is forgotten after twenty."""
    source = PUBLISHER.replace('latched=bool(latched)', 'latched=bool(latched), patience_s=1.0')
    stopped, listener = (processes.listen(4, latched=True) for _ in range(2))
    publisher = processes.start(source, 5, 1, 2)
    publisher_matched = publisher.stdout.readline()
    stopped.send_signal(signal.SIGSTOP)
    heard = result(listener, 15.0)
    assert (publisher_matched, heard['missing']) == ('matched\n', 0)


@pytest.mark.slow
def test_dead_subscriber_does_not_stall_the_publisher_forever(processes, tmp_path, monkeypatch):
    profile = tmp_path / 'lease.xml'
    profile.write_text(SHORT_LEASE)
    with monkeypatch.context() as patch:
        patch.setenv('FASTDDS_DEFAULT_PROFILES_FILE', str(profile))
        patch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
        listener = processes.listen(10**6, 1000.0)
    publisher = processes.start(PUBLISHER, 20_000, 0, 1)
    wait_until_it_waits(publisher)
    listener.kill()
    assert publisher.wait(15) == 0
