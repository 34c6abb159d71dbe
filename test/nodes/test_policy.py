# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The policy for SROS 2 allows each node what it uses, and nothing else."""

import os
import subprocess
import time
import xml.etree.ElementTree as ET

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.node import Node  # noqa: E402

from instruments import TAN2018  # noqa: E402
from starcal_ros.config.shipped import config_file  # noqa: E402
from starcal_ros.messages import topics  # noqa: E402
from starcal_ros.nodes.base.ending import TOPIC as ENDING  # noqa: E402
from starcal_ros.nodes.base.qos import message_type  # noqa: E402
from starcal_ros.nodes.composed import NODES  # noqa: E402
from starcal_ros.simulation.write_recording import simulate  # noqa: E402
from starcal_ros.workflows.live_run import node_command  # noqa: E402

PATIENCE_S = 100.0
SUITE = {topic.recorded for topic in topics.TOPICS}
OF_ROS = {'/rosout', '/parameter_events', '/clock'}
ABSENT = {topic.recorded for topic in topics.TOPICS if message_type(topic.type_name) is None}
MAKER = {topics.TRANSFORM.recorded: 'estimator', topics.MARKERS.recorded: 'display',
         topics.ANNOTATIONS.recorded: 'display'}
"""Who publishes results whose types may be absent."""
ALIKE = {'images': 'star_tracker_sim'}      # the same node with other parameters
DOES = {'topics': {'publish', 'subscribe'}, 'services': {'reply', 'request'}}


def full(name, node):
    """Return the full name of a topic or a service of a node in the root namespace."""
    return f'/{node}{name[1:]}' if name.startswith('~') else '/' + name.lstrip('/')


@pytest.fixture(scope='module')
def policy():
    """Return what is allowed: {node: {'publish': names, ...}}."""
    found = {}
    for enclave in ET.parse(config_file('security/starcal.policy.xml')).getroot().iter('enclave'):
        profile, = enclave.iter('profile')
        node, allowed = profile.get('node'), {}
        assert (enclave.get('path'), profile.get('ns')) == (f'/starcal/{node}', '/')
        for rules in profile:
            (verb, word), = rules.attrib.items()
            assert verb in DOES[rules.tag] and word == 'ALLOW' and verb not in allowed
            names = [full(each.text, node) for each in rules]
            assert len(names) == len(set(names))
            allowed[verb] = {name for name in names if name != ENDING}
            if node in NODES and verb == 'publish':     # offered while a node ends
                assert ENDING in names
        found[node] = allowed
    return found


def test_all_nodes_have_an_enclave_and_all_their_services(policy):
    assert {*NODES, 'driver', 'operator'} == set(policy)
    assert all(allowed['reply'] == {f'/{node}/*'} for node, allowed in policy.items())
    assert policy['operator']['request'] == {f'/{node}/*' for node in NODES}


def test_no_topic_is_unknown_and_only_its_maker_publishes_a_result(policy):
    for node, allowed in policy.items():
        for verb in ('publish', 'subscribe'):
            assert {name for name in allowed.get(verb, ()) if not name.endswith(
                '/transition_event')} <= SUITE | OF_ROS | {topics.PROGRESS.recorded}, node
    results = {topic.recorded for topic in topics.TOPICS if topic.result}
    for node in ('driver', 'operator', 'player', 'recorder', 'watch', 'gyro_sim',
                 'star_tracker_sim'):
        assert not policy[node]['publish'] & results
    assert policy['operator']['subscribe'] >= SUITE and not policy['operator']['publish'] & SUITE


@pytest.fixture
def graph(tmp_path):
    """Start every node, and publish every topic, so that the recorder hears them all."""
    bag = tmp_path / 'bag.mcap'
    simulate(TAN2018.replace({'simulation.duration_s': 120.0}), bag)
    config = tmp_path / 'parameters.yaml'
    config.write_text('/**:\n  ros__parameters:\n'
                      f'    recorder: {{output: {tmp_path / "run.mcap"}}}\n'
                      f'    player: {{bag: {bag}}}\n'
                      '    simulation: {real_time_factor: 1.0}\n'
                      '    serve: {port: 0}\n')
    together = node_command('composed', {'use_sim_time': True}, config)
    together[4:4] = [name for name in NODES if name != 'player']
    images = node_command('star_tracker_sim', {'use_sim_time': True, 'simulation.images': True},
                          config)
    commands = together, node_command('player', {}, config), [*images, '-r', '__node:=images']
    rclpy.init()
    witness = Node('witness')
    for topic in topics.TOPICS:
        if topic.recorded not in ABSENT:
            witness.create_publisher(message_type(topic.type_name), topic.name, 1)
    started = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                cwd=tmp_path, env=os.environ) for command in commands]
    try:
        yield witness
    finally:
        rclpy.shutdown()
        for process in started:
            process.kill()
            process.wait()


def used(witness, name):
    """Return what a node uses, as `policy` does."""
    node = ALIKE.get(name, name)
    return {verb: {each.replace(f'/{name}/', f'/{node}/') for each, _ in ask(name, '/')}
            for verb, ask in (('publish', witness.get_publisher_names_and_types_by_node),
                              ('subscribe', witness.get_subscriber_names_and_types_by_node),
                              ('reply', witness.get_service_names_and_types_by_node),
                              ('request', witness.get_client_names_and_types_by_node))}


def test_what_the_nodes_use_is_allowed_and_nothing_else(policy, graph):
    def differences():
        present = set(graph.get_node_names())
        uses = {}
        for name in (*NODES, *ALIKE):
            for verb, found in (used(graph, name) if name in present else {}).items():
                uses.setdefault(ALIKE.get(name, name), {}).setdefault(verb, set()).update(found)
        for node in NODES:
            for verb in ('publish', 'subscribe'):
                yield from (f'{node} may {verb} {each} and does not' for each in
                            policy[node].get(verb, set()) - uses.get(node, {}).get(verb, set()))
                yield from (f'{node} does {verb} {each} and may not' for each in
                            uses.get(node, {}).get(verb, set()) - policy[node].get(verb, set()))
            found = uses.get(node, {}).get('reply', {f'no {node}'})
            yield from (f'{node} has a service {each}' for each in found
                        if not each.startswith(f'/{node}/'))
            yield from (f'{node} asks {each}' for each in uses.get(node, {}).get('request', ()))

    # The player publishes what its recording holds: of a simulated one, that without images.
    without = {f'player may publish {topic.recorded} and does not' for topic in (
        topics.IMAGES, topics.SPOTS, topics.TRUE_CENTROIDS)}
    expected = without | {f'{node} may {verb} {name} and does not' for name in ABSENT
                          for node, verb in ((MAKER[name], 'publish'), ('recorder', 'subscribe'))}
    deadline, found = time.monotonic() + PATIENCE_S, None
    while found != expected and time.monotonic() < deadline:
        time.sleep(0.2)
        found = set(differences())
    assert found == expected
