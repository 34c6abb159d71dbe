# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The view of the running estimator: what it draws, and that it hears what is said."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from rich.console import Console

from instruments import TAN2018
from starcal_ros import cli
from starcal_ros.config import parameter_file
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import N_STATES, STATE_NAMES
from starcal_ros.live.heard import STATE_SIZE, Seen
from starcal_ros.live.terminal import render, star_map
from starcal_ros.messages import conventions
from starcal_ros.simulation import sensors
from starcal_ros.workflows import node_program

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 20.0, 'simulation.real_time_factor': 0.0,
    'simulation.wait_for_subscribers': 1})
STARS = np.dtype([('u', 'f8'), ('v', 'f8'), ('du', 'f8'), ('dv', 'f8'), ('catalog_id', 'u4'),
                  ('nis', 'f4'), ('accepted', 'u1')])
PATIENCE_S = 90.0


def stars(*rows):
    """Return residuals from (u, v, du, dv, nis, accepted)."""
    return np.array([(u, v, du, dv, 1, nis, accepted) for u, v, du, dv, nis, accepted in rows],
                    STARS)


def text(seen, width=80):
    """Return a view as plain text."""
    console = Console(width=width, record=True, file=open(os.devnull, 'w'))
    console.print(render(seen))
    return console.export_text()


# Pure drawing


def test_map_shows_the_corners_of_the_detector_in_its_corners():
    corners = stars(*((u, v, 0.0, 0.0, 0.0, 1) for u in (-0.5, 1023.5) for v in (-0.5, 1023.5)))
    lines = star_map(corners, (1024, 1024), columns=20).plain.split('\n')
    assert [line.strip() for line in lines[1:-1]] == [''] * 8
    assert lines[0] == lines[-1] == '•' + ' ' * 18 + '•'


def test_map_has_the_shape_of_the_detector():
    lines = star_map(stars(), (2000, 1000), columns=32).plain.split('\n')
    assert {len(line) for line in lines} == {32} and len(lines) == 8


@pytest.mark.parametrize('degrees, arrow', [*zip(range(0, 360, 45), '→↘↓↙←↖↑↗')])
def test_arrow_points_along_the_residual_v_downward(degrees, arrow):
    angle = np.radians(degrees + 20.0)          # within 22.5 deg of the arrow
    star = stars((500.0, 500.0, np.cos(angle), np.sin(angle), 5.0, 1))
    assert star_map(star, (1024, 1024)).plain.strip() == arrow


def test_small_innovations_are_dots_and_rejected_stars_cover_the_others():
    here = (500.0, 500.0, 1.0, 0.0)
    signs = [star_map(stars(*rows), (1024, 1024)).plain.strip() for rows in (
        [(*here, 2.29, 1)], [(*here, 2.31, 1)], [(*here, 99.0, 0), (*here, 2.31, 1)])]
    assert signs == ['•', '→', '×']


def test_view_without_anything_heard_says_so():
    assert text(Seen()).strip() == 'no estimator is heard so far'
    assert 'no estimator is heard for 9 s' in text(Seen(level=0, message='converged', silent_s=9))


def state(sigma):
    """Return data of `starcal/state` with one sigma for all states, in the filter's units."""
    data = np.zeros(STATE_SIZE)
    data[0], data[10] = 1_782_993_600.25, 5.0
    data[1 + N_STATES:] = np.diag(np.full(N_STATES, sigma**2)).ravel()
    return data


def test_states_stand_beside_their_tolerances():
    values = {'sigma_u0': '0.04', 'tolerance_u0': '0.1', 'tolerance_v0': '0.03'}
    lines = text(Seen(state(0.04), level=0, silent_s=0.0, values=values)).splitlines()
    by_label = {line.split()[0]: line.split() for line in lines if line.split()}
    assert by_label['u0'] == ['u0', '5.000', '0.04', '0.1', 'px', '✓']
    assert by_label['v0'] == ['v0', '0.000', '0.04', '0.03', 'px', '…']
    assert by_label['k1'][-2:] == ['0.04', 'mm⁻²']         # no tolerance is known
    assert 'last frame 2026-07-02T12:00:00.250 UTC' in '\n'.join(lines)


def test_a_sigma_that_the_data_contradict_is_not_ticked_off():
    values = {'sigma_u0': '0.04', 'tolerance_u0': '0.1', 'tolerance_v0': '0.03'}
    shown = text(Seen(state(0.04), level=2, silent_s=0.0, values=values))
    assert shown.count('?') == 2 and '✓' not in shown and '…' not in shown
    assert 'the sigmas are not to be believed' in shown


def test_view_has_verdict_inputs_counts_and_what_can_not_be_told_apart():
    shown = text(Seen(
        stars=stars((1, 1, 0.3, 0.4, 1, 1), (9, 9, 7, 7, 99, 0)), size=(64, 64), level=0,
        message='not yet: [bold]f[/bold]', silent_s=0.0,
        values={'rejected_stars': '3', 'not_told_apart': 'u0, psi_y: rotate',
                'reprojection_rms_u_px': '0.1', 'reprojection_rms_v_px': '0.2', 'sigma_u0': '3'},
        inputs_message='/b is silent for 4 s',
        inputs={'/a/imu/data_raw messages_per_second': '9.5', '/a/imu/data_raw messages': '95'}))
    for part in ('not yet: [bold]f[/bold]\n', '/b is silent for 4 s, imu/data_raw 9.5 Hz, repro',
                 'rejected stars 3', 'not told apart: u0, Ψ_y: rotate',
                 'reprojection 0.1000 0.2000 px', '1 of 2 stars used, 0.3 0.4 px'):
        assert part in shown
    assert 'sigma' not in shown         # no count, though it is a whole number


@pytest.mark.parametrize('message, shown', [
    ('not yet: u0; more frames are needed; 2.3 h more', 1), ('inconsistent: a', 1),
    ('converged', 0)])
def test_advice_is_shown_once(message, shown):
    advice = {'not yet': 'more frames are needed; 2.3 h more', 'inconsistent': 'find it'}.get(
        message.partition(':')[0], 'none')
    view = text(Seen(level=0, message=message, silent_s=0.0, values={'advice': advice}))
    assert view.count(advice) == shown


# Over ROS 2


@pytest.fixture(scope='module')
def processes():
    """Return a function that starts a process; what is left of them is killed at the end."""
    started = []

    def start(*words, **options):
        started.append(subprocess.Popen(*words, **options))
        return started[-1]
    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.fixture(scope='module')
def shown(tmp_path_factory, processes):
    """Return what a terminal shows that is opened when a run is over, and what is told as JSON."""
    pytest.importorskip('rclpy')
    parameters = tmp_path_factory.mktemp('watch') / 'scenario.yaml'
    parameters.write_text(parameter_file.dump(SCENARIO))
    estimator, *simulators = (
        processes(node_program.node_command(name, {}, parameters), stderr=subprocess.DEVNULL)
        for name in ('estimator', 'star_tracker_sim', 'gyro_sim'))
    assert [simulator.wait(PATIENCE_S) for simulator in simulators] == [0, 0]
    ours, theirs = pty.openpty()
    watch = processes(
        [sys.executable, '-m', 'starcal_ros.cli', 'watch'], stdin=theirs, stdout=theirs,
        cwd=parameters.parent, env={
            **os.environ, 'TERM': 'xterm', 'COLUMNS': '100', 'LINES': '40'})
    os.close(theirs)
    pieces = []

    def read():
        while True:
            try:
                pieces.append(os.read(ours, 65536))
            except OSError:                     # the other side is closed
                return
    reader = threading.Thread(target=read)
    reader.start()
    deadline = time.monotonic() + PATIENCE_S
    while not all(part in b''.join(pieces) for part in (b'stars used', b'tolerance', b'frames ')):
        assert time.monotonic() < deadline and watch.poll() is None, b''.join(pieces)
        time.sleep(0.05)
    for_programs = processes(
        [sys.executable, '-m', 'starcal_ros.cli', 'watch', '--json'], stdout=subprocess.PIPE,
        text=True, cwd=parameters.parent)
    moments = map(json.loads, for_programs.stdout)
    told = next(moment for moment in moments if moment['states'] and moment['counts'])
    for process in (for_programs, watch, estimator):
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    reader.join()
    os.close(ours)
    whole = b''.join(pieces).decode().replace('\r\n', '\n')
    screen, last = whole.split('\x1b[?1049l')           # where the alternate screen is left
    assert '\x1b[?1049h' in screen
    return re.sub(r'\x1b\[[0-9;?]*[a-zA-Z]', '', last), told


def test_late_watch_shows_the_states_of_the_estimator(shown):
    shown, told = shown
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    calibrator, _ = calibrate(
        gyro.next(gyro.count), tracker.next(tracker.count), SCENARIO)
    offline = text(Seen(conventions.state_vector(calibrator.stamp_ns, calibrator.belief),
                        level=0, silent_s=0.0))
    # The table is before the sentences, of which a line may begin with a state, too.
    rows = {line.split()[0]: line.split()[1:3] for line in reversed(shown.splitlines())
            if line.split()}
    expected = [line.split()[:3] for line in offline.splitlines()[-N_STATES:]]
    assert len(expected) == len(STATE_NAMES)
    for label, estimate, sigma in expected:
        assert rows[label] == [estimate, sigma]
    calibrated = [[row['estimate'], row['sigma']] for row in told['states'][-13:]]
    assert calibrated == [[estimate, sigma] for _, estimate, sigma in expected[-13:]]


def test_late_watch_shows_tolerances_verdict_counts_and_stars(shown):
    shown, told = shown
    assert ['frames', '40'] in told['counts'] and told['verdict']['word'] == 'not yet'
    assert shown.count('✓') + shown.count('…') == 13
    assert 'not yet: ' in shown and 'rotate about' in shown
    assert re.search(r'gyro 2000, frames 40, stars \d+', shown)
    assert re.search(r'(\d+) of \1 stars used', shown)
    assert sum(shown.count(sign) for sign in '•→↘↓↙←↖↑↗') >= 10 + 2       # and the legend's two


def test_tolerances_are_those_of_the_diagnostics():
    found = Seen(values={'sigma_f': '1e-05', 'tolerance_f': '0.0002',
                         'sigma_phi_x': '3'}).tolerances()
    assert found[STATE_NAMES.index('f')] == 2e-4
    assert np.isnan(found).sum() == N_STATES - 1


def test_without_ros_the_command_says_what_is_missing(monkeypatch, capsys):
    monkeypatch.setattr(node_program, 'find_spec', lambda name: None)
    assert cli.main(['watch']) == 1
    assert ('starcal watch: error: no ROS 2 here (rclpy): source a distribution, or pip install '
            "'.[ros]'") in ' '.join(capsys.readouterr().err.split())
