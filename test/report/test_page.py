# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report: all on one page, true to RESULT.json, harmless, drawn by a real browser."""

from dataclasses import replace
from html.parser import HTMLParser
import json
import re
import shutil
import subprocess
import sys

import numpy as np
from plotly.offline import get_plotlyjs
import pytest
from scipy.stats import norm

from instruments import CONFIG, DETECTOR, INTRINSICS, PITCH_MM, TAN2018
from starcal_ros import report
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.core import camera
from starcal_ros.core.camera import Detector
from starcal_ros.core.statistic import Statistic
from starcal_ros.filter import verdict
from starcal_ros.filter.history import Residuals
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.recording import reader
from starcal_ros.report import detector_charts, statistic_charts, time_charts
from starcal_ros.report.calibration import Calibration, called
from starcal_ros.report.chart import BLUE, RED, ROLES
from starcal_ros.report.markup import document
from starcal_ros.report.page import page as page_of
from starcal_ros.reproduction import wrong_models
from starcal_ros.results import result
from starcal_ros.simulation import sensors

SHORT = TAN2018.replace({'simulation.duration_s': 150.0})
SECTIONS = ['verdict', 'states', 'change', 'convergence', 'projection', 'coverage', 'residuals',
            'consistency', 'distortion', 'coupling', 'counts', 'provenance']
CHARTS = 13 + 3 + 2 + 3 + 10 + 1 + 29 + 2 + 3 + 3
"""States; projection; coverage; map and histograms of residuals, against what they should not
depend on, star by star; tests of the innovations; autocorrelation, NIS; distortion, of which the
nominal camera has none; coupling."""
HOSTILE = '<img src=x onerror=alert(1)>&"\'.mcap'
HOSTILE_FILE = '</pre><script>alert(2)</script>.mcap'
BROWSER = shutil.which('chromium')
try:
    import weasyprint  # noqa: F401
    PDF = True
except (ImportError, OSError):      # the package, or Pango, which it needs of the system
    PDF = False
PATIENCE_S = 120.0


class Page(HTMLParser):
    """What a browser makes of a page: its elements, and the text of each."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.loads, self._open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        """Note an element and what it would load."""
        element = {'tag': tag, 'text': '', 'inside': tuple(e.get('id') for e in self._open),
                   **dict(attributes)}
        self.elements.append(element)
        self.loads += [value for name, value in attributes
                       if name in ('src', 'href', 'srcset', 'action', 'data', 'poster')]
        if tag not in ('meta', 'link', 'img', 'br'):
            self._open.append(element)

    def handle_endtag(self, tag):
        """Close an element."""
        assert self._open.pop()['tag'] == tag

    def handle_data(self, data):
        """Give text to the elements it is in."""
        for element in self._open:
            element['text'] += data

    def all(self, tag, within=None):
        """Return the elements of a kind, in a section."""
        return [element for element in self.elements if element['tag'] == tag
                and (within is None or within in element['inside'])]

    def rows(self, within):
        """Return the cells of the tables of a section."""
        cells = [[]]
        for element in self.elements:
            if within in element['inside']:
                if element['tag'] == 'tr':
                    cells.append([])
                elif element['tag'] in ('td', 'th'):
                    cells[-1].append(element['text'])
        return cells[1:]


def html_of(calibration):
    """Return the report of a calibration as HTML."""
    return document(page_of(calibration))


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Return the folder in which the command has left a result and a report."""
    folder = tmp_path_factory.mktemp('report')
    config = folder / 'config.yaml'
    config.write_text(parameter_file.dump(SHORT.replace({'recorder.output': HOSTILE_FILE})))
    bag = folder / HOSTILE
    assert main(['simulate', '--config', str(config), '--out', str(bag)]) == 0
    assert main(['calibrate', str(bag), '--config', str(config), '--out',
                 str(folder / 'result.json'), '--report', str(folder / 'report.html'),
                 *(['--report', str(folder / 'report.pdf')] if PDF else []), '--light-report',
                 str(folder / 'light.html')]) == 3
    return folder


@pytest.fixture(scope='module')
def page(made):
    """Return the report as a browser reads it."""
    return Page((made / 'report.html').read_text())


@pytest.fixture(scope='module')
def outcome(made):
    """Return RESULT.json."""
    return json.loads((made / 'result.json').read_text())


@pytest.fixture(scope='module')
def history():
    """Return how the same run came about."""
    gyro, tracker = sensors.gyro(SHORT), sensors.star_tracker(SHORT)
    return calibrate(gyro.next(gyro.count), tracker.next(tracker.count), SHORT)[1]


# The page


def test_sections_stand_in_their_order_the_verdict_first(page):
    assert [element['id'] for element in page.all('section')] == SECTIONS


def test_page_loads_nothing(page, made):
    # The icon, which is there and empty, and the table of contents.
    assert page.loads == ['data:,', *(f'#{name}' for name in SECTIONS)]
    own = (made / 'report.html').read_text().replace(get_plotlyjs(), '')
    assert not re.search(r'https?://|@import|url\(', own)
    assert own.count('<script>') == 2           # plotly.js, once, and the page's own
    policy, = [e['content'] for e in page.all('meta')
               if e.get('http-equiv') == 'Content-Security-Policy']
    assert "default-src 'none'" in policy and 'http' not in policy


def test_nothing_from_outside_becomes_part_of_the_page(page):
    assert page.all('img') == [] and HOSTILE in page.all('h1')[0]['text']
    assert HOSTILE in page.all('title')[0]['text']
    pre, = page.all('pre')
    assert HOSTILE_FILE in pre['text']
    assert not any('alert' in script['text'] for script in page.all('script')
                   if 'Plotly' not in script['text'])


def test_states_are_those_of_the_result(page, outcome, made):
    head, *body = page.rows('states')
    truth = json.loads(reader.read(made / HOSTILE).attachments['truth.json'])
    states = report.rows(outcome, truth)
    assert len(body) == len(states) == 13
    for cells, state in zip(body, states):
        row = dict(zip(head, cells))
        assert row['state'] == state.label
        scale = 3600.0 if '″' in state.unit else 1.0
        assert float(row['estimate']) == pytest.approx(state.estimate, abs=state.sigma / scale)
        assert float(row['sigma']) == pytest.approx(state.sigma, rel=0.06)     # two digits
        assert row['within'] == ('yes' if state.sigma <= float(row['tolerance']) else 'no')
        assert float(row['error/sigma']) == pytest.approx(state.error / state.sigma, abs=0.006)


def test_sigmas_are_scaled_and_doubted_where_the_data_contradict_the_model(outcome):
    """By the root of the variance factor: of the turns, of the centroids, never less than 1."""
    sigma = [row.sigma for row in report.rows(outcome, None)]
    assert np.isnan([row.scaled for row in report.rows(outcome, None)]).all()
    assert report.table(report.rows(outcome, None), '').caption is None
    for turns, centroids in ((9.0, 4.0), (0.5, 4.0), (2.25, 0.3)):
        states = report.rows({**outcome, 'verdict': 'inconsistent', 'variance_factor': {
            'turns': turns, 'centroids': centroids}}, None)
        np.testing.assert_allclose([row.scaled for row in states], sigma * np.sqrt(np.maximum(
            np.repeat([turns, centroids], (6, 7)), 1.0)))
        shown = report.table(states, '')
        heads = [column.header for column in shown.columns]
        assert heads[heads.index('sigma') + 1] == 'scaled sigma'
        assert 'not to be believed' in shown.caption


def test_doubtful_sigmas_are_told_on_the_page(tmp_path):
    """Of stars with one and a half times the noise that is stated."""
    scenario = SHORT.replace({'truth.star_tracker.centroid_sigma_px': 0.075})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, history = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    made_of = result.result(calibrator, {'bag': 'x'})
    judged = verdict.of(calibrator)
    assert judged.word == 'inconsistent'
    drawn_page = Page(html_of(Calibration(made_of, None, history, judged, scenario, [])))
    head, *body = drawn_page.rows('states')
    for cells, state in zip(body, report.rows(made_of, None)):
        row = dict(zip(head, cells))
        assert float(row['scaled sigma']) == pytest.approx(state.scaled, rel=0.06)
    for name in ('verdict', 'states'):
        said, = [e['text'] for e in drawn_page.all('section') if e['id'] == name]
        assert 'not to be believed' in said
    said, = [e['text'] for e in drawn_page.all('section') if e['id'] == 'consistency']
    failing = sum(not each.passed for each in judged.statistics)
    assert f'{failing} of {len(judged.statistics)} tests of the innovations fail. ' in said


def test_counts_and_provenance_are_those_of_the_result(page, outcome):
    counts = {name.replace(' ', '_'): int(value) for name, value in page.rows('counts')}
    assert counts == outcome['counts']
    provenance = {name.replace(' ', '_'): value for name, value in page.rows('provenance')}
    assert provenance == outcome['provenance']
    assert parameter_file.parse(page.all('pre')[0]['text'], 'page').sha256 == (
        outcome['provenance']['config_sha256'])


def test_verdict_and_advice_are_on_the_page(page, outcome):
    text = page.all('section')[0]['text']
    assert outcome['converged'] is False and 'Not yet: ε_x, ' in text
    assert 'can not be told apart yet: so far the stars show only their sum; ' in text or (
        'can not be told apart yet: in the middle of the field' in text)
    assert outcome['advice'] in text.replace('Not yet', 'not yet')
    assert re.search(r'u0 and Ψ_y are correlated by [+-]\d\.\d{4}', text)


def test_charts_have_data_and_a_caption(page):
    scripts = [e for e in page.all('script') if e.get('type') == 'application/json']
    assert len(scripts) == len(page.all('figcaption')) == CHARTS
    for script in scripts:
        figure = json.loads(script['text'])
        assert figure['data'] and 'width' not in figure['layout']
    assert all(len(caption['text']) > 3 for caption in page.all('figcaption'))


def test_without_truth_the_page_does_without_it(made, tmp_path):
    from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
    recording = reader.read(made / HOSTILE)
    with Writer(tmp_path / 'bare.mcap') as writer:
        writer.write_batches(imu_batch('/imu/data_raw', recording.gyro[:3000]),
                             centroids_batch('/star_tracker/centroids', recording.frames[:50]))
    assert main(['calibrate', str(tmp_path / 'bare.mcap'), '--config', str(CONFIG), '--out',
                 str(tmp_path / 'r.json'), '--report', str(tmp_path / 'r.html')]) == 3
    page = Page((tmp_path / 'r.html').read_text())
    assert 'truth' not in page.rows('states')[0]
    assert 'Estimate minus final estimate' in page.all('section')[3]['text']
    told = len(json.loads((tmp_path / 'r.json').read_text())['consistency'])
    assert told < 29 and len(page.all('figcaption')) == CHARTS - 2 - 29 + told


def test_notices_are_on_the_page(made, tmp_path):
    config = tmp_path / 'other.yaml'
    config.write_text(parameter_file.dump(SHORT.replace({'gyro.arw_deg_sqrt_h': 0.002})))
    assert main(['calibrate', str(made / HOSTILE), '--config', str(config), '--out',
                 str(tmp_path / 'r.json'), '--report', str(tmp_path / 'r.html')]) == 3
    page = Page((tmp_path / 'r.html').read_text())
    assert any('gyro.arw_deg_sqrt_h is 0.001' in item['text'] for item in page.all('li', 'counts'))


def test_report_that_can_not_be_written_is_named_before_the_work(made, tmp_path, capsys):
    path = tmp_path / 'nowhere' / 'r.html'
    assert main(['calibrate', str(made / HOSTILE), '--out', str(tmp_path / 'r.json'),
                 '--report', str(path)]) == 2
    assert f'{path}: cannot be written' in capsys.readouterr().err
    assert not (tmp_path / 'r.json').exists()


# The charts


def test_curves_are_thinned_from_end_to_end():
    rows = time_charts.thinned(14_400)
    assert len(rows) == time_charts.POINTS and rows[0] == 0 and rows[-1] == 14_399
    assert np.ptp(np.diff(rows)) <= 1
    assert time_charts.thinned(7).tolist() == list(range(7))


def test_convergence_has_a_chart_a_state_with_its_bound(history):
    charts = time_charts.convergence(history, None, [1.0] * 13, [0.0] * 13)
    assert len(charts) == 13
    for k, chart in enumerate(charts):
        lower, upper, error = chart.figure.data[:3]
        np.testing.assert_array_equal(lower.y, -upper.y)
        assert error.y[-1] == 0.0               # against the final estimate
        assert (np.abs(error.y) < upper.y * 2.0).mean() > 0.9, STATE_NAMES[3 + k]


def test_a_step_parts_the_run_into_stretches():
    scenario = TAN2018.replace({'simulation.duration_s': 420.0, 'motion.dwell_s': 5.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = wrong_models.focal_step(5.0).spoil(
        gyro.next(gyro.count), tracker.next(tracker.count), tracker.truth)
    calibrator, history = calibrate(samples, frames, scenario)
    outcome = result.result(calibrator, {'bag': 'spoilt.mcap'})
    page = Page(html_of(Calibration(outcome, None, history, verdict.of(calibrator), scenario, [])))
    section = next(each['text'] for each in page.all('section') if each['id'] == 'steps')
    assert 'A step of the camera at 2026-07-02T12:03:30' in section
    head, *rows = page.rows('steps')
    assert len(head) == 4 and head[2].startswith('up to 2026-07-02T12:03:')
    _, _, before, after = next(row for row in rows if row[0] == 'f')
    before, after = (float(cell.split(' ±')[0]) for cell in (before, after))
    assert after - before == pytest.approx(0.005, abs=0.0005)


def test_a_long_run_says_how_many_of_its_frames_are_kept(outcome, history):
    gyro, tracker = sensors.gyro(SHORT), sensors.star_tracker(SHORT)
    calibrator, _ = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), SHORT)
    n = len(history.stamp_ns)
    long = replace(history, every=4, frames=4 * n)
    page = Page(html_of(Calibration(outcome, None, long, verdict.of(calibrator), SHORT, [])))
    said = {each['id']: each['text'] for each in page.all('section')}
    used = int(history.stars.accepted.sum())
    assert f'of the {used} stars used of one frame in 4: RMS' in said['residuals']
    assert f'Of {4 * n} frames {n} are drawn.' in said['convergence']


def test_equivalent_principal_point_is_drawn_with_the_sigma_of_the_verdict(history):
    gyro, tracker = sensors.gyro(SHORT), sensors.star_tracker(SHORT)
    calibrator, _ = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), SHORT)
    judged = verdict.of(calibrator)
    charts = time_charts.equivalent_principal_point(history, None, PITCH_MM)
    for chart, sigma in zip(charts, judged.equivalent_sigma_px):
        assert chart.figure.data[1].y[-1] == pytest.approx(3.0 * sigma, rel=1e-5)


def test_consistency_says_how_many_frames_lie_in_the_band(history):
    """95 % of 300 frames, binomial: 3.9 sigma are 5 %."""
    chart, text = time_charts.consistency(history)
    assert len(chart.figure.data[2].y) == len(history.nis)
    assert abs(float(re.match(r'([\d.]+)%', text)[1]) - 95.0) < 5.0


def drawn(value, low=2.0, high=4.0):
    return float(statistic_charts.place(np.array(value), np.array(low), np.array(high)))


def test_statistics_are_drawn_by_their_place_in_the_band():
    assert [drawn(value) for value in (2.0, 3.0, 4.0, 3.5)] == [-1.0, 0.0, 1.0, 0.5]
    # ten and a hundred half widths away from the middle
    assert [drawn(value) for value in (13.0, -7.0, 103.0)] == pytest.approx([2.0, -2.0, 3.0])
    assert drawn(0.0, 0.0, 5.0) == -1.0


def test_each_test_of_the_innovations_has_its_history_the_failing_ones_first():
    minute = 60 * 10**9
    fine, bad = (Statistic('fine', 0.5, -1.0, 1.0, 9), Statistic('bad', -30.0, -1.0, 1.0, 9))
    tests = [(minute, (fine,)), (2 * minute, (fine, bad._replace(value=0.0))),
             (3 * minute, (fine._replace(value=5.0), bad)), (4 * minute, (fine, bad))]
    first, second = statistic_charts.statistics(tests, 0)
    assert first.title == 'Fails: bad -30, allowed -1 to 1'
    assert second.title == 'fine 0.5, allowed -1 to 1'
    for chart, minutes, values, colors in (
            (first, [2, 3, 4], [0.0, -30.0, -30.0], [BLUE, RED, RED]),
            (second, [1, 2, 3, 4], [0.5, 0.5, 5.0, 0.5], [BLUE, BLUE, RED, BLUE])):
        lower, upper, line = chart.figure.data
        assert {*lower.y} == {-1.0} and {*upper.y} == {1.0}
        assert list(line.x) == pytest.approx(minutes)
        assert list(line.marker.color) == colors
        np.testing.assert_allclose(line.customdata[:, 0], values)
        assert max(np.abs(line.y)) < chart.figure.layout.yaxis.range[1]
    assert (first.figure.data[2].line.color, second.figure.data[2].line.color) == (RED, BLUE)
    assert statistic_charts.statistics([], 0) == []


def test_page_tells_how_many_tests_fail(page):
    said, = [e['text'] for e in page.all('section') if e['id'] == 'consistency']
    assert 'All 29 tests of the innovations pass. ' in said
    captions = [e['text'] for e in page.all('figcaption', 'consistency')]
    assert len(captions) == 31 and captions[0].startswith('NIS of the turns ')


def test_history_has_the_residuals_of_every_star(history):
    stars = history.stars
    assert len(stars.uv_raster) == len(stars.residual) == len(stars.sigma) == len(stars.accepted)
    assert stars.accepted.sum() == history.used.sum()
    # sigma travels with the star; the residual is narrower by what the fit takes
    np.testing.assert_allclose(stars.sigma, SHORT.star_tracker.centroid_sigma_px)
    rms = np.sqrt(np.mean(stars.residual[stars.accepted]**2))
    assert rms == pytest.approx(SHORT.star_tracker.centroid_sigma_px, rel=0.05)


def test_residual_map_has_rms_mean_and_count_of_each_cell():
    """Two stars in the first cell, one in the last, a rejected one: worked out by hand."""
    detector = Detector(1600, 1600, 0.01)
    stars = Residuals(np.array([[0.0, 0.0], [99.0, 99.4], [1599.4, 1599.4], [800.0, 800.0]]),
                      np.array([[1.0, 0.0], [3.0, 2.0], [0.5, 0.5], [9.0, 9.0]]),
                      np.array([True, True, True, False]), np.full(4, 1.0), np.arange(4))
    heat = detector_charts.residual_map(stars, detector).figure.data[0]
    z = np.array(heat.z)
    assert np.isfinite(z).sum() == 2
    assert z[0, 0] == pytest.approx(np.sqrt((1 + 9 + 4) / 4)) and z[-1, -1] == pytest.approx(0.5)
    np.testing.assert_allclose(heat.customdata[0][0], [2, 2.0, 1.0])
    assert np.nansum(np.array(heat.customdata)[..., 0]) == 3


def test_histograms_count_every_star_against_the_gaussian_of_its_own_sigma():
    rng = np.random.default_rng(3)
    sigma = rng.choice([0.05, 0.5], 10_000)
    stars = Residuals(np.zeros((10_000, 2)), sigma[:, None] * rng.normal(size=(10_000, 2)),
                      np.full(10_000, True), sigma, np.ones(10_000, np.int64))
    for chart in detector_charts.residual_histograms(stars):
        bars, line = chart.figure.data
        assert np.sum(bars.y) >= 9990
        assert np.sum(line.y) == pytest.approx(10_000 * (1 - 2 * norm.cdf(-4.5)))
        # Poisson: chi-square of 81 bins, those in which less than five are expected left out
        full = np.array(line.y) >= 5.0
        chi_square = np.sum((np.array(bars.y) - line.y)[full]**2 / np.array(line.y)[full])
        assert chi_square < 120.0


def test_maps_beside_each_other_have_one_size_whatever_their_numbers():
    for intrinsics in (INTRINSICS, INTRINSICS + 1e-9):
        layout = detector_charts.distortion_map('', DETECTOR, INTRINSICS, intrinsics).figure.layout
        assert layout.margin.autoexpand is False and layout.height == 330
        assert min(layout.margin.l, layout.margin.r, layout.margin.b) > 40      # for what is there


def test_distortion_map_is_that_of_the_camera_model():
    """T18 Table 1: 3 px at the edges; a map against the same camera is empty."""
    heat = detector_charts.distortion_map('', DETECTOR, INTRINSICS).figure.data[0]
    uv = np.array([[heat.x[3], heat.y[50]]]) - DETECTOR.centre_raster
    pinhole = np.array([*INTRINSICS[:3], 0.0, 0.0, 0.0, 0.0])
    r_s = camera.unproject(uv, pinhole, PITCH_MM)
    shift = np.linalg.norm(camera.project(r_s, INTRINSICS, PITCH_MM) - uv)
    assert heat.z[50][3] == pytest.approx(shift, rel=1e-6)
    assert 2.5 < np.max(heat.z) < 3.5
    empty = detector_charts.distortion_map('', DETECTOR, INTRINSICS, INTRINSICS)
    assert np.max(empty.figure.data[0].z) == 0.0 and len(empty.figure.data[1].x) == 0


# In a browser


def browse(folder, *options):
    """Run the browser on the report; return what it prints and what it says on the console."""
    if BROWSER is None:
        pytest.skip('chromium is not installed')
    done = subprocess.run([
        BROWSER, '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic',
        '--no-first-run', '--disable-background-networking', '--disable-component-update',
        '--disable-sync', f'--user-data-dir={folder / "profile"}', '--enable-logging=stderr',
        *options, (folder / 'report.html').as_uri()], text=True, capture_output=True,
        timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    return done.stdout, [line for line in done.stderr.splitlines() if 'CONSOLE' in line]


@pytest.fixture
def folder(made, tmp_path):
    """Return a new folder with the report alone in it."""
    shutil.copy(made / 'report.html', tmp_path)
    return tmp_path


@pytest.mark.parametrize('size', ['1280,900', '500,900'])
def test_browser_draws_every_figure_without_an_error(folder, size):
    dom, console = browse(folder, '--dump-dom', f'--window-size={size}')
    assert console == []
    figures = dom.split('<figure')[1:]
    assert len(figures) == CHARTS
    for figure in figures:
        assert 'js-plotly-plot' in figure and 'class="main-svg"' in figure
        assert re.search(r'class="(trace|hm)\b|class="imagelayer|<image', figure)
    # plotly's own choice of buttons has one that uploads the chart
    titles = set(re.findall(r'data-title="([^"]*)"', dom))
    assert {'Zoom', 'Reset axes'} <= titles
    assert not [title for title in titles if re.search('share|cloud|edit', title, re.I)]


@pytest.mark.slow
def test_browser_prints_the_page_without_an_error(folder):
    _, console = browse(folder, f'--print-to-pdf={folder / "report.pdf"}')
    assert console == []
    assert (folder / 'report.pdf').read_bytes().startswith(b'%PDF-')


@pytest.mark.slow
def test_browser_gives_every_picture_a_name(folder):
    dom, _ = browse(folder, '--dump-dom', '--window-size=1280,900')
    dom = re.sub(r'<script.*?</script>', '', dom, flags=re.S)
    svgs = re.findall(r'<svg\b[^>]*>', dom)
    named = [svg for svg in svgs if 'aria-label="' in svg and 'role="img"' in svg]
    assert len(named) == CHARTS
    assert all('aria-hidden="true"' in svg for svg in svgs if svg not in named)
    buttons = re.findall(r'<(?:a|button)\b[^>]*modebar-btn[^>]*>', dom)
    assert buttons and all('aria-label="' in button for button in buttons)


# The light page, and PDF


def test_light_page_has_the_same_charts_without_a_script(made):
    text = (made / 'light.html').read_text()
    assert len(text.encode()) < 600_000
    light, page = Page(text), Page((made / 'report.html').read_text())
    assert light.all('script') == [] and 'script-src' not in text
    assert [e['id'] for e in light.all('section')] == [e['id'] for e in page.all('section')]
    captions = [e['text'] for e in page.all('figcaption')]
    assert [e['text'] for e in light.all('figcaption')] == captions
    assert [e['aria-label'] for e in light.all('svg')] == captions
    assert len(re.findall(r'<path', text)) > 10 * CHARTS
    # Each name is of one thing, and what a picture refers to is there.
    names = re.findall(r' id="([^"]*)"', text)
    assert len(names) == len(set(names))
    assert set(re.findall(r'(?:xlink:href="|url\()#(\w+)', text)) <= set(names)


def test_light_page_and_page_have_colours_for_a_dark_screen(made):
    style = Page((made / 'light.html').read_text()).all('style')[0]['text']
    dark = style.partition('@media screen and (prefers-color-scheme: dark)')[2]
    for role in ROLES.values():
        assert f'--{role}: #' in style and f'--{role}: #' in dark.partition('}\n}')[0]
        assert role in ('text', 'grid', 'bound') or f'var(--{role},' in (
            made / 'light.html').read_text()


@pytest.mark.skipif(not PDF, reason='WeasyPrint, or Pango, is not installed')
def test_pdf_has_the_page_on_paper(made):
    content = (made / 'report.pdf').read_bytes()
    assert content.startswith(b'%PDF-') and content.rstrip().endswith(b'%%EOF')
    assert len(content) > 50_000


@pytest.mark.parametrize(('missing', 'said'), [
    (ImportError('no'), 'pip install starcal_ros[pdf]'),
    (OSError('cannot load library'), 'apt-get install libpango-1.0-0')])
def test_what_is_missing_for_pdf_is_said_before_the_work(made, tmp_path, capsys, monkeypatch,
                                                         missing, said):
    class Refusing:
        def find_spec(self, name, path=None, target=None):
            if name == 'weasyprint':
                raise missing
    monkeypatch.delitem(sys.modules, 'weasyprint', raising=False)
    monkeypatch.setattr(sys, 'meta_path', [Refusing(), *sys.meta_path])
    assert main(['calibrate', str(made / HOSTILE), '--out', str(tmp_path / 'r.json'),
                 '--report', str(tmp_path / 'r.pdf')]) == 2
    told = capsys.readouterr().err
    assert 'PDF needs WeasyPrint' in told and said in told
    assert not (tmp_path / 'r.json').exists()


@pytest.mark.parametrize(('options', 'said'), [
    (['--report', 'r.png'], 'r.png: a report ends in .html or .pdf'),
    (['--light-report', 'r.pdf'], '--light-report: r.pdf: is HTML; PDF is for --report')])
def test_reports_of_no_known_kind_are_refused(made, tmp_path, capsys, options, said):
    assert main(['calibrate', str(made / HOSTILE), '--out', str(tmp_path / 'r.json'),
                 *options]) == 2
    assert said in capsys.readouterr().err


def test_a_folder_is_called_by_its_name_whatever_leads_to_it(tmp_path, monkeypatch):
    (tmp_path / 'night').mkdir()
    monkeypatch.chdir(tmp_path / 'night')
    assert called('.') == called('../night/') == 'night'
    assert called('/') == '/'
