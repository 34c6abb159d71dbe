# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which settings of the middleware the nodes of the suite start with."""

import os
from pathlib import Path
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from starcal_ros.config import middleware
from starcal_ros.config.shipped import config_file

VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


@pytest.fixture(autouse=True)
def no_settings(monkeypatch, tmp_path):
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nonexistent:{tmp_path}')
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize('package, variable, name', [
    ('fastdds', VARIABLES[0], 'fastdds.xml'), ('fastrtps', VARIABLES[1], 'fastdds_2.xml')])
def test_settings_are_those_of_the_version_that_is_installed(tmp_path, package, variable, name):
    assert middleware.profile() == {}
    (tmp_path / 'share' / package).mkdir(parents=True)
    assert middleware.profile() == {variable: str(config_file(name))}


@pytest.mark.parametrize('variable', VARIABLES)
def test_settings_of_the_user_stay(tmp_path, monkeypatch, variable):
    (tmp_path / 'share' / 'fastdds').mkdir(parents=True)
    with monkeypatch.context() as patch:
        patch.setenv(variable, '/mine.xml')
        assert middleware.profile() == {}
    (tmp_path / 'DEFAULT_FASTDDS_PROFILES.xml').touch()
    assert middleware.profile() == {}


def test_both_versions_are_set_alike():
    """But for the one name that changed."""
    new, old = (ET.canonicalize(from_file=config_file(name), with_comments=False)
                for name in ('fastdds.xml', 'fastdds_2.xml'))
    assert new.replace('heartbeat_period', 'heartbeatPeriod') == old


def test_the_middleware_that_is_installed_takes_its_settings(monkeypatch):
    """It would tell each name that it does not know on stderr, and pass over the whole file."""
    pytest.importorskip('rclpy')
    monkeypatch.undo()
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    environment = middleware.profile()
    assert environment
    source = ('import rclpy; from std_msgs.msg import Empty; rclpy.init(); '
              'rclpy.create_node("x").create_publisher(Empty, "t", 1); rclpy.shutdown()')
    done = subprocess.run([sys.executable, '-c', source], env={**os.environ, **environment},
                          capture_output=True, text=True, timeout=60, cwd=Path(__file__).parent)
    assert (done.returncode, done.stderr) == (0, '')
