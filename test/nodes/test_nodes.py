# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The nodes as processes of their own over real DDS: what goes in comes out, and right."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from rcl_interfaces.srv import DescribeParameters, SetParameters  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import CameraInfo, Imu  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
import yaml  # noqa: E402

from instruments import PITCH_MM, TAN2018, TOP  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.config import middleware, parameter_file, scenario  # noqa: E402
from starcal_ros.core import rotation  # noqa: E402
from starcal_ros.core.units import DEG_PER_SQRT_HOUR  # noqa: E402
from starcal_ros.core.utc import unix_ns  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.measurements.samples import Frames, GyroSamples  # noqa: E402
from starcal_ros.messages import conventions, topics  # noqa: E402
from starcal_ros.recording import reader  # noqa: E402
from starcal_ros.recording.bag import open_bag  # noqa: E402
from starcal_ros.recording.writer import typestore  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.simulation.truth import Truth  # noqa: E402
from starcal_ros.workflows import live_run  # noqa: E402

DURATION_S = 60.0
SCENARIO = TAN2018.replace({
    'simulation.duration_s': DURATION_S, 'simulation.real_time_factor': 0.0})


PROGRESS = []


@pytest.fixture(scope='module')
def live(tmp_path_factory):
    """Return the recording of a run of all four nodes."""
    return live_run.run_live(SCENARIO, tmp_path_factory.mktemp('live'), PROGRESS.append)


@pytest.fixture(scope='module')
def recorded(live):
    return reader.read(live)


@pytest.fixture(scope='module')
def offline(recorded):
    calibrator, _ = calibrate(recorded.gyro, recorded.frames, SCENARIO)
    return calibrator


def messages(path, topic):
    """Return the messages of a topic, decoded."""
    bag = open_bag(path)
    kind = next(t.type for t in bag.topics() if t.name == topic)
    return [typestore().deserialize_cdr(
        part.data[start:start + size].tobytes(), kind)
        for _, _, part, _ in bag.messages([topic])
        for start, size in zip(part.start.tolist(), part.size.tolist())]


# A whole run


def test_progress_is_that_of_the_recording(live):
    assert PROGRESS[-1] == 1.0 and sorted(PROGRESS) == PROGRESS and PROGRESS[0] == 0.0
    start_ns = unix_ns(SCENARIO.simulation.start_utc)
    for part in (0.0, 0.25, 1.0):
        stamp_ns = start_ns + round(part * DURATION_S * 1e9)
        assert live_run.part_over(stamp_ns, SCENARIO) == pytest.approx(part)
    assert live_run.part_over(start_ns + 2**50, SCENARIO) == 1.0       # never more than all


def test_recording_holds_all_that_the_simulators_made_to_the_bit(recorded):
    """The nodes were started apart; the simulators of this process know nothing of them."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    expected = gyro.next(gyro.count)
    np.testing.assert_array_equal(recorded.gyro.stamp_ns, expected.stamp_ns)
    np.testing.assert_array_equal(recorded.gyro.rate, expected.rate)
    expected = tracker.next(tracker.count)
    np.testing.assert_array_equal(recorded.frames.stamp_ns, expected.stamp_ns)
    np.testing.assert_array_equal(recorded.frames.uv_raster, expected.uv_raster)
    np.testing.assert_array_equal(recorded.frames.catalog_id, expected.catalog_id)


def test_live_and_offline_estimates_are_the_same_numbers(live, offline):
    assert live_run.compare(live, offline) < 1e-9


def test_each_frame_gives_one_of_each_result(live):
    counts = {topic.topic: topic.count for topic in reader.summary(live).topics}
    for name in ('state', 'camera_info', 'gyro_bias', 'mounting', 'residuals'):
        assert counts[f'/starcal/{name}'] == 2 * DURATION_S
    assert counts['/diagnostics'] >= 1


def test_log_times_are_the_stamps_that_the_messages_carry(live):
    """In the header, in the data of the state; a status from before the first frame has none."""
    bag = open_bag(live)
    for topic in bag.topics():
        log_times = bag.log_times(topic.name)
        got = messages(live, topic.name)
        if topic.name.endswith('/state'):
            stamps = [round(m.data[0] * 1e6) * 1000 for m in got]
        elif topic.name.endswith('/parameters'):
            continue                # the truth has no stamp
        else:
            stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in got]
        if topic.name == '/diagnostics':
            assert set(stamps) & set(log_times.tolist())
            stamps = [min(stamp, log_time) for stamp, log_time in zip(stamps, log_times)]
        np.testing.assert_array_equal(log_times, stamps, topic.name)


def test_each_gyro_reading_gives_one_attitude_that_agrees_with_the_truth(live, recorded):
    imus = messages(live, '/starcal/imu')
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in imus])
    np.testing.assert_array_equal(stamps, recorded.gyro.stamp_ns)
    C_ig = rotation.to_matrix(np.array([[getattr(m.orientation, c) for c in 'xyzw']
                                        for m in imus]))
    true = Truth.from_scenario(SCENARIO).motion.attitude(stamps)
    phi = rotation.log(true @ np.swapaxes(C_ig, -1, -2))            # T18 Eq. 7
    sigma = np.sqrt(np.array([m.orientation_covariance for m in imus])[:, ::4])
    # 5 sigma: 6000 strongly correlated samples of three axes, a few independent ones a minute
    assert (np.abs(phi) < 5.0 * sigma).all()
    assert {m.header.frame_id for m in imus} == {'gyro'}
    # REP-145: what is not measured has -1, what is has a covariance
    assert {m.linear_acceleration_covariance[0] for m in imus} == {-1.0}
    rate = np.array([m.angular_velocity_covariance for m in imus]).reshape(-1, 3, 3)
    reading = (SCENARIO.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR)**2 * SCENARIO.gyro.rate_hz
    assert (np.linalg.eigvalsh(rate) > reading * (1.0 - 1e-9)).all()
    assert (np.linalg.eigvalsh(rate[-1]) < reading + 1e-12).all()


def test_each_camera_has_a_frame_of_its_own(live):
    """A viewer hangs the image plane on it: two cameras in one frame would be two parents."""
    frames = {topic.topic: {message.header.frame_id for message in messages(live, topic.topic)}
              for topic in reader.summary(live).topics
              if topic.type == topics.CAMERA.type_name}
    assert frames == {'/star_tracker/camera_info': {'star_tracker_optical'},
                      '/starcal/camera_info': {'star_tracker_calibrated_optical'}}


def test_results_are_the_estimate_in_the_conventions_of_ros(live, offline):
    estimate, detector = offline.belief.estimate, offline.filter.detector
    info = messages(live, '/starcal/camera_info')[-1]
    assert (info.distortion_model, info.header.frame_id) == (
        'plumb_bob', 'star_tracker_calibrated_optical')
    np.testing.assert_allclose(conventions.from_camera_info(info.k, info.d, detector),
                               estimate.intrinsics, rtol=1e-9)
    # What image_geometry and image_proc need: five coefficients, nothing rectified, no region.
    K, P = np.reshape(info.k, (3, 3)), np.reshape(info.p, (3, 4))
    np.testing.assert_array_equal(P, np.column_stack((K, np.zeros(3))))
    np.testing.assert_array_equal(np.reshape(info.r, (3, 3)), np.eye(3))
    assert (len(info.d), info.width, info.height) == (5, 1024, 1024)
    assert (info.binning_x, info.binning_y, info.roi.width) == (0, 0, 0)
    q = messages(live, '/starcal/mounting')[-1].pose.pose.orientation
    C_sg = conventions.mounting_from_optical(
        rotation.to_matrix(np.array([q.x, q.y, q.z, q.w])))
    np.testing.assert_allclose(C_sg, estimate.C_sg, atol=1e-12)
    bias = messages(live, '/starcal/gyro_bias')[-1].twist.twist.angular
    np.testing.assert_allclose([bias.x, bias.y, bias.z], estimate.bias, rtol=1e-9)


def test_recording_carries_configuration_and_truth(recorded):
    truth = json.loads(recorded.attachments['truth.json'])
    assert truth['intrinsics']['f_mm'] == 25.6
    np.testing.assert_allclose(truth['mounting']['fixed_angles_deg'], [-0.1, 30.0, -0.2],
                               atol=1e-12)
    carried = parameter_file.parse(recorded.attachments['config.yaml'].decode(), 'attachment')
    assert carried.replace({'recorder.output': 'run.mcap'}) == SCENARIO.replace(
        {'estimator.wait_for_subscribers': 1, 'simulation.wait_for_subscribers': 2,
         'simulation.wait_for_simulators': 1})


# One node at a time


@pytest.fixture
def parameters(tmp_path):
    """Return the words that give a node the scenario."""
    path = tmp_path / 'scenario.yaml'
    path.write_text(parameter_file.dump(SCENARIO.replace({
        'estimator.calibration_directory': str(tmp_path / 'saved')})))
    return '--params-file', str(path)


@pytest.fixture(scope='module')
def readings():
    """The first ten seconds of the run."""
    return sensors.gyro(SCENARIO).next(1000), sensors.star_tracker(SCENARIO).next(20)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_estimator_ends_with_status_0_on_a_signal_amid_its_work(
        start, parameters, peer, readings, number):
    estimator = start('estimator', *parameters)
    peer.meet()
    peer.send(*readings)
    peer.until(lambda: len(peer.states) > 3)
    estimator.send_signal(number)
    peer.until(lambda: estimator.poll() is not None)
    assert estimator.returncode == 0
    assert 'Traceback' not in estimator.stderr.read()


def test_nothing_but_finite_numbers_leaves_the_estimator(start, parameters, peer, readings):
    """NaN, infinity, 1e308, rubbish and an unknown star go in; good frames still count."""
    gyro, frames = readings
    estimator = start('estimator', *parameters)
    peer.meet()
    rate = gyro.rate.copy()
    rate[[100, 101, 500, 700]] = np.array([[np.nan], [np.inf], [-np.inf], [1e308]])
    uv, number = frames.uv_raster.copy(), frames.catalog_id.copy()
    uv[::50] = np.nan
    number[7] = 999_999
    for _ in range(40):
        peer.frames.publish(b'\0\1\0\0' + bytes(20))
    peer.send(GyroSamples(gyro.stamp_ns, rate),
              Frames(frames.stamp_ns, frames.first, uv, frames.sigma, frames.magnitude, number),
              gyro_frame='imu_link')
    peer.until(lambda: len(peer.states) >= 19)
    assert all(np.isfinite(state.data).all() for state in peer.states)
    values = peer.values()
    assert values['dropped_messages'] == '44'
    assert peer.call(Trigger, 'estimator/save_calibration').success
    assert int(values['unusable_stars']) == len(uv[::50]) + 1
    estimator.send_signal(signal.SIGINT)
    said = estimator.communicate(timeout=PATIENCE_S)[1]
    assert estimator.returncode == 0 and 'Traceback' not in said
    for text in ('gyro.largest_rate_deg_s', 'star number 999999 is not in the catalogue',
                 "frame_id 'imu_link', where 'gyro' is expected"):
        assert said.count(text) == 1
    assert 'message dropped' in said and said.count('message dropped') < 10


def test_calibrations_are_saved_undone_and_begun_with(start, parameters, peer, readings, tmp_path):
    gyro, frames = readings
    estimator = start('estimator', *parameters, '-p', 'estimator.load_calibration:=true')
    peer.meet()

    def call(name):
        return peer.call(Trigger, f'estimator/{name}')

    refused = call('save_calibration')
    assert not refused.success and 'no attitude from any frame' in refused.message
    assert 'no saved calibration' in call('undo_save').message
    peer.send(gyro[:851], frames[:18])
    peer.until(lambda: len(peer.states) >= 18)
    for number in (1, 2):
        assert call('save_calibration').message == f'saved as {tmp_path}/saved/000{number}'
    assert call('undo_save').message == f'set aside as {tmp_path}/saved/0002.undone'
    folder = tmp_path / 'saved' / 'latest'
    saved = json.loads((folder / 'result.json').read_text())
    assert saved['counts']['frames'] == 18
    assert saved['provenance']['began_with'] == 'nominal values'
    assert parameter_file.load(folder / 'config.yaml').sha256 == (
        saved['provenance']['config_sha256'])
    camera = yaml.safe_load((folder / 'camera_info.yaml').read_text())
    assert camera['camera_matrix']['data'][0] == pytest.approx(
        saved['intrinsics']['f_mm'] / SCENARIO.camera.pixel_pitch_mm)
    assert call('reset').message == f'started again from {tmp_path}/saved/0001'
    calibration, inputs, check = peer.status()
    assert (check.name, check.message) == ('starcal: check', 'not yet')
    assert calibration.message == 'no attitude yet'
    received = {item.key: item.value for item in inputs.values}['/imu/data_raw messages']
    assert (inputs.name, received) == ('starcal: inputs', '851')
    peer.send(gyro[851:], frames[18:])      # two frames, and as good as after eighteen
    peer.until(lambda: len(peer.states) >= 20)
    values = np.array(peer.states[-1].data)
    sigma = np.sqrt(values[17:].reshape(16, 16).diagonal())
    assert (sigma[9:] <= np.sqrt(np.diagonal(saved['covariance']))[9:] * (1.0 + 1e-6)).all()
    disable = SetBool.Request(data=False)
    assert peer.call(SetBool, 'estimator/set_enabled', disable).success
    assert peer.status()[0].message == 'disabled'
    estimator.send_signal(signal.SIGINT)
    assert 'has no calibration: beginning with the nominal values' in estimator.communicate(
        timeout=PATIENCE_S)[1]


def test_parameters_are_described_and_gates_and_noise_may_change(start, parameters, peer):
    """And what the middleware can not match is said in words."""
    estimator = start('estimator', *parameters)
    own = {name: parameter for name, parameter in scenario.parameters().items()
           if name.split('.')[0] in ('autostart', 'camera', 'gyro', 'mounting', 'observer',
                                     'estimator')}
    described = peer.call(DescribeParameters, 'estimator/describe_parameters',
                          DescribeParameters.Request(names=list(own))).descriptors
    for descriptor, parameter in zip(described, own.values()):
        assert parameter.spec.text in descriptor.description
        assert f'[{parameter.spec.unit}]' in descriptor.description or not parameter.spec.unit
        assert descriptor.read_only != parameter.spec.changeable
        if parameter.element in (int, float):
            assert (descriptor.floating_point_range or descriptor.integer_range
                    or 'each' in descriptor.additional_constraints)

    def change(name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value
                                                              ).to_parameter_msg()])
        return peer.call(SetParameters, 'estimator/set_parameters', request).results[0]

    assert change('estimator.gate_probability', 0.99).successful
    assert change('estimator.process_noise.gyro_bias_deg_h_sqrt_h', 0.1).successful
    for name, value in (('estimator.gate_probability', 2.0), ('estimator.gate_probability', 1),
                        ('estimator.gate_probability', float('nan')),
                        ('camera.focal_length_mm', 25.0), ('estimator.gate', 0.9)):
        answer = change(name, value)
        assert not answer.successful and answer.reason
    peer.listen(Imu, 'starcal/imu', QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    peer.listen(CameraInfo, 'starcal/camera_info', QoSProfile(
        depth=1, deadline=Duration(seconds=1)))
    lines = iter(estimator.stderr)
    assert 'for more than is offered (durability' in next(
        line for line in lines if '/starcal/imu: a subscriber' in line)
    assert 'for more than is offered (deadline' in next(
        line for line in lines if '/starcal/camera_info: a subscriber' in line)


def test_example_waits_for_a_calibration_that_may_be_trusted(start, parameters, peer):
    """The model has to be tested in twenty frames that are certain enough."""
    loose = [word for name, value in (
        ('gyro_bias_deg_h', 10.0), ('fixed_angles_arcsec', 1e4), ('principal_point_px', 100.0),
        ('focal_length_mm', 0.15), ('k1', 0.1), ('k2', 0.1), ('p1', 0.1), ('p2', 0.1))
        for word in ('-p', f'estimator.tolerance.{name}:={value}')]
    start('estimator', *parameters, *loose)
    example = subprocess.Popen(
        [sys.executable, TOP / 'examples' / 'trusted_camera.py'],
        stdout=subprocess.PIPE, text=True)
    try:
        peer.meet()
        assert example.stdout.readline() == 'no attitude yet\n'
        peer.send(sensors.gyro(SCENARIO).next(2000), sensors.star_tracker(SCENARIO).next(40))
        lines = example.communicate(timeout=PATIENCE_S)[0].splitlines()
    finally:
        example.kill()
    assert example.returncode == 0 and lines[-4] == 'converged'
    fx, fy = (float(word) for word in lines[-3].split()[-2:])
    # 25.6 mm in truth, to within the tolerance
    assert fx == fy == pytest.approx(25.6 / PITCH_MM, abs=0.15 / PITCH_MM)


@pytest.mark.parametrize('words, culprit', [
    (['-p', 'camera.focal_lenght_mm:=25.0'], 'did you mean camera.focal_length_mm'),
    (['-p', 'camera.focal_length_mm:=-25.0'], 'camera.focal_length_mm: got -25.0'),
    (['-p', 'camera.focal_length_mm:=25'], 'camera.focal_length_mm: got 25 (int)'),
    (['--params-file', 'missing.yaml'], 'missing.yaml'),
])
@pytest.mark.parametrize('name', ['estimator', 'gyro_sim'])
def test_wrong_parameter_ends_a_node_with_status_2_and_one_line(start, name, words, culprit):
    node = start(name, *words)
    said = node.communicate(timeout=PATIENCE_S)[1]
    assert node.returncode == 2
    assert 'Traceback' not in said
    last = said.strip().splitlines()[-1]
    assert last.startswith('error: ') and culprit in last


def test_replay_gives_the_estimator_the_same_numbers_again(start, parameters, live, tmp_path):
    """The player leaves the old results out; the new ones are compared with them."""
    copy = tmp_path / 'copy.mcap'
    recorder = start('recorder', *parameters, '-p', f'recorder.output:={copy}')
    estimator = start('estimator', *parameters)
    player = start('player', '-p', f'player.bag:={live}', '-p', 'player.rate:=0.0',
                   '-p', 'player.wait_for_subscribers:=2')
    for process in (player, estimator, recorder):
        if process is not player:
            process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    np.testing.assert_array_equal(live_run.last_state(copy), live_run.last_state(live))


def test_simulation_ends_in_the_same_way_without_anyone_listening(start, parameters):
    assert start('star_tracker_sim', *parameters).wait(PATIENCE_S) == 0
    assert start('gyro_sim', *parameters).wait(PATIENCE_S) == 0


@pytest.mark.slow
def test_real_time_factor_sets_the_pace(start, parameters):
    """Ten times real time: six seconds for a minute; a start takes less than ten."""
    begin = time.monotonic()
    assert start('gyro_sim', *parameters, '-p', 'simulation.real_time_factor:=10.0'
                 ).wait(PATIENCE_S) == 0
    assert time.monotonic() - begin >= DURATION_S / 10.0


def test_test_processes_meet_only_each_other():
    assert middleware.loopback().items() <= os.environ.items()
    assert 1 <= int(os.environ['ROS_DOMAIN_ID']) <= 100
