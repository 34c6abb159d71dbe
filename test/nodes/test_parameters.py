# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What `ros2 param` asks of each node, with the requests that it makes."""

from array import array
import json
import signal

import pytest

rclpy = pytest.importorskip('rclpy')

from rcl_interfaces.msg import ParameterType  # noqa: E402
from rcl_interfaces.srv import (DescribeParameters, GetParameters, ListParameters,  # noqa: E402
                                SetParameters)
from rclpy.parameter import (Parameter, parameter_dict_from_yaml_file,  # noqa: E402
                             parameter_value_to_python)
import yaml  # noqa: E402

from instruments import CONFIG, TAN2018  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.nodes.composed import NODES  # noqa: E402
from starcal_ros.simulation.write_recording import simulate  # noqa: E402

CAMERA = parameter_file.load(CONFIG).camera
OWN = {'recorder': 'recorder.topics', 'player': 'player.topics'}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bag') / 'run.mcap'
    simulate(TAN2018.replace({'simulation.duration_s': 1.0}), path)
    return path


def dump(peer, node):
    """Return the parameters of a node as `ros2 param dump` gets them: names, then all values."""
    names = sorted(peer.call(ListParameters, f'{node}/list_parameters').result.names)
    values = peer.call(GetParameters, f'{node}/get_parameters',
                       GetParameters.Request(names=names)).values
    assert len(values) == len(names)
    return {name: value for name, value in zip(names, values)}


def put(peer, node, *given):
    """Set parameters one by one; return the results."""
    return put_messages(peer, node, [each.to_parameter_msg() for each in given])


def put_messages(peer, node, messages):
    """Set parameters one by one, given as messages; return the results."""
    request = SetParameters.Request(parameters=messages)
    return peer.call(SetParameters, f'{node}/set_parameters', request).results


def load(peer, node, values, folder):
    """Set what `ros2 param dump` writes as `ros2 param load` does; return the results."""
    file = folder / 'dump.yaml'
    file.write_text(yaml.dump({f'/{node}': {'ros__parameters': values}}))
    return put_messages(peer, node, [*parameter_dict_from_yaml_file(
        str(file), target_nodes=[node]).values()])


@pytest.mark.slow
@pytest.mark.parametrize('name', NODES)
def test_all_parameters_are_dumped_described_loaded_and_started_with(
        start, peer, bag, name, tmp_path):
    words = ('-p', f'player.bag:={bag}', '-p', f'recorder.output:={tmp_path}/run.mcap',
             '-p', 'player.wait_for_subscribers:=9', '-p', 'simulation.wait_for_subscribers:=9',
             '-p', f'estimator.calibration_directory:={tmp_path}')
    process = start(name, '--params-file', str(CONFIG), *words, '-r', '__node:=first')
    first = dump(peer, 'first')
    assert ParameterType.PARAMETER_NOT_SET not in {value.type for value in first.values()}
    described = peer.call(DescribeParameters, 'first/describe_parameters',
                          DescribeParameters.Request(names=list(first))).descriptors
    assert [each.type for each in described] == [value.type for value in first.values()]
    values = {key: parameter_value_to_python(value) for key, value in first.items()}
    values = {key: list(value) if isinstance(value, (list, array)) else value
              for key, value in values.items()}
    for each in load(peer, 'first', values, tmp_path):
        assert each.successful, each.reason
    if name in OWN:                             # YAML does not tell the type of an empty list
        assert values[OWN[name]] == []
        assert put(peer, 'first', Parameter(OWN[name], Parameter.Type.BOOL_ARRAY, []))[
            0].successful
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 0
    (tmp_path / 'run.mcap').unlink(missing_ok=True)
    file = tmp_path / 'dumped.yaml'
    # In JSON, which is YAML: `ros2 param dump` writes the axis y bare, which rcl takes for a bool.
    file.write_text(json.dumps({'/**': {'ros__parameters': values}}))
    again = start(name, '--params-file', str(file), '-r', '__node:=second')
    assert dump(peer, 'second') == first
    again.send_signal(signal.SIGINT)
    assert again.wait(PATIENCE_S) == 0


def test_name_that_can_not_be_set_is_answered_with_the_nearest_one(start, peer):
    start('estimator', '--params-file', str(CONFIG))
    answers = put(peer, 'estimator', Parameter('estimator.gate_probabilty', value=0.9),
                  Parameter('truth.gyro.bias_deg_h', value=[1.0, 1.0, 1.0]),
                  Parameter('camera.focal_length_mm', value=1.0),
                  Parameter('estimator.gate_probability', value=0.9),
                  Parameter('estimator.gate_probability', value='99e-2'),   # as from a terminal
                  Parameter('camera.distortion', value=str([0, *CAMERA.distortion[1:]])),
                  Parameter('estimator.gate_probability', value='likely'),
                  Parameter('use_sim_tme', value=True))
    assert [each.successful for each in answers] == [False] * 3 + [True] * 3 + [False] * 2
    assert dump(peer, 'estimator')['estimator.gate_probability'].double_value == 0.99
    assert answers[0].reason.endswith(
        'unknown parameter; did you mean estimator.gate_probability?')
    assert answers[1].reason.startswith('truth.gyro.bias_deg_h: this node has no value of it')
    assert 'read-only' in answers[2].reason
    assert answers[-1].reason.endswith('did you mean use_sim_time?')
