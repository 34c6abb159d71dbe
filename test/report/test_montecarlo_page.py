# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a Monte Carlo has the numbers of its summary, and says what is outside."""

import json
import re

from instruments import CONFIG
from starcal_ros.cli import main
from starcal_ros.report.markup import document
from starcal_ros.report.montecarlo_page import montecarlo_page


def test_command_writes_the_page_of_a_sweep(tmp_path):
    out, page = tmp_path / 'study.json', tmp_path / 'study.html'
    assert main(['montecarlo', '--config', str(CONFIG), '--runs', '2', '--duration', '20',
                 '--sweep', 'star_tracker.centroid_sigma_px=0.05,0.1', '--out', str(out),
                 '--light-report', str(page)]) == 0
    summary, text = json.loads(out.read_text()), page.read_text()
    for point in summary['points']:
        value = point['star_tracker.centroid_sigma_px']
        assert f'star_tracker.centroid_sigma_px = {value}' in text
        for state in point['states'].values():
            assert f'<td>{state["rms"]:.3g}</td><td>{state["bound"]:.3g}</td>' in text
    assert len(re.findall('<figcaption>', text)) == 16 + 2
    assert '2 of 20.0 s at each of 2 values' in text and '--runs 2' in text
    assert re.search(r'<title>Monte Carlo of tan2018.yaml</title>', text)


def point(nees):
    """Return the summary of a study by its mean NEES."""
    return {'runs': 50, 'duration_s': 60.0, 'nees_degrees': 16, 'nees_mean': nees,
            'nees_interval_95': [14.5, 17.6], 'nis_mean': 1.0, 'nis_interval_95': [0.99, 1.01],
            'ratio_interval_95': [0.8, 1.2], 'verdicts': {'not yet': 50}, 'failed_tests': {},
            'states': {'f': {'unit': 'mm', 'rms': 1.3, 'bound': 1.0, 'ratio': 1.3, 'prior': 0.1,
                             'sigma': 1.0}}}


def test_errors_that_are_not_as_large_as_stated_are_said():
    text = document(montecarlo_page(point(16.0), 'x'), light=True)
    assert 'class="verdict yes"' in text and 'not yet: 50 runs.' in text
    text = document(montecarlo_page(point(30.0), 'x'), light=True)
    assert 'class="verdict no"' in text and 'NEES 30 of 16 states' in text
    assert ': outside.' in text
