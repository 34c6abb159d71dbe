# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""No other machine reaches the nodes of the demo and the tests."""

import ipaddress
import os
import socket
import subprocess

import psutil
import pytest

rclpy = pytest.importorskip('rclpy')

from instruments import TAN2018  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.workflows import live_run  # noqa: E402

NODES = ('recorder', 'estimator', 'star_tracker_sim', 'gyro_sim')


def open_to_others(pid):
    """Return the addresses that sockets of a process are bound to, those of loopback left out.

    Linux delivers to a socket bound to 127.0.0.1 nothing that comes from another machine, and no
    multicast; what such a socket sends leaves the machine neither.
    """
    bound = [door.laddr for door in psutil.Process(pid).net_connections('inet')]
    assert bound, 'no socket at all: nothing is shown'
    return [f'{address.ip}:{address.port}' for address in bound
            if not ipaddress.ip_address(address.ip).is_loopback]


def test_an_open_door_is_seen():
    for family, address in ((socket.AF_INET, '0.0.0.0'), (socket.AF_INET, '239.255.0.1'),
                            (socket.AF_INET6, '::')):
        with socket.socket(family, socket.SOCK_DGRAM) as door:
            door.bind((address, 0))
            assert f'{address}:{door.getsockname()[1]}' in open_to_others(os.getpid())


@pytest.mark.skipif(os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST',
                    reason='another middleware than Fast DDS, or settings of the user')
def test_nodes_talk_to_each_other_and_to_nobody_else(tmp_path, peer):
    """The four of the demo, started as it starts them, and a subscriber in this process."""
    scenario = TAN2018.replace({
        'recorder.output': str(tmp_path / 'run.mcap'), 'estimator.wait_for_subscribers': 1,
        'simulation.wait_for_subscribers': 2, 'simulation.real_time_factor': 1.0})
    (tmp_path / 'demo.yaml').write_text(parameter_file.dump(scenario))
    nodes = []
    try:
        for name in NODES:
            nodes.append(subprocess.Popen(
                live_run.node_command(name, {}, tmp_path / 'demo.yaml'),
                env={**os.environ, **live_run.isolated()}, stderr=subprocess.DEVNULL))
        peer.until(lambda: len(peer.states) >= 2)
        for pid in (os.getpid(), *(node.pid for node in nodes)):
            assert open_to_others(pid) == []
    finally:
        for node in nodes:
            node.kill()
            node.wait()
