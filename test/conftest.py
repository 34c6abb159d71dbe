# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Keep the nodes of the tests away from every other ROS 2 node and from the user's logs."""

from contextlib import contextmanager
import os
import subprocess
import sys
import tempfile

from hypothesis import settings
import pytest

from starcal_ros.workflows.live_run import isolated

_LOGS = tempfile.TemporaryDirectory(prefix='starcal_ros_test_')

# The same inputs each time: new ones are for bench/fuzz.py.
settings.register_profile('suite', database=None, deadline=None, derandomize=True)
settings.load_profile('suite')
os.environ.update(isolated(), ROS_LOG_DIR=_LOGS.name)


@contextmanager
def _nodes(folder):
    started = []

    def run(name, *words, names=()):
        started.append(subprocess.Popen(
            [sys.executable, '-m', 'starcal_ros.nodes.programs', name, *names, '--ros-args',
             *words], stderr=subprocess.PIPE, text=True, cwd=folder))
        return started[-1]
    try:
        yield run
    finally:
        for process in started:
            if process.poll() is None:
                process.kill()
                process.wait()


@pytest.fixture
def start(tmp_path):
    """Return a function that starts a node; what is left of them is killed at the end."""
    with _nodes(tmp_path) as run:
        yield run


@pytest.fixture(scope='module')
def start_once(tmp_path_factory):
    """Return the same for nodes that all tests of a module share."""
    with _nodes(tmp_path_factory.mktemp('nodes')) as run:
        yield run


@pytest.fixture
def peer():
    """Return a node of this process that talks to those under test."""
    rclpy = pytest.importorskip('rclpy')
    from peer import Peer
    rclpy.init()
    try:
        yield Peer()
    finally:
        rclpy.shutdown()
