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


@pytest.mark.parametrize('package, variable, name', [
    ('fastdds', VARIABLES[0], 'fastdds_loopback.xml'),
    ('fastrtps', VARIABLES[1], 'fastdds_loopback_2.xml')])
def test_nodes_are_closed_with_the_middleware_whose_settings_do_it(
        tmp_path, monkeypatch, package, variable, name):
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    (tmp_path / 'share' / package).mkdir(parents=True)
    kept = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    assert kept.items() <= middleware.loopback().items()        # whose, nobody knows
    (tmp_path / 'share' / 'rmw_fastrtps_cpp').mkdir()
    closed = {'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp', variable: str(config_file(name)),
              'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT'}
    assert middleware.loopback() == closed
    for key, value in closed.items():           # and so are those that closed ones start
        monkeypatch.setenv(key, value)
    assert middleware.loopback() == closed and middleware.profile() == {}
    monkeypatch.delenv(variable)
    with monkeypatch.context() as patch:
        patch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
        assert kept.items() <= middleware.loopback().items()
        patch.setenv('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
        assert middleware.loopback() == closed
        patch.setenv(variable, '/mine.xml')
        assert middleware.loopback() == kept


@pytest.mark.parametrize('name', ['fastdds', 'fastdds_loopback', 'fastdds_demo'])
def test_both_versions_are_set_alike(name):
    """But for the two names that changed."""
    new, old = (ET.canonicalize(from_file=config_file(name + end), with_comments=False)
                for end in ('.xml', '_2.xml'))
    assert new.replace('heartbeat_period', 'heartbeatPeriod').replace(
        'heartbeat_response_delay', 'heartbeatResponseDelay') == old


@pytest.mark.parametrize('name', ['fastdds_loopback.xml', 'fastdds_demo.xml'])
def test_closed_nodes_are_as_quick_as_others(name):
    quick, closed = (ET.parse(config_file(each)).getroot() for each in ('fastdds.xml', name))
    for part in ('initialAnnouncements', 'times'):
        one, two = ([ET.tostring(found) for found in root.iter() if found.tag.endswith(part)]
                    for root in (quick, closed))
        assert one == two and one


@pytest.mark.parametrize('end', ['.xml', '_2.xml'])
def test_the_demo_is_closed_and_has_short_queues(end):
    closed, demo = (ET.parse(config_file(name + end)).getroot()
                    for name in ('fastdds_loopback', 'fastdds_demo'))
    for parent in [*demo.iter()]:
        for part in [*parent]:
            if part.tag.endswith('topic'):
                assert 100 <= int(next(each.text for each in part.iter()
                                       if each.tag.endswith('max_samples'))) <= 300
                parent.remove(part)
    assert ET.canonicalize(ET.tostring(demo), strip_text=True) == ET.canonicalize(
        ET.tostring(closed), strip_text=True)


@pytest.mark.parametrize('name', ['fastdds', 'fastdds_loopback', 'fastdds_demo'])
def test_the_middleware_that_is_installed_takes_its_settings(monkeypatch, name):
    """It would tell each name that it does not know on stderr, and pass over the whole file."""
    pytest.importorskip('rclpy')
    monkeypatch.undo()
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    environment = middleware.profile(name)
    assert environment
    source = ('import rclpy; from std_msgs.msg import Empty; rclpy.init(); '
              'rclpy.create_node("x").create_publisher(Empty, "t", 1); rclpy.shutdown()')
    done = subprocess.run([sys.executable, '-c', source], env={**os.environ, **environment},
                          capture_output=True, text=True, timeout=60, cwd=Path(__file__).parent)
    assert (done.returncode, done.stderr) == (0, '')
