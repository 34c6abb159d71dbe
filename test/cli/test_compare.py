# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal compare``: calibrations that agree, that do not, and that can not be compared."""

import json

import pytest

from instruments import CONFIG
from starcal_ros.cli import main

SEEDS = (1, 2, 3)


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    """Return the results of three recordings of one instrument, of half a minute each."""
    folder = tmp_path_factory.mktemp('compare')
    for seed in SEEDS:
        bag, config = folder / f'{seed}.mcap', folder / f'{seed}.yaml'
        config.write_text(CONFIG.read_text().replace('2026-07-02T12', f'2026-07-0{seed}T12'))
        words = ['--config', str(config), '--out']
        assert main(['simulate', *words, str(bag), '--duration', '30', '--seed', str(seed)]) == 0
        assert main(['calibrate', str(bag), *words, str(folder / f'{seed}.json')]) == 3
    return [folder / f'{seed}.json' for seed in SEEDS]


@pytest.fixture
def compare(capsys):
    """Return a function that runs the command and returns status and both outputs."""
    def run(*words):
        status = main(['compare', *map(str, words)])
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return status, out, err
    return run


def changed(folder, path, **values):
    """Return a file with other values in a result."""
    found = json.loads(path.read_text())
    for key, value in values.items():
        found[key] = {**found[key], **value} if isinstance(value, dict) else value
    other = folder / 'changed.json'
    other.write_text(json.dumps(found))
    return other


def test_calibrations_of_one_instrument_agree(compare, results):
    status, out, err = compare(*results[:2])
    assert (status, err) == (0, '')
    assert out.rstrip().endswith('They agree') and 'px RMS over the detector' in out
    assert 'a star is elsewhere in the gyro axes by' in out and 'With time' not in out
    assert len([line for line in out.splitlines() if ' ± ' in line]) == 13 + 1     # the caption


def test_three_are_compared_with_the_first_and_with_time(compare, results):
    status, out, _ = compare(*results)
    assert status == 0 and 'With time' in out
    status, out, _ = compare(*results, '--json')
    told = json.loads(out)
    assert status == 0 and told['agree'] and told['warnings'] == []
    assert [each['name'] for each in told['less_the_first']] == [str(each) for each in results[1:]]
    over = told['less_the_first'][0]['over_the_detector']
    assert 0.2 < over['rms_px'] / over['rms_by_the_sigmas_px'] < 3.0
    assert told['groups']['mounting and camera']['degrees_of_freedom'] == 20
    assert [each['name'] for each in told['trends']][-1] == 'p2'
    assert told['trends'][0]['constant']['degrees_of_freedom'] == 2


def test_a_camera_that_has_changed_is_told_with_status_4(compare, results, tmp_path):
    found = json.loads(results[1].read_text())
    f, sigma = found['intrinsics']['f_mm'], found['intrinsics_sigma']['f_mm']
    other = changed(tmp_path, results[1], intrinsics={'f_mm': f + 20.0 * sigma})
    status, out, _ = compare(results[0], other)
    assert status == 4 and 'They differ: ' in out and 'camera' in out.rpartition('differ: ')[2]
    assert json.loads(compare(results[0], other, '--json')[1])['agree'] is False


def test_results_that_share_data_or_are_not_believed_are_warned_of(compare, results, tmp_path):
    other = changed(tmp_path, results[0], verdict='inconsistent')
    _, _, err = compare(results[0], other)
    assert 'are of the same recording' in err and 'changed.json is inconsistent' in err
    other = changed(tmp_path, results[1], provenance={'began_with': str(results[0])})
    assert 'one began with what the other found' in compare(results[0], other)[2]


def test_without_a_detector_pixels_are_not_told_but_with_config(compare, results, tmp_path):
    bare = []
    for k, path in enumerate(results[:2]):
        found = json.loads(path.read_text())
        del found['detector']
        bare.append(tmp_path / f'{k}.json')
        bare[-1].write_text(json.dumps(found))
    status, out, err = compare(*bare)
    assert status == 0 and 'nothing is told in pixels' in err and 'px RMS' not in out
    _, out, err = compare(*bare, '--config', CONFIG)
    assert err == '' and 'px RMS' in out


def test_what_can_not_be_compared_is_refused(compare, results, tmp_path):
    status, _, err = compare(results[0])
    assert status == 2 and 'needs two results' in err
    status, _, err = compare(results[0], tmp_path / 'none.json')
    assert status == 2 and 'none.json: cannot be read' in err
    other = changed(tmp_path, results[1], detector={'width': 2048})
    status, _, err = compare(results[0], other)
    assert status == 2 and 'not of one detector' in err and '2048 x 1024' in err
