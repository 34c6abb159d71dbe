# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes begin and end cleanly, in their own processes."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip('rclpy')

from starcal_ros.nodes.composed import NODES  # noqa: E402

START = """
import sys
from pathlib import Path
import rclpy
from rclpy.node import Node
from starcal_ros.config.parameter import ConfigError
from starcal_ros.nodes.base.run_loop import run, steady_timer


class Subject(Node):
    finished = False

    def __init__(self):
        super().__init__('subject')
        self.ticks = 0
        steady_timer(self, 0.01, self.tick)
        print('ready', flush=True)

    def tick(self):
        {tick}

    def close(self):
        print('closed', flush=True)


sys.exit(run({make}))
"""


def start(tick: str = 'pass', make: str = 'Subject', *args: str) -> subprocess.Popen:
    """Start a process that runs one node."""
    return subprocess.Popen([sys.executable, '-c', START.format(tick=tick, make=make), *args],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def start_where_a_hangup(does) -> subprocess.Popen:
    """Start it as from a shell (SIG_DFL) or under `nohup` (SIG_IGN), whatever this runs under."""
    before = signal.signal(signal.SIGHUP, does)
    try:
        return start()
    finally:
        signal.signal(signal.SIGHUP, before)


def finish(process: subprocess.Popen) -> tuple[int, str, str]:
    """Return exit status, output and errors, less what the middleware logs about itself."""
    try:
        out, errors = process.communicate(timeout=20)
    finally:
        process.kill()
    return process.returncode, out, re.sub(r'^\[\w+\] \[[\d.]+\] \[rmw.*\n', '', errors,
                                           flags=re.MULTILINE)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP] * 2)
def test_signal_closes_the_node_and_ends_with_status_0(number):
    process = start_where_a_hangup(signal.SIG_DFL)
    assert process.stdout.readline() == 'ready\n'
    process.send_signal(number)
    assert finish(process) == (0, 'closed\n', '')


def test_a_hangup_that_is_ignored_from_outside_stays_ignored():
    process = start_where_a_hangup(signal.SIG_IGN)
    assert process.stdout.readline() == 'ready\n'
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert finish(process) == (0, 'closed\n', '')


def test_further_signals_do_no_harm():
    process = start()
    assert process.stdout.readline() == 'ready\n'
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)
    assert finish(process) == (0, 'closed\n', '')


@pytest.mark.parametrize('delay_s', [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5])
def test_interrupt_while_a_node_is_imported_ends_it(delay_s, tmp_path):
    script = tmp_path / 'node.py'
    script.write_text('import sys\nfrom starcal_ros.nodes import programs\n'
                      'print("started", flush=True)\nsys.exit(programs.gyro_sim())\n')
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True,
                               env={**os.environ, 'PYTHONPATH': os.getcwd()})
    assert process.stdout.readline() == 'started\n'
    time.sleep(delay_s)
    process.send_signal(signal.SIGINT)
    status, _, errors = finish(process)
    assert status in (0, -signal.SIGINT)
    assert not any(word in errors for word in ('Traceback', 'KeyboardInterrupt', 'error'))


def test_finished_node_ends_with_status_0():
    process = start(tick='self.ticks += 1; self.finished = self.ticks == 5')
    assert finish(process) == (0, 'ready\nclosed\n', '')


def fail(text: str) -> str:
    """Return an expression that raises."""
    return f'(_ for _ in ()).throw({text})'


@pytest.mark.parametrize('when', ['creation', 'service'])
def test_configuration_error_is_one_line_and_status_2(when):
    error = fail('ConfigError("gyro.rate_hz: got 0.0")')
    process = (start(make=f'lambda: {error}') if when == 'creation' else start(tick=error))
    status, out, errors = finish(process)
    assert (status, errors) == (2, 'error: gyro.rate_hz: got 0.0\n')
    assert ('closed' in out) == (when == 'service')


def test_missing_parameter_file_is_named_without_traceback():
    words = ('--ros-args', '--params-file', 'none.yaml')
    status, _, errors = finish(start('pass', 'Subject', *words))
    assert status == 2
    assert 'none.yaml' in errors and 'Traceback' not in errors


def test_where_security_is_asked_for_and_not_to_be_had_no_node_runs(tmp_path, monkeypatch):
    """Neither without plugins, as in the wheels of PyPI, nor without an enclave."""
    (tmp_path / 'enclaves').mkdir()
    for name, value in (('ENABLE', 'true'), ('STRATEGY', 'Enforce'), ('KEYSTORE', tmp_path)):
        monkeypatch.setenv(f'ROS_SECURITY_{name}', str(value))
    status, out, errors = finish(start())
    assert (status, out) == (2, '')
    assert re.search(r'^error: .*security', errors, re.M | re.I) and 'Traceback' not in errors


@pytest.mark.parametrize('words, said', [(['tan2018.yaml'], 'got tan2018.yaml'),
                                         (['--rate', '2'], 'got --rate 2')])
def test_arguments_that_no_node_knows_are_refused_and_the_right_ones_named(words, said):
    status, out, errors = finish(start('pass', 'Subject', *words))
    assert (status, out) == (2, '')
    assert said in errors and '--params-file' in errors and errors.count('\n') == 1


@pytest.mark.parametrize('word', ['-h', '--help'])
@pytest.mark.parametrize('name', [*NODES, 'composed'])
def test_every_program_has_help(name, word, tmp_path):
    # Elsewhere: a checkout has not compiled what is installed.
    process = subprocess.run([sys.executable, '-m', 'starcal_ros.nodes.programs', name, word],
                             capture_output=True, text=True, timeout=20, cwd=tmp_path)
    assert (process.returncode, process.stderr) == (0, '')
    assert f'ros2 run starcal_ros {name} ' in process.stdout
    assert '--params-file' in process.stdout and 'tan2018.yaml' in process.stdout
    assert 'ros2 param describe' in process.stdout
    assert 'starcal config list' in process.stdout and 'parameters.md' in process.stdout


def test_defect_shows_its_traceback_after_the_node_was_closed():
    status, out, errors = finish(start(tick=fail('ZeroDivisionError')))
    assert (status, out) == (1, 'ready\nclosed\n')
    assert 'Traceback' in errors and 'ZeroDivisionError' in errors
