# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal serve FILE``: from a file to the page, and what it says where it can not."""

from contextlib import contextmanager
import json
import math
import re
import signal
import subprocess
import sys
from urllib.request import urlopen

import pytest

pytest.importorskip('aiohttp')

from browser import browsing  # noqa: E402
from estimated import record_results  # noqa: E402
from instruments import TAN2018  # noqa: E402
from starcal_ros.cli import main  # noqa: E402
from starcal_ros.results import document, result  # noqa: E402
from starcal_ros.simulation.write_recording import simulate  # noqa: E402

SCENARIO = TAN2018.replace({'simulation.duration_s': 60.0})
PATIENCE_S = 60.0


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a recording of results, a result, and a recording of sensors."""
    folder = tmp_path_factory.mktemp('serve')
    calibrator = record_results(folder / 'run.mcap', SCENARIO)
    document.write_json(folder / 'result.json', result.result(calibrator, {}))
    simulate(SCENARIO, folder / 'sensors.mcap')
    return folder


@contextmanager
def served(path):
    """Serve a file, and yield the address of the page."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'starcal_ros.cli', 'serve', str(path), '--port', '0'],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=path.parent)
    try:
        yield re.match(r'http://127\.0\.0\.1:\d+/', process.stdout.readline())[0]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture(scope='module')
def recording(folder):
    """Return the address at which the recording is served."""
    with served(folder / 'run.mcap') as address:
        yield address


@pytest.fixture(scope='module')
def outcome(folder):
    """Return the address at which the result is served."""
    with served(folder / 'result.json') as address:
        yield address


def get(address):
    """Return what JSON is served."""
    with urlopen(address, timeout=PATIENCE_S) as answer:
        return json.loads(answer.read())


def test_a_recording_is_served_moment_by_moment(recording):
    source = get(recording + 'source')
    assert source['title'] == 'run.mcap' and len(source['moments']) == 120
    last = get(f'{recording}moments/119')
    assert last['verdict']['word'] == 'not yet' and len(last['states']) == 13
    assert len(last['stars']) > 10 and last['stamp'].startswith('2026-07-02T12:00:59.5')


def test_a_result_is_served(outcome):
    assert get(outcome + 'source') == {'title': 'result.json', 'moments': ['']}
    assert get(outcome + 'moments/0')['tests']


@pytest.mark.parametrize('words, text', [
    (['missing.mcap'], 'missing.mcap'), (['missing.json'], 'missing.json: cannot be read'),
    (['sensors.mcap'], 'calibrate it, starcal calibrate BAG'),
    (['run.mcap', '--namespace', 'left'], 'no results of an estimator in /left')])
def test_what_can_not_be_served_is_said(folder, monkeypatch, capsys, words, text):
    monkeypatch.chdir(folder)
    assert main(['serve', *words]) == 2
    assert text in ' '.join(capsys.readouterr().err.split())


@pytest.mark.parametrize('port', ['-1', '65536', 'x', '8e3', '٣'])
def test_a_port_is_a_number_that_there_is(capsys, port):
    with pytest.raises(SystemExit, match='2'):
        main(['serve', f'--port={port}'])
    assert 'invalid port' in capsys.readouterr().err


# In a browser

SHOWN = "document.querySelectorAll('#states .row').length == 14"


@pytest.fixture(scope='module')
def drawn(tmp_path_factory, recording):
    """Return a tab with the page, to draw on."""
    with browsing(tmp_path_factory.mktemp('browser')) as tab:
        tab.open(recording)
        tab.until(SHOWN)
        yield tab


def test_browser_draws_each_moment_that_is_asked_for(recording, tmp_path):
    with browsing(tmp_path) as tab:
        tab.look(1280, 900)
        tab.open(recording)
        tab.until(SHOWN)
        stars = tab.tell("document.querySelectorAll('#detector g circle').length")
        told = tab.tell("document.getElementById('stars').textContent")
        assert re.match(rf'{stars} of {stars} stars used', told) and stars > 10
        late = tab.tell("document.getElementById('stamp').textContent")
        tab.tell("(() => { const s = document.getElementById('moment'); s.value = 20;"
                 ' s.oninput(); })()')
        tab.until(f"document.getElementById('stamp').textContent != {json.dumps(late)}")
        assert '12:00:10' in tab.tell("document.getElementById('stamp').textContent")
        # a run that rests knows least of what a turn would show, and says which
        assert tab.tell("document.getElementById('turn').textContent").startswith('rotate about')
        assert not tab.tell("document.getElementById('axes').hasAttribute('hidden')")
        assert tab.tell("document.querySelectorAll('#axes line.next').length") == 1
        assert tab.complaints == []


@pytest.mark.parametrize('axis', ['X', 'Y', 'Z', '-X', '-Y', '-Z'])
def test_the_arrow_turns_by_the_right_hand(drawn, axis):
    """From x over y to z goes the turn about (1, 1, 1), which points to the viewer."""
    drawn.tell(f"drawAxes('{axis}')")
    cycle = drawn.tell('Object.values(AXES)')
    arc = drawn.tell("""(() => { const path = document.querySelector('#axes path');
        const all = path.getTotalLength(), to = path.getCTM();
        return [0, 0.25, 0.5, 0.75].map((part) => {
          const at = path.getPointAtLength(part * all).matrixTransform(to);
          return [at.x, at.y]; }); })()""")
    assert _area(cycle) * _area(arc) * (-1 if axis[0] == '-' else 1) > 0.0
    assert drawn.tell("document.querySelector('#axes text.next').textContent") == axis[-1]


@pytest.mark.parametrize('ratios, low', [([0.5], 0.01), ([0.5, 3e4], 0.01), ([2e-4, 2e8], 1e-4)])
def test_bars_are_long_by_the_logarithm_of_their_ratio(drawn, ratios, low):
    states = [{'name': 'f', 'label': 'f', 'unit': 'mm', 'of': 'mm', 'estimate': '1', 'sigma': '2',
               'tolerance': '4', 'ratio': ratio, 'within': ratio <= 1.0} for ratio in ratios]
    drawn.tell(f'drawStates({json.dumps({"states": states, "doubt": ""})})')
    labels = drawn.tell("[...document.querySelectorAll('.at')].map((e) => [+e.textContent,"
                        ' parseFloat(e.style.left)])')
    assert labels[0] == [low, 0] and 1.0 in [value for value, _ in labels]
    bars = drawn.tell("[...document.querySelectorAll('.bar')].map((e) =>"
                      ' parseFloat(e.style.width))')
    per_decade = labels[1][1] / math.log10(labels[1][0] / low)
    for ratio, bar in zip(ratios, bars):
        assert bar == pytest.approx(per_decade * math.log10(ratio / low), rel=1e-3)
    assert max(bars) <= 100.0


def test_bars_of_sigmas_that_are_doubted_look_doubted(drawn):
    states = [{'name': 'f', 'label': 'f', 'unit': 'mm', 'of': 'mm', 'estimate': '1', 'sigma': '2',
               'tolerance': '4', 'ratio': 0.5, 'within': True}]
    looks = []
    for doubt in ('not to be believed', ''):
        drawn.tell(f'drawStates({json.dumps({"states": states, "doubt": doubt})})')
        assert drawn.tell('document.getElementById("doubt").textContent') == doubt
        looks.append(drawn.tell('getComputedStyle(document.querySelector(".within .bar"))'
                                '.backgroundImage'))
    assert 'gradient' in looks[0] and looks[1] == 'none'


@pytest.mark.parametrize('width', [1280, 390])
def test_nothing_is_wider_than_the_page_and_dark_is_dark(recording, tmp_path, width):
    with browsing(tmp_path) as tab:
        colours = []
        for dark in (False, True):
            tab.look(width, 900, dark)
            tab.open(recording)
            tab.until(SHOWN)
            assert tab.tell('document.documentElement.scrollWidth') <= width
            wide = tab.tell("[...document.querySelectorAll('main *:not(svg *)')].filter((e) =>"
                            ' e.getBoundingClientRect().right > innerWidth + 1).length')
            assert wide == 0
            colours.append([tab.tell(f'getComputedStyle(document.body).{name}')
                            for name in ('backgroundColor', 'color')])
        assert _light(colours[0][0]) > 0.9 > 0.3 > _light(colours[0][1])
        assert _light(colours[1][0]) < 0.3 < 0.7 < _light(colours[1][1])
        assert tab.complaints == []


def test_of_a_result_there_is_no_map_and_no_slider(outcome, tmp_path):
    with browsing(tmp_path) as tab:
        tab.look(1280, 900)
        tab.open(outcome)
        tab.until(SHOWN)
        for name in ('map', 'moments'):
            assert tab.tell(f"document.getElementById('{name}').hasAttribute('hidden')")
        assert tab.complaints == []


def _area(points):
    """Return twice the area about which points go, by its sign which way round."""
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(points, points[1:] + points[:1]))


def _light(colour):
    """Return how light a colour is, 0 to 1, from its 'rgb(r, g, b)'."""
    return sum(map(int, re.findall(r'\d+', colour)[:3])) / 765.0
