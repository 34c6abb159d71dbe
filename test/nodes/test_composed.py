# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All nodes in one process, and two estimators side by side in two namespaces."""

import json
from pathlib import Path
import signal
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from std_srvs.srv import Trigger  # noqa: E402

from instruments import TAN2018, TOP  # noqa: E402
from peer import PATIENCE_S, Peer  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.core import rotation  # noqa: E402
from starcal_ros.core.units import ARCSEC, DEG  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.nodes import programs  # noqa: E402
from starcal_ros.nodes.composed import NODES, node_class  # noqa: E402
from starcal_ros.recording import reader  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.workflows import live_run  # noqa: E402

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 60.0, 'simulation.real_time_factor': 0.0,
    'estimator.wait_for_subscribers': 1, 'simulation.wait_for_subscribers': 2,
    'simulation.wait_for_simulators': 1})


def test_every_node_is_a_program_that_is_installed():
    setup = (TOP / 'setup.py').read_text()
    modules = Path(programs.__file__).parent.glob('*.py')
    assert {*NODES, 'composed'} == {
        path.stem for path in modules if '\ndef main(' in path.read_text()}
    for name in (*NODES, 'composed'):
        assert callable(getattr(programs, name)), name
        assert f"'{name}': 'starcal_ros.nodes.programs:{name}'" in setup


def test_all_nodes_in_one_process_lose_nothing_as_fast_as_they_go(start, tmp_path):
    """Publishers and subscribers share a thread: one that waited for another would hang."""
    config, recording = tmp_path / 'config.yaml', tmp_path / 'run.mcap'
    config.write_text(parameter_file.dump(SCENARIO.replace({'recorder.output': str(recording)})))
    process = start('composed', '--params-file', str(config),
                    names=('gyro_sim', 'star_tracker_sim', 'estimator', 'recorder'))
    assert any(line.rstrip().endswith(' 100 %') for line in process.stderr)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    read = reader.read(recording)
    np.testing.assert_array_equal(read.gyro.rate, sensors.gyro(SCENARIO).next(6000).rate)
    assert len(read.frames) == 120
    calibrator, _ = calibrate(read.gyro, read.frames, SCENARIO)
    assert live_run.compare(recording, calibrator) < 1e-9
    counts = {topic.topic: topic.count for topic in reader.summary(recording).topics}
    assert (counts['/starcal/imu'], counts['/starcal/state']) == (6000, 120)


@pytest.mark.parametrize('names, said', [((), 'got no node'), (('estimater',), 'got estimater')])
def test_composed_says_which_nodes_there_are(start, names, said):
    process = start('composed', names=names)
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2
    assert said in errors and 'star_tracker_sim' in errors


def test_every_node_can_be_composed():
    nodes = {path.stem for path in (TOP / 'starcal_ros' / 'nodes').glob('*')
             if path.suffix == '.py' and 'run_loop.run(' in path.read_text()}
    assert set(NODES) == nodes
    assert all(issubclass(node_class(name), rclpy.node.Node) for name in NODES)


@pytest.fixture
def context():
    rclpy.init()
    yield
    rclpy.shutdown()


def test_two_estimators_in_two_namespaces_know_nothing_of_each_other(start, context, tmp_path):
    """One on a body that is turned by 5 deg; each saves its calibration in its own place."""
    turn = rotation.exp(5.0 * DEG * np.array([0.6, 0.0, 0.8]))
    alone = SCENARIO.replace({'estimator.wait_for_subscribers': 0,
                              'estimator.calibration_directory': str(tmp_path / 'saved')})
    scenarios = {'left': alone, 'right': alone.replace({
        'motion.initial_quaternion_xyzw': tuple(rotation.to_quaternion(turn).tolist())})}
    (tmp_path / 'config.yaml').write_text(parameter_file.dump(alone))
    peers, readings = {}, {}
    for name, scenario in scenarios.items():
        start('estimator', '--params-file', str(tmp_path / 'config.yaml'),
              '-r', f'__ns:=/{name}', '-r', '/tf_static:=tf_static')
        peers[name] = Peer(name)
        readings[name] = sensors.gyro(scenario).next(501), sensors.star_tracker(scenario).next(11)
    for name, peer in peers.items():
        peer.meet()
        peer.send(*readings[name])
    for name, peer in peers.items():
        peer.until(lambda: len(peer.states) >= 11)
        assert peer.call(Trigger, 'estimator/save_calibration').success
        assert peer.status()[0].name == f'{name}/starcal: calibration'
        saved = json.loads((tmp_path / 'saved' / name / '0001' / 'result.json').read_text())
        assert saved['counts']['frames'] == len(peer.states) == 11
    # Orientations of gyro in icrf: seen from there, one is the other one turned.
    left, right = (rotation.exp(np.array(peers[name].states[-1].data[1:4]))
                   for name in ('left', 'right'))
    initial = rotation.to_matrix(np.array(alone.motion.initial_quaternion_xyzw))
    # The nominal mounting is wrong by 374 arcsec, and both attitudes with it for a while.
    np.testing.assert_allclose(right @ left.T, turn @ initial.T, atol=2 * 374.0 * ARCSEC)
