# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The tutorial and the notebook say what comes out when one does what they say."""

import json
import re

import matplotlib
import pytest

from instruments import TOP
from starcal_ros.cli import main

NIGHT = TOP / 'examples' / 'night'
TEXT = (TOP / 'docs' / 'howto' / 'tutorial.md').read_text()


@pytest.fixture(scope='module')
def camera(tmp_path_factory):
    """Return the camera of the tutorial, and its page."""
    pytest.importorskip('tetra3rs')
    folder = tmp_path_factory.mktemp('night')
    status = main(['intrinsics', str(NIGHT), '--out', str(folder / 'camera.json'),
                   '--light-report', str(folder / 'camera.html')])
    assert status == 4
    return json.loads((folder / 'camera.json').read_text()), (
        folder / 'camera.html').read_text()


@pytest.mark.slow
def test_tutorial_has_the_camera_that_its_command_gives(camera):
    outcome, _ = camera
    row = re.search(r'\| f \[px\] \| ([\d.]+) \| ([\d.]+) \|', TEXT)
    assert outcome['f_px'] == pytest.approx(float(row[1]), abs=float(row[2]))
    assert outcome['sigma']['f_px'] == pytest.approx(float(row[2]), rel=0.1)
    u0, v0 = (float(word) for word in re.search(
        r'\| u0, v0 \[px\] \| ([\d.]+), ([\d.]+) \|', TEXT).groups())
    assert outcome['u0_px'] == pytest.approx(u0, abs=outcome['sigma']['u0_px'])
    assert outcome['v0_px'] == pytest.approx(v0, abs=outcome['sigma']['v0_px'])
    stars = int(re.search(r'(\d+) stars were used', TEXT)[1])
    assert outcome['counts']['stars'] == pytest.approx(stars, rel=0.02)


@pytest.mark.slow
def test_camera_agrees_with_what_other_code_found(camera):
    other, sigma = (float(word) for word in re.search(
        r'f = (\d+\.\d+) ± (\d+\.\d+)', TEXT).groups())
    own = max(camera[0]['sigma_between_images']['f_px'], camera[0]['sigma']['f_px'])
    assert abs(camera[0]['f_px'] - other) < 3.0 * (sigma**2 + own**2)**0.5


@pytest.mark.slow
def test_verdict_and_the_wave_over_the_pixel_are_as_told(camera):
    outcome, page = camera
    assert outcome['verdict'] == 'inconsistent' and 'Verdict: inconsistent' in TEXT
    failing = {each['name']: each['value'] for each in outcome['consistency']
               if not each['passed']}
    told = float(re.search(r'mean over the pixel ([\d.]+)', TEXT)[1])
    assert failing['mean over the pixel'] == pytest.approx(told, rel=0.2)
    assert 'Mean u [px] over place in the pixel' in page


def test_pictures_have_their_licence_beside_them():
    assert len(list(NIGHT.glob('*.png'))) == 6
    assert 'MIT License' in (NIGHT / 'LICENSE').read_text()
    assert sum(path.stat().st_size for path in NIGHT.iterdir()) < 1_500_000


def test_notebook_runs_and_its_estimates_are_consistent(monkeypatch, capsys):
    """NEES of 13 degrees of freedom: beyond 40 once in 8000."""
    matplotlib.use('agg')
    monkeypatch.chdir(TOP / 'examples')
    notebook = json.loads((TOP / 'examples' / 'calibrate.ipynb').read_text())
    assert notebook['nbformat'] == 4
    spoken: dict[str, object] = {}
    for cell in notebook['cells']:
        assert cell['id'] and not cell.get('outputs')
        if cell['cell_type'] == 'code':
            exec(''.join(cell['source']), spoken)
    said = capsys.readouterr().out
    assert '30000 readings, 600 frames' in said
    assert float(re.search(r'NEES ([\d.]+) of 13', said)[1]) < 40.0
    assert len(spoken['figure'].axes) == 3
