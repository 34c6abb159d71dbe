# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes led from outside; estimator and recorder both in one process."""

from contextlib import suppress
import signal
import subprocess
import sys

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from lifecycle_msgs.msg import Transition, TransitionEvent  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import LivelinessPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
import yaml  # noqa: E402

from instruments import CONFIG, TAN2018  # noqa: E402
from peer import LATCHED, PATIENCE_S, Peer  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.measurements.samples import GyroSamples  # noqa: E402
from starcal_ros.messages import conventions, topics  # noqa: E402
from starcal_ros.nodes.base import run_loop  # noqa: E402
from starcal_ros.nodes.base.managed_node import ManagedNode  # noqa: E402
from starcal_ros.nodes.base.matched_subscription import BACKLOG_S  # noqa: E402
from starcal_ros.nodes.base.matched_subscription import MatchedSubscription  # noqa: E402
from starcal_ros.nodes.estimator import Estimator  # noqa: E402
from starcal_ros.recording import reader  # noqa: E402
from starcal_ros.recording.mcap_reader import McapFile  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SCENARIO = TAN2018.replace({'simulation.duration_s': 30.0})
GYRO_QOS = QoSProfile(depth=5000, deadline=Duration(seconds=2), lifespan=Duration(seconds=3600),
                      liveliness=LivelinessPolicy.AUTOMATIC,
                      liveliness_lease_duration=Duration(seconds=20))


@pytest.fixture(scope='module')
def readings():
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return gyro.next(gyro.count), tracker.next(tracker.count)


@pytest.fixture(scope='module')
def peer():
    rclpy.init()
    try:
        yield Peer(gyro_qos=GYRO_QOS)
    finally:
        rclpy.shutdown()


@pytest.fixture(scope='module')
def output(tmp_path_factory):
    return tmp_path_factory.mktemp('recording') / 'run.mcap'


@pytest.fixture(scope='module')
def process(start_once, output):
    """Both nodes; the tests below lead them through their lives, in this order."""
    return start_once('composed', '--params-file', str(CONFIG), '-p', 'autostart:=false',
                      '-p', f'recorder.output:={output}', names=('estimator', 'recorder'))


def state(peer, name):
    """Return the state of a node."""
    return peer.call(GetState, f'{name}/get_state').current_state.label


def change(peer, name, transition):
    """Ask for a transition; return whether it was done."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return peer.call(ChangeState, f'{name}/change_state', request).success


def both(peer, transition):
    """Ask both nodes for a transition."""
    return [change(peer, name, transition) for name in ('estimator', 'recorder')]


def part(readings, low_s, high_s):
    """Return the readings of a part of the run, both ends included."""
    gyro, frames = readings
    rows = slice(round(100 * low_s), round(100 * high_s))
    return gyro[rows], frames[round(2 * low_s):round(2 * high_s)]


def test_node_without_autostart_waits_unconfigured(process, peer):
    assert [state(peer, name) for name in ('estimator', 'recorder')] == ['unconfigured'] * 2
    assert peer.node.count_publishers('starcal/state') == 0
    assert peer.node.count_subscribers('imu/data_raw') == 0


def test_configured_node_subscribes_to_nothing(process, peer):
    events = peer.listen(TransitionEvent, 'estimator/transition_event')
    peer.until(lambda: peer.node.count_publishers('estimator/transition_event') == 1)
    assert both(peer, Transition.TRANSITION_CONFIGURE) == [True, True]
    assert [state(peer, name) for name in ('estimator', 'recorder')] == ['inactive'] * 2
    peer.until(lambda: peer.node.count_publishers('starcal/state') == 1)
    assert peer.node.count_subscribers('imu/data_raw') == 0
    peer.until(lambda: [event.goal_state.label for event in events] == ['configuring', 'inactive'])


def test_active_node_works_and_inactive_node_misses_what_the_stamps_say(process, peer, readings):
    """Active for ten seconds, inactive for ten, active for ten."""
    assert both(peer, Transition.TRANSITION_ACTIVATE) == [True, True]
    peer.until(lambda: peer.gyro.get_subscription_count() == 2
               and peer.frames.get_subscription_count() == 2)
    peer.send(*part(readings, 0.0, 10.0))
    peer.until(lambda: len(peer.states) == 20)
    assert both(peer, Transition.TRANSITION_DEACTIVATE) == [True, True]
    peer.until(lambda: not peer.gyro.get_subscription_count())
    peer.send(*part(readings, 10.0, 20.0))
    late = peer.listen(Float64MultiArray, 'starcal/state', LATCHED)
    peer.until(lambda: late)                # what it has found out is still there
    silent = len(peer.diagnostics)
    assert both(peer, Transition.TRANSITION_ACTIVATE) == [True, True]
    assert len(peer.diagnostics) - silent <= 1
    peer.until(lambda: peer.gyro.get_subscription_count() == 2
               and peer.frames.get_subscription_count() == 2)
    peer.send(*part(readings, 20.0, 30.0))
    peer.until(lambda: len(peer.states) == 40)
    values = peer.values()
    assert (values['missing_gyro'], values['missing_frames']) == ('1000', '20')
    assert (values['gyro'], values['frames'], values['restarts']) == ('2000', '40', '0')


def test_recorder_has_both_parts_and_the_nine_qos_policies_of_the_sensor(
        process, peer, readings, output):
    assert both(peer, Transition.TRANSITION_DEACTIVATE) == [True, True]
    assert change(peer, 'recorder', Transition.TRANSITION_CLEANUP)
    recording = reader.read(output)
    expected = GyroSamples.concatenate((part(readings, 0., 10.)[0], part(readings, 20., 30.)[0]))
    np.testing.assert_array_equal(recording.gyro.stamp_ns, expected.stamp_ns)
    counts = {topic.topic: topic.count for topic in reader.summary(output).topics}
    assert counts['/starcal/state'] == counts['/starcal/camera_info'] == 40     # none twice
    channel = next(channel for channel in McapFile(output).channels.values()
                   if channel.topic == '/imu/data_raw')
    offered, = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    assert offered == {
        'history': 'keep_last', 'depth': 100, 'reliability': 'reliable', 'durability': 'volatile',
        'deadline': {'sec': 2, 'nsec': 0}, 'lifespan': {'sec': 3600, 'nsec': 0},
        'liveliness': 'automatic', 'liveliness_lease_duration': {'sec': 20, 'nsec': 0},
        'avoid_ros_namespace_conventions': False}


def test_offline_calibration_of_the_recording_gives_the_same_numbers(process, peer, output):
    recording = reader.read(output)
    calibrator, _ = calibrate(recording.gyro, recording.frames, SCENARIO)
    np.testing.assert_array_equal(
        peer.states[-1].data, conventions.state_vector(calibrator.stamp_ns, calibrator.belief))


def test_what_keeps_a_node_from_its_next_state_is_said_and_it_stays(process, peer):
    assert not change(peer, 'recorder', Transition.TRANSITION_CONFIGURE)
    assert state(peer, 'recorder') == 'unconfigured'
    assert any('configure: ' in line and 'run.mcap exists' in line for line in process.stderr)


def test_process_ends_when_both_nodes_are_shut_down(process, peer):
    assert change(peer, 'recorder', Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert process.poll() is None
    assert change(peer, 'estimator', Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert process.wait(PATIENCE_S) == 0


def test_signal_ends_a_node_that_was_never_configured(start_once, peer):
    recorder = start_once('recorder', '-p', 'autostart:=false', '-r', '__node:=waiting')
    assert state(peer, 'waiting') == 'unconfigured'
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(PATIENCE_S) == 0


def test_a_node_that_was_destroyed_is_not_in_the_graph_any_more(peer):
    """Though something still refers to it, and rclpy's state machine with it."""
    node = Estimator(cli_args=['--ros-args', '--params-file', str(CONFIG),
                               '-r', '__node:=brief'])
    peer.until(lambda: 'brief' in peer.node.get_node_names())
    node.destroy_node()
    peer.until(lambda: 'brief' not in peer.node.get_node_names())


MANAGED = {'recorder': topics.IMU, 'estimator': topics.IMU, 'centroid_extractor': topics.IMAGES,
           'star_identifier': topics.SPOTS, 'intrinsics_estimator': topics.IMU}


@pytest.mark.parametrize('names', [*(pytest.param((name,), marks=pytest.mark.slow)
                                     for name in MANAGED), tuple(MANAGED)],
                         ids=lambda names: names[0] if len(names) == 1 else 'composed')
def test_running_node_goes_through_all_transitions_twice(start_once, peer, names, tmp_path):
    """Readings arrive all the while: the loop may be amid them when a transition ends them."""
    output, space = tmp_path / 'run.mcap', f'/all_{len(names)}_{names[0]}'
    program, words = (names[0], ()) if len(names) == 1 else ('composed', names)
    process = start_once(program, '--params-file', str(CONFIG), '-r', f'__ns:={space}',
                         '-p', f'recorder.output:={output}', names=words)
    stream = peer.node.create_publisher(Imu, f'{space}/imu/data_raw', 10)

    def publish():
        with suppress(RuntimeError):    # a node that is busy with a transition takes none
            stream.publish(Imu())

    timer = peer.node.create_timer(0.002, publish)
    steps = [(Transition.TRANSITION_DEACTIVATE, 'inactive'),
             (Transition.TRANSITION_ACTIVATE, 'active'),
             (Transition.TRANSITION_DEACTIVATE, 'inactive'),
             (Transition.TRANSITION_CLEANUP, 'unconfigured'),
             (Transition.TRANSITION_CONFIGURE, 'inactive'),
             (Transition.TRANSITION_ACTIVATE, 'active')]
    for round_, name in ((round_, name) for round_ in range(2) for name in names):
        listened = f'{space}/{MANAGED[name].name}'
        for transition, reached in steps:
            node = f'{space}/{name}'
            if name == 'recorder' and transition == Transition.TRANSITION_CONFIGURE:
                output.rename(tmp_path / f'{round_}.mcap')      # it would not overwrite it
            assert change(peer, node, transition), (name, reached)
            assert state(peer, node) == reached
            if len(names) == 1:
                peer.until(lambda: peer.node.count_subscribers(listened) == (reached == 'active'))
    for name in names:
        assert change(peer, f'{space}/{name}', Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert process.wait(PATIENCE_S) == 0, process.stderr.read()
    peer.node.destroy_timer(timer)
    peer.node.destroy_publisher(stream)


def test_recorder_is_told_where_to_record_next(start_once, peer, tmp_path):
    files = [tmp_path / f'{k}.mcap' for k in range(3)]
    process = start_once('recorder', '-p', f'recorder.output:={files[0]}', '-r', '__node:=next')
    for file in files[1:]:
        request = SetParameters.Request(parameters=[
            Parameter('recorder.output', value=str(file)).to_parameter_msg()])
        assert peer.call(SetParameters, 'next/set_parameters', request).results[0].successful
        assert not file.exists()            # the recording goes on where it began
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP,
                           Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert change(peer, 'next', transition)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 0
    for file in map(McapFile, files):
        assert file.finished
        carried = parameter_file.parse(file.attachments['config.yaml'].decode(), 'attachment')
        assert carried.recorder.output == str(file.path)


def test_subscription_that_has_ended_has_nothing_more_to_take(peer):
    heard = []
    subscription = MatchedSubscription(peer.node, Imu, 'ended', heard.append, raw=True)
    publisher = peer.node.create_publisher(Imu, 'ended', 10)
    peer.until(lambda: subscription.publishers)
    publisher.publish(Imu())
    peer.until(lambda: heard)
    subscription.destroy()
    publisher.publish(Imu())
    subscription.take_all()
    assert subscription.look_again() == 0 and len(heard) == subscription.received == 1


def test_what_is_not_used_up_long_after_a_stop_is_dropped_and_counted(peer, monkeypatch, capfd):
    heard = []
    subscription = MatchedSubscription(peer.node, Imu, 'slow', heard.extend, raw=True, at_once=2)
    publisher = peer.node.create_publisher(Imu, 'slow', 10)
    peer.until(lambda: subscription.publishers and publisher.get_subscription_count())
    for _ in range(5):
        publisher.publish(Imu())
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))
    monkeypatch.setattr(run_loop, 'seconds_since_stop', lambda: BACKLOG_S + 1.0 if heard else 0.0)
    subscription.take_all()
    assert len(heard) == 2
    assert '/slow: 3 messages that have come are not used' in capfd.readouterr().err
    subscription.destroy()


# A node whose transition fails; argv: the step, the error.
FAILING = """
import sys
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.run_loop import run
from starcal_ros.config.parameter import ConfigError


class Failing(ManagedNode):
    def __init__(self):
        super().__init__('failing')
        setattr(self, sys.argv[1], self.fail)
        self.start()
        print('started', flush=True)

    def fail(self):
        raise {'ConfigError': ConfigError, 'Defect': ZeroDivisionError}[sys.argv[2]]('told')


sys.exit(run(Failing, sys.argv[:1]))
"""


@pytest.mark.parametrize('step', ['configure', 'activate', 'deactivate'])
@pytest.mark.parametrize('error, status', [('ConfigError', 2), ('Defect', 1)])
def test_error_in_a_transition_is_not_swallowed(step, error, status):
    process = subprocess.Popen([sys.executable, '-c', FAILING, step, error], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if step == 'deactivate':
        assert process.stdout.readline() == 'started\n'
        process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == status
    assert errors.strip().splitlines()[-1] == (
        'error: told' if status == 2 else 'ZeroDivisionError: told')
    assert ('Traceback' in errors) == (status == 1)


# A node that fails in whatever it is asked to do.
FALLIBLE = """
import sys
from std_srvs.srv import Trigger
from starcal_ros.messages import topics
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.run_loop import run


class Fallible(ManagedNode):
    def __init__(self):
        super().__init__('fallible')
        self.recovered = 0
        self.start()

    def configure(self):
        self.serve(Trigger, '~/fail', lambda request: 1 / 0)
        self.serve(Trigger, '~/recovered', lambda request: (True, str(self.recovered)))

    def activate(self):
        self.listen(topics.IMU, lambda batch: batch[0].nothing, at_once=1)
        self.repeat(0.05, self.tick)

    def tick(self):
        raise LookupError('nothing there')

    def recover(self):
        self.recovered += 1


sys.exit(run(Fallible))
"""


def test_error_in_a_callback_or_a_service_does_not_end_a_node(peer):
    process = subprocess.Popen([sys.executable, '-c', FALLIBLE], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for _ in range(3):
        answer = peer.call(Trigger, 'fallible/fail')
        assert not answer.success
        assert answer.message == 'error in the node: ZeroDivisionError: division by zero'
    peer.until(lambda: peer.gyro.get_subscription_count() == 1)
    before = int(peer.call(Trigger, 'fallible/recovered').message)
    for _ in range(20):
        peer.gyro.publish(Imu())
    peer.until(lambda: int(peer.call(Trigger, 'fallible/recovered').message) >= before + 20)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 0 and 'Traceback' not in said
    for text in ('error in ~/fail, the node goes on: ZeroDivisionError',
                 '3 times: error in ~/fail',
                 'error in tick, the node goes on: LookupError: nothing there',
                 "error in imu/data_raw, the node goes on: AttributeError: 'bytes' object has no"):
        assert said.count(text) == 1, said


def test_what_is_repeated_may_begin_before_its_first_period(peer):
    """Whoever asks how a node is need not wait for that."""
    class Ticking(ManagedNode):
        def __init__(self):
            super().__init__('ticking')
            self.ticks = 0
            self.start()

        def activate(self):
            self.repeat(1000.0, self.tick, 0.01)

        def tick(self):
            self.ticks += 1

    node = Ticking()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for _ in range(1000):
        if node.ticks:
            break
        executor.spin_once(timeout_sec=0.1)
    (timer,), before = node._running, node.ticks
    assert before == 1 and timer.timer_period_ns == 1000 * 10**9 and not timer.is_canceled()
    node.trigger_deactivate()
    assert not node._running
    executor.shutdown()
    node.destroy_node()
