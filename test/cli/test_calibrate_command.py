# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the commands simulate, calibrate and info give, as tables and as JSON."""

import hashlib
import json
import re

import numpy as np
import pytest

from instruments import CONFIG, TAN2018
from refusals import NOT_YET, assert_refused, altered
import starcal_ros
from starcal_ros.cli import COMMANDS
from starcal_ros.config import parameter_file
from starcal_ros.recording import reader
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.results import initial
from starcal_ros.results.store import CalibrationStore
from starcal_ros.simulation import sensors


TOPICS = {'/imu/data_raw': ('sensor_msgs/msg/Imu', 2000),
          '/star_tracker/centroids': ('sensor_msgs/msg/PointCloud2', 40),
          '/star_tracker/camera_info': ('sensor_msgs/msg/CameraInfo', 1),
          '/truth/attitude': ('geometry_msgs/msg/QuaternionStamped', 40),
          '/truth/parameters': ('std_msgs/msg/Float64MultiArray', 1)}


def test_recording_that_gives_no_calibration_is_told_with_the_counts(starcal, bag, tmp_path):
    """Exit status 1: nothing is wrong with the input, but a lens of 50 mm was never there."""
    path = altered(tmp_path, 'focal_length_mm: 25.5', 'focal_length_mm: 50.0')
    done = starcal('calibrate', bag, '--config', path, '--out', tmp_path / 'result.json')
    assert_refused(done, 'calibrate', 'no attitude', '2000 gyro readings', '40 frames', status=1)
    assert not (tmp_path / 'result.json').exists()


def test_figure_that_can_not_be_written_is_wrong_input(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'result.json',
                   '--figure', tmp_path / 'nowhere' / 'figure.png')
    assert_refused(done, 'calibrate', tmp_path / 'nowhere' / 'figure.png')


def test_info_lists_the_topics_with_types_and_counts(starcal, bag):
    done = starcal('info', bag)
    assert (done.status, done.err) == (0, '')
    for topic, (type_name, count) in TOPICS.items():
        line, = [line for line in done.out.splitlines() if topic in line]
        assert type_name in line
        assert str(count) in re.findall(r'\d+', line.split(type_name)[1])
    assert 'config.yaml' in done.out and 'truth.json' in done.out
    assert str(bag) in done.out.replace('\n', '')


def test_every_command_gives_json(starcal):
    for words in [[name] for name in COMMANDS if name != 'config'] + [
            ['config', action] for action in ('new', 'check', 'describe', 'list')]:
        assert '--json' in starcal(*words, '--help').out, words


def test_info_as_json_is_all_that_it_tells(starcal, bag):
    done = starcal('info', bag, '--json', '--check')
    told = json.loads(done.out)
    assert (done.status, done.err, told['recording']) == (0, '', str(bag))
    assert {each['name']: (each['type'], each['messages'])
            for each in told['topics']} == TOPICS
    assert {each['read_as']: each['name'] for each in told['topics'] if each['read_as']} == {
        'gyro': '/imu/data_raw', 'frames': '/star_tracker/centroids'}
    gyro = next(each for each in told['topics'] if each['read_as'] == 'gyro')
    assert gyro['rate_hz'] == pytest.approx(100.0)
    assert gyro['last_ns'] - gyro['first_ns'] == 19_990_000_000
    assert set(told['attachments']) == {'config.yaml', 'truth.json'}
    assert told['warnings'] == told['stamps'] == []
    assert told['bytes'] == bag.stat().st_size
    found = told['check']['files'][bag.name]
    assert told['check']['sound'] and found['messages'] == 2082 and found['faults'] == []
    assert 'check' not in json.loads(starcal('info', bag, '--json').out)


def test_info_as_json_tells_what_is_damaged(starcal, bag, tmp_path):
    damaged, path = bytearray(bag.read_bytes()), tmp_path / 'damaged.mcap'
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(damaged)
    done = starcal('info', path, '--json', '--check')
    told = json.loads(done.out)
    assert done.status == 4 and not told['check']['sound']
    assert told['check']['files'][path.name]['faults']


@pytest.mark.parametrize('command', ['calibrate', 'intrinsics'])
def test_json_is_what_the_file_has_and_nothing_else_is_printed(starcal, bag, tmp_path, command):
    out = tmp_path / 'out.json'
    done = starcal(command, bag, '--out', out, '--json')
    assert done.status in (0, NOT_YET)
    assert json.loads(done.out) == json.loads(out.read_text())


def test_seed_makes_the_noise_and_nothing_else_does(starcal, tmp_path):
    """The same seed gives the same messages to the bit, another one others."""
    runs = []
    for k, seed in enumerate((7, 7, 8)):
        path = tmp_path / f'{k}.mcap'
        assert starcal('simulate', '--out', path, '--duration', '2', '--seed', seed).status == 0
        runs.append(reader.read(path))
    first, again, other = runs
    np.testing.assert_array_equal(first.gyro.rate, again.gyro.rate)
    np.testing.assert_array_equal(first.frames.uv_raster, again.frames.uv_raster)
    assert (first.gyro.rate != other.gyro.rate).all()
    assert first.frames.stamp_ns.tolist() == other.frames.stamp_ns.tolist()


def test_simulate_as_json_is_what_the_recording_holds(starcal, tmp_path):
    path = tmp_path / 'run.mcap'
    done = starcal('simulate', '--out', path, '--duration', '5', '--seed', '7', '--json')
    told, held = json.loads(done.out), json.loads(starcal('info', path, '--json').out)
    assert (done.status, told['out'], told['seed']) == (0, str(path), 7)
    assert told['duration_s'] == 5.0 and told['messages']['/imu/data_raw'] == 500
    assert told['messages'] == {each['name']: each['messages'] for each in held['topics']}


def test_simulated_recording_carries_the_scenario_that_was_run(bag):
    attached = reader.read(bag).attachments['config.yaml'].decode()
    carried = parameter_file.parse(attached, 'bag')
    assert carried == TAN2018.replace({'simulation.duration_s': 20.0})


def test_calibrate_writes_the_result_and_says_where_it_came_from(starcal, bag, tmp_path):
    path = tmp_path / 'result.json'
    done = starcal('calibrate', bag, '--config', CONFIG, '--out', path)
    assert done.status == NOT_YET
    outcome = json.loads(path.read_text())
    assert np.shape(outcome['covariance']) == (16, 16)
    provenance = outcome['provenance']
    assert provenance['version'] == starcal_ros.__version__
    assert provenance['bag_sha256'] == hashlib.sha256(bag.read_bytes()).hexdigest()
    assert provenance['config_sha256'] == TAN2018.sha256
    # to be read by a person: what was estimated
    for name in ('u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2'):
        assert re.search(rf'\b{name}\b', done.out)
    assert 'not converged' in done.out and outcome['converged'] is False        # after 20 s
    assert '40 frames' in done.out and '2000 gyro readings' in done.out


def test_data_that_contradict_the_model_are_told_with_their_sigmas_scaled(starcal, tmp_path):
    """Stars of three times the stated noise: variance 9, sigmas of the camera times 3."""
    bag, out = tmp_path / 'noisy.mcap', tmp_path / 'r.json'
    noisy = altered(tmp_path, '    truth:  ', '    truth.star_tracker.centroid_sigma_px: 0.15\n'
                    '    truth:  ')
    assert starcal('simulate', '--config', noisy, '--out', bag, '--duration', 60).status == 0
    done = starcal('calibrate', bag, '--config', noisy, '--out', out)
    outcome = json.loads(out.read_text())
    assert done.status == 4 and outcome['verdict'] == 'inconsistent'
    assert 'the sigmas are not to be believed' in done.out and 'scaled sigma' in done.out
    failing = [each['name'] for each in outcome['consistency'] if not each['passed']]
    verdict = done.out[done.out.index('Verdict: inconsistent: '):]
    assert len(failing) > 1 and all(name in verdict for name in failing)
    assert outcome['advice'] == 'do not believe the sigmas: find what contradicts the model'


def test_what_explains_late_stamps_is_said_and_adopted_where_asked_for(starcal, tmp_path):
    bag, out, page = (tmp_path / name for name in ('late.mcap', 'r.json', 'r.html'))
    late = altered(tmp_path, '    truth:  ', '    truth.star_tracker.time_offset_s: 0.005\n'
                   '    truth:  ')
    assert starcal('simulate', '--config', late, '--out', bag, '--duration', 120).status == 0
    done = starcal('calibrate', bag, '--config', late, '--out', out, '--report', page, '--adopt')
    outcome = json.loads(out.read_text())
    found, line = outcome['explanations'], outcome['provenance']['adopted']
    assert found['to_adopt'] == found['tried'][0]['name'] == 'time offset of the star tracker'
    assert found['tried'][0]['lines'] == [line] and 'time_offset_sigma_s: ' in line
    assert found['tried'][0]['score'] > found['tried'][1]['score'] + 12.0
    assert done.status == NOT_YET and outcome['verdict'] == 'not yet'
    assert outcome['augmented']['names'] == ['tau_s']
    # A frame that is stamped late shows the sky of before its stamp.
    (tau_s,), (sigma_s,) = (outcome['augmented'][key] for key in ('estimates', 'sigmas'))
    assert abs(tau_s + 0.005) < 4.5 * sigma_s
    assert f'Adopted: {line}' in done.out and f'Adopted: {line}' in page.read_text()


def test_calibrate_exports_and_begins_with_what_was_saved(starcal, bag, tmp_path):
    """The second run starts where the first ended, as the node would."""
    scenario = TAN2018.replace({'estimator.calibration_directory': str(tmp_path / 'saved'),
                                'estimator.load_calibration': True})
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(scenario))
    words = ['calibrate', bag, '--config', config, '--out', tmp_path / 'result.json']
    first = starcal(*words, '--export', tmp_path / 'export')
    assert first.status == NOT_YET and 'has no calibration' in first.err
    assert sorted(path.name for path in (tmp_path / 'export').iterdir()) == [
        'camchain.yaml', 'camera_info.yaml', 'cameras.txt', 'imu.yaml', 'opencv.yaml']
    outcome = json.loads((tmp_path / 'result.json').read_text())
    folder = CalibrationStore(tmp_path / 'saved').save(initial.files(outcome, scenario))
    second = starcal(*words, '--overwrite')
    assert second.status == NOT_YET and f'calibration {folder}' in ' '.join(second.err.split())
    better = json.loads((tmp_path / 'result.json').read_text())
    assert better['provenance']['began_with'] == str(folder)
    assert (np.diagonal(better['covariance'])[9:] < np.diagonal(outcome['covariance'])[9:]).all()


def test_json_is_what_the_file_holds_and_nothing_else(starcal, bag, tmp_path):
    out = tmp_path / 'result.json'
    for words in (['calibrate', bag], ['intrinsics', bag],
                  ['montecarlo', '--runs', '1', '--duration', '20']):
        done = starcal(*words, '--out', out, '--overwrite', '--json')
        assert done.status in (0, NOT_YET, 4), done.err
        assert json.loads(done.out) == json.loads(out.read_text())


def test_export_to_a_file_is_wrong_input(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'result.json', '--export', bag)
    assert_refused(done, 'calibrate', bag, 'cannot be made')


def test_calibrate_draws_its_figure(starcal, bag, tmp_path):
    path = tmp_path / 'figure.png'
    done = starcal('calibrate', bag, '--out', tmp_path / 'r.json', '--figure', path)
    assert done.status == NOT_YET
    assert path.read_bytes().startswith(b'\x89PNG\r\n\x1a\n')


def test_gap_in_a_recording_is_a_warning_and_not_the_end(starcal, tmp_path):
    gyro, frames = sensors.gyro(TAN2018).next(1000), sensors.star_tracker(TAN2018).next(20)
    with Writer(tmp_path / 'gap.mcap') as writer:
        for part in (gyro[:400], gyro[600:]):
            writer.write_batches(imu_batch('/imu/data_raw', part))
        writer.write_batches(centroids_batch('/star_tracker/centroids', frames))
    done = starcal('calibrate', tmp_path / 'gap.mcap', '--config', CONFIG, '--out',
                   tmp_path / 'r.json')
    assert done.status == NOT_YET
    line, = [line for line in done.err.splitlines() if line.startswith('warning: ')]
    assert 'silent for 2.010 s' in line
    assert json.loads((tmp_path / 'r.json').read_text())['counts']['gyro_gaps'] == 1


def test_states_are_called_the_same_in_table_and_verdict(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'r.json')
    said = done.out.partition('Verdict: ')[2]
    assert 'ε_x, ' in done.out and 'not yet: ε_x, ' in said and 'epsilon' not in done.out
