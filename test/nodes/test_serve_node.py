# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal serve`` beside a running estimator: what it shows, and what the run notices."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('aiohttp')

from browser import browsing  # noqa: E402
from instruments import TAN2018  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.filter.offline import calibrate  # noqa: E402
from starcal_ros.live.heard import Seen  # noqa: E402
from starcal_ros.live.picture import picture  # noqa: E402
from starcal_ros.messages import conventions  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.workflows.node_program import node_command  # noqa: E402

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 60.0, 'simulation.real_time_factor': 15.0,
    'simulation.wait_for_subscribers': 1, 'simulation.wait_for_simulators': 1})
PATIENCE_S = 60.0
STALLED = 6             # viewers that take nothing


class Run:
    """A run of the suite, and the page that shows it."""

    def __init__(self, folder):
        parameters = folder / 'scenario.yaml'
        parameters.write_text(parameter_file.dump(SCENARIO))
        self.started, self._parameters = [], parameters
        self._serve = self._begin(
            [sys.executable, '-m', 'starcal_ros.cli', 'serve', '--port', '0'],
            stderr=subprocess.PIPE, text=True, cwd=folder)
        self.address = re.search(r'http://127\.0\.0\.1:\d+/', self._serve.stderr.readline())[0]

    def begin(self):
        """Start estimator and simulators."""
        self.estimator, *self._simulators = (
            self._begin(node_command(name, {}, self._parameters), stderr=subprocess.DEVNULL)
            for name in ('estimator', 'star_tracker_sim', 'gyro_sim'))

    def finish(self):
        """Wait until all has been simulated."""
        assert [each.wait(PATIENCE_S) for each in self._simulators] == [0, 0]

    def end(self):
        """End the page and the estimator as Ctrl-C does; return what the page's node said."""
        for process in (self._serve, self.estimator):
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
        return self._serve.stderr.read()

    def newest(self, holds):
        """Return the newest moment, as soon as something holds for it."""
        with urlopen(self.address + 'events', timeout=PATIENCE_S) as events:
            deadline = time.monotonic() + PATIENCE_S
            for line in events:
                if line.startswith(b'data: ') and holds(moment := json.loads(line[6:])):
                    return moment
                assert time.monotonic() < deadline, line
        raise AssertionError('the events have ended')

    def stall(self):
        """Return a connection of a viewer that asks for events and takes nothing."""
        host, port = self.address.split('/')[2].split(':')
        connection = socket.create_connection((host, int(port)))
        connection.sendall(f'GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n'.encode())
        return connection

    def _begin(self, command, **options):
        self.started.append(subprocess.Popen(command, **options))
        return self.started[-1]


@pytest.fixture
def run(tmp_path):
    """Return a page with no estimator yet; what is left of its processes is killed."""
    made = Run(tmp_path)
    try:
        yield made
    finally:
        for process in made.started:
            if process.poll() is None:
                process.kill()
                process.wait()


def offline():
    """Return what `starcal calibrate` makes of the same messages."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return calibrate(gyro.next(gyro.count), tracker.next(tracker.count), SCENARIO)[0]


def test_viewers_see_the_run_and_are_one_subscriber_of_the_estimator(run, peer):
    assert run.newest(lambda moment: True)['verdict']['text'] == 'no estimator is heard so far'
    stalled = [run.stall() for _ in range(STALLED)]
    run.begin()
    early = run.newest(lambda moment: moment['stars'] and moment['states'])
    peer.until(lambda: peer.node.count_publishers('starcal/state') == 1)
    others = peer.node.get_subscriptions_info_by_topic('starcal/state')
    assert sorted(info.node_name for info in others) == ['peer', 'serve']
    for topic in ('imu/data_raw', 'star_tracker/centroids'):
        names = {info.node_name for info in peer.node.get_subscriptions_info_by_topic(topic)}
        assert 'serve' not in names         # no sensor waits for a page
    run.finish()
    last = run.newest(lambda moment: ['frames', '120'] in moment['counts'])
    assert early['stamp'] < last['stamp'] == '2026-07-02T12:00:59.500'
    assert ['dropped messages', '0'] in last['counts'] and ['gyro gaps', '0'] in last['counts']
    assert last['verdict']['word'] == 'not yet' and last['verdict']['kind'] == 'open'
    calibrator = offline()
    expected = picture(Seen(conventions.state_vector(calibrator.stamp_ns, calibrator.belief)))
    for told, own in zip(last['states'], expected['states'], strict=True):
        assert {key: told[key] for key in ('estimate', 'sigma')} == {
            key: own[key] for key in ('estimate', 'sigma')}
    for each in stalled:
        each.close()
    assert 'Traceback' not in run.end()


@pytest.mark.slow
def test_a_browser_follows_the_run_until_the_estimator_is_gone(run, tmp_path):
    stamp = "document.getElementById('stamp').textContent"
    with browsing(tmp_path / 'browser') as tab:
        tab.look(1280, 900)
        tab.open(run.address)
        tab.until("document.getElementById('text').textContent == 'no estimator is heard so far'")
        run.begin()
        tab.until("document.querySelectorAll('#states .row').length == 14")
        tab.until("document.querySelectorAll('#detector g circle').length > 10")
        first = tab.tell(stamp)
        tab.until(f'{stamp} > {json.dumps(first)}')
        tab.until("document.getElementById('word').textContent == 'not yet'")
        run.finish()
        tab.until(f"{stamp}.includes('12:00:59.5')")
        run.estimator.send_signal(signal.SIGINT)
        tab.until('/no estimator is heard for [0-9]+ s/.test(document.body.innerText)')
        assert tab.complaints == []
        assert 'Traceback' not in run.end()
        tab.until("document.getElementById('word').textContent == 'no connection'")


def test_a_port_that_is_taken_is_said_in_a_line(run, tmp_path):
    port = run.address.rsplit(':', 1)[1].strip('/')
    done = subprocess.run([sys.executable, '-m', 'starcal_ros.cli', 'serve', '--port', port],
                          text=True, capture_output=True, timeout=PATIENCE_S, cwd=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(rf'error: serve: cannot listen on 127\.0\.0\.1, port {port}: .*\n',
                        done.stderr)


def test_in_a_namespace_the_estimator_of_that_is_shown(tmp_path):
    process = subprocess.Popen(
        [sys.executable, '-m', 'starcal_ros.cli', 'serve', '--port', '0', '--namespace', '/left',
         '--json'], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    try:
        assert process.stderr.readline().endswith('shows left/estimator\n')
        told = json.loads(process.stdout.readline())
        assert told['shows'] == 'left/estimator'
        with urlopen(told['address'] + 'source', timeout=PATIENCE_S) as answer:
            assert json.loads(answer.read())['title'] == 'left/estimator'
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
