# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process of its own."""

import subprocess

import pytest

from starcal_ros.workflows.node_program import node_command


def test_a_node_is_of_the_package_that_starts_it_wherever_that_is_done(tmp_path):
    """And not of a checkout in the working directory, as `python -m` would have it."""
    pytest.importorskip('rclpy')
    decoy = tmp_path / 'starcal_ros'
    decoy.mkdir()
    (decoy / '__init__.py').write_text('raise SystemExit("of the working directory")\n')
    command = node_command('recorder', {'recorder.no_such': 1})
    done = subprocess.run(command, cwd=tmp_path, text=True, stderr=subprocess.PIPE, timeout=60)
    assert 'of the working directory' not in done.stderr
    assert 'recorder.no_such: unknown parameter' in done.stderr
