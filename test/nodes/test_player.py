# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time over ROS 2: the player's /clock, pauses, offsets and loops, and who lives by them."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from instruments import TAN2018  # noqa: E402
from peer import LATCHED, PATIENCE_S, Peer  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.measurements.samples import GyroSamples  # noqa: E402
from starcal_ros.messages.topics import TRUE_PARAMETERS  # noqa: E402
from starcal_ros.nodes.base.pacing import SimulatedClock  # noqa: E402
from starcal_ros.recording.qos import LATCHED as RECORDED_LATCHED  # noqa: E402
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.simulation.truth import Truth  # noqa: E402
from starcal_ros.simulation.write_recording import simulate  # noqa: E402

# A gyro so slow that this process can keep up, message by message, at twenty times its speed.
SCENARIO = TAN2018.replace({'simulation.duration_s': 40.0, 'gyro.rate_hz': 10.0})
START_NS = Truth.from_scenario(SCENARIO).motion.start_ns


def ns(stamp):
    """Return a stamp in ns."""
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a recording and its configuration."""
    folder = tmp_path_factory.mktemp('bag')
    simulate(SCENARIO, folder / 'run.mcap')
    (folder / 'config.yaml').write_text(parameter_file.dump(SCENARIO))
    return folder


def test_clock_stands_until_it_begins_and_while_it_is_stopped():
    now = [5]
    clock = SimulatedClock(1000, 2.0, lambda: now[0])
    assert clock.now_ns() == 999
    clock.stop()
    clock.begin()
    now[0] = 50
    assert clock.now_ns() == 1000
    clock.go_on()
    now[0] = 60
    assert clock.now_ns() == 1020
    clock.stop()
    now[0] = 1000
    assert clock.now_ns() == 1020
    clock.go_on()
    now[0] = 1010
    assert clock.now_ns() == 1040
    clock.begin()
    assert clock.now_ns() == 1000


def test_clock_does_not_begin_before_there_is_time():
    """With use_sim_time, zero is what a node has before the first /clock."""
    now = [0]
    clock = SimulatedClock(1000, 1.0, lambda: now[0])
    clock.begin()
    assert clock.now_ns() == 1000
    now[0] = 10**18
    assert clock.now_ns() == 1000
    now[0] += 7
    assert clock.now_ns() == 1007


def test_player_starts_late_loops_pauses_and_tells_the_time(start, peer, folder):
    imus, clocks = peer.listen(Imu, 'imu/data_raw', 5000), peer.listen(Clock, '/clock')
    truth = peer.listen(Float64MultiArray, 'truth/parameters', LATCHED)
    player = start('player', '-p', f'player.bag:={folder / "run.mcap"}', '-p', 'player.rate:=20.0',
                   '-p', 'player.start_offset_s:=30.0', '-p', 'player.loop:=true',
                   '-p', 'player.wait_for_subscribers:=1',
                   '-p', "player.topics:=['imu/data_raw', 'truth/parameters']")

    def laps(stamps):
        return sum(later < before for before, later in zip(stamps, stamps[1:]))

    def stamps():
        return [ns(imu.header.stamp) for imu in imus]

    def times():
        return [ns(message.clock) for message in clocks]

    peer.until(lambda: laps(stamps()) >= 2)
    lap = [START_NS + 30 * 10**9 + k * 10**8 for k in range(101)]
    assert stamps()[:202] == lap * 2
    assert truth                                # latched before the start
    peer.until(lambda: laps(times()) >= 2)      # the clock goes back with the messages
    assert lap[0] - 1 <= min(times()) and max(times()) <= lap[-1]
    assert peer.call(Trigger, 'player/pause').message == 'paused'
    peer.until(lambda: quiet(peer, imus))       # what was under way has come
    clocks.clear()
    count = len(imus)
    peer.until(lambda: len(clocks) >= 5)
    assert len(imus) == count and len(set(times())) == 1
    assert peer.call(Trigger, 'player/resume').message == 'playing'
    peer.until(lambda: len(imus) > count + 10)
    player.send_signal(signal.SIGINT)
    assert player.wait(PATIENCE_S) == 0


def test_latched_messages_of_before_the_recording_hold_up_nobody(start, peer, tmp_path):
    """A recorder that began an hour after the run has them, with their stamps as log times."""
    path = tmp_path / 'late.mcap'
    stamps = START_NS + (3600 + np.arange(20)) * 10**9
    with Writer(path) as writer:
        writer.write('/truth/parameters', 'std_msgs/msg/Float64MultiArray',
                     serialize_message(Float64MultiArray()), START_NS, qos=RECORDED_LATCHED)
        writer.write_imu('/imu/data_raw', GyroSamples(stamps, np.zeros((20, 3))))
    imus, truth = peer.listen(Imu, 'imu/data_raw'), peer.listen(
        Float64MultiArray, 'truth/parameters', LATCHED)
    player = start('player', '-p', f'player.bag:={path}', '-p', 'player.rate:=20.0',
                   '-p', 'player.wait_for_subscribers:=1')
    peer.until(lambda: len(imus) == 20 and truth)
    assert player.wait(PATIENCE_S) == 0


def quiet(peer, heard):
    """Return whether nothing comes for ten messages of others, or as many moments."""
    before = len(heard)
    for _ in range(10):
        rclpy.spin_once(peer.node, timeout_sec=0.05)
    return len(heard) == before


@pytest.mark.slow
def test_estimator_starts_again_with_each_lap_and_lives_by_the_clock(start, peer, folder):
    estimator = start('estimator', '--params-file', str(folder / 'config.yaml'),
                      '-p', 'use_sim_time:=true')
    player = start('player', '-p', f'player.bag:={folder / "run.mcap"}', '-p', 'player.rate:=40.0',
                   '-p', 'player.loop:=true', '-p', 'player.wait_for_subscribers:=1')
    peer.until(lambda: peer.diagnostics and went_back(peer.states)
               and int(values(peer.diagnostics[-1])['restarts']) >= 2)
    now_ns = ns(peer.diagnostics[-1].header.stamp)
    assert START_NS <= now_ns <= START_NS + 40 * 10**9
    assert int(values(peer.diagnostics[-1])['frames']) <= 80
    for process in (player, estimator):
        process.send_signal(signal.SIGINT)
    said = estimator.communicate(timeout=PATIENCE_S)[1]
    assert estimator.returncode == 0
    assert f'stamps went back by 39.900 s to {START_NS + 10**8} ns: started again' in said


def went_back(states):
    """Tell whether a state is earlier than the one before it."""
    seconds = [state.data[0] for state in states]
    return any(later < before for before, later in zip(seconds, seconds[1:]))


def values(message):
    """Return what diagnostics say of the calibration, by key."""
    return {item.key: item.value for item in message.status[0].values}


def test_play_tells_programs_what_it_played(folder):
    done = subprocess.run(
        [sys.executable, '-m', 'starcal_ros.cli', 'play', str(folder / 'run.mcap'), '--rate', '0',
         '--json'], stdout=subprocess.PIPE, text=True, cwd=folder, timeout=60.0)
    assert (done.returncode, json.loads(done.stdout)) == (0, {
        'bag': str(folder / 'run.mcap'), 'played': {
            '/star_tracker/camera_info': 1, '/truth/attitude': 80, '/truth/parameters': 1,
            '/imu/data_raw': 400, '/star_tracker/centroids': 80}})


def test_what_nobody_reads_is_no_traceback(folder):
    with open('/dev/full', 'w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'starcal_ros.cli', 'play', str(folder / 'run.mcap'), '--rate',
             '0', '--json'], stdout=full, stderr=subprocess.PIPE, text=True, cwd=folder,
            timeout=60.0)
    assert 'messages played' in done.stderr and 'Traceback' not in done.stderr


def test_offset_beyond_the_end_is_refused(start, folder):
    player = start('player', '-p', f'player.bag:={folder / "run.mcap"}',
                   '-p', 'player.start_offset_s:=41.0')
    said = player.communicate(timeout=PATIENCE_S)[1]
    assert player.returncode == 2
    assert 'player.start_offset_s: got 41.0' in said and 'lasts 40.000 s' in said


def test_simulator_with_use_sim_time_follows_the_clock(start, peer, folder):
    """Its own time passes as /clock does, whatever that shows."""
    sim = start('gyro_sim', '--params-file', str(folder / 'config.yaml'),
                '-p', 'use_sim_time:=true', '-p', 'simulation.wait_for_subscribers:=1',
                '-p', 'simulation.real_time_factor:=1.0')
    clock = peer.node.create_publisher(Clock, '/clock', 1)

    def show(seconds):
        clock.publish(Clock(clock=Time(sec=seconds)))
        rclpy.spin_once(peer.node, timeout_sec=0.02)
        return True

    peer.until(lambda: show(1000) and clock.get_subscription_count())
    for _ in range(25):
        show(1000)
    imus = peer.listen(Imu, 'imu/data_raw', 5000)
    peer.until(lambda: peer.node.count_publishers('imu/data_raw') == 2)
    for _ in range(25):
        show(1000)
    assert imus == []
    peer.until(lambda: show(1003) and len(imus) >= 30)
    for _ in range(25):
        show(1003)
    assert [ns(imu.header.stamp) - START_NS for imu in imus] == [k * 10**8 for k in range(1, 31)]
    sim.send_signal(signal.SIGINT)
    assert sim.wait(PATIENCE_S) == 0


@pytest.fixture(scope='module')
def renamed(tmp_path_factory):
    """Return a function that records the first seconds under other names."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    samples, frames = gyro.next(101), tracker.next(20)
    folder = tmp_path_factory.mktemp('renamed')

    def record(*pairs):
        path = folder / f'{"_".join(imu.replace("/", "") for imu, _ in pairs)}.mcap'
        if not path.exists():
            with Writer(path) as writer:
                writer.write_batches(*(batch for imu, stars in pairs for batch in (
                    imu_batch(imu, samples), centroids_batch(stars, frames))))
                # Nobody listens to this one.
                writer.write(TRUE_PARAMETERS.recorded, TRUE_PARAMETERS.type_name, bytes(16),
                             int(samples.stamp_ns[0]))
        return path
    return record


LEFT = '/left/imu/data_raw', '/left/star_tracker/centroids'
RIGHT = '/right/imu/data_raw', '/right/star_tracker/centroids'
ODD = '/adis16505/gyro', '/cam0/stars'


@pytest.mark.parametrize('pairs, words', [
    ([LEFT, ODD], ['-p', 'player.imu_topic:=/adis16505/gyro',
                   '-p', 'player.centroids_topic:=cam0/stars']),
    *(pytest.param(*rest, marks=pytest.mark.slow) for rest in (
        ([LEFT], []), ([ODD], []),
        ([LEFT, RIGHT], ['-p', 'player.recorded_namespace:=right'])))])
def test_recording_under_any_name_reaches_the_estimator(start, folder, renamed, pairs, words):
    rclpy.init()
    try:
        peer = Peer('here')
        start('estimator', '--params-file', str(folder / 'config.yaml'), '-r', '__ns:=/here')
        player = start('player', '-p', f'player.bag:={renamed(*pairs)}', '-p', 'player.rate:=0.0',
                       '-p', 'player.rename:=true', '-p', 'player.wait_for_subscribers:=1',
                       '-r', '__ns:=/here', *words)
        assert player.wait(PATIENCE_S) == 0, player.stderr.read()
        last_s = sensors.star_tracker(SCENARIO).next(20).stamp_ns[-1] * 1e-9
        peer.until(lambda: peer.states and abs(peer.states[-1].data[0] - last_s) < 1e-3)
    finally:
        rclpy.shutdown()


@pytest.mark.parametrize('pairs, words, said', [
    ([LEFT, RIGHT], [], f'player.imu_topic: needs one of {LEFT[0]}, {RIGHT[0]}'),
    ([LEFT], ['-p', 'player.recorded_namespace:=right'],
     f'got right, the recording has {LEFT[0]}'),
    ([LEFT], ['-p', 'player.imu_topic:=gyro'], f'got /gyro, the recording has {LEFT[0]}')])
def test_player_names_the_choice_where_there_is_none_or_more(start, renamed, pairs, words, said):
    player = start('player', '-p', f'player.bag:={renamed(*pairs)}', '-p', 'player.rename:=true',
                   *words)
    errors = player.communicate(timeout=PATIENCE_S)[1]
    assert player.returncode == 2 and said in errors


@pytest.mark.parametrize('pair', [pytest.param(LEFT, marks=pytest.mark.slow), ODD])
def test_player_that_keeps_the_names_waits_for_the_sensors_alone(start, folder, renamed, pair):
    start('estimator', '--params-file', str(folder / 'config.yaml'),
          '-r', f'imu/data_raw:={pair[0]}', '-r', f'star_tracker/centroids:={pair[1]}')
    player = start('player', '-p', f'player.bag:={renamed(pair)}', '-p', 'player.rate:=0.0',
                   '-p', 'player.wait_for_subscribers:=1')
    assert player.wait(PATIENCE_S) == 0
    assert '122 messages played' in player.stderr.read()


def test_player_says_what_it_waits_for_and_what_there_is(start, renamed):
    player = start('player', '-p', f'player.bag:={renamed(LEFT)}',
                   '-p', 'player.wait_for_subscribers:=1')
    said = next(line for line in player.stderr if 'waiting: ' in line)
    assert f'{LEFT[0]} has 0 of 1' in said
    assert f'the recording has 101 {LEFT[0]}, 20 {LEFT[1]}' in said
    player.send_signal(signal.SIGINT)
    assert player.wait(PATIENCE_S) == 0
