# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the page is told of a moment: the states, the tests and the stars as they were heard."""

import json

import numpy as np
import pytest

from starcal_ros.filter import advice
from starcal_ros.filter.states import N_STATES, STATE_NAMES, UNIT
from starcal_ros.live.heard import STATE_SIZE, Seen
from starcal_ros.live.picture import encoded, picture

STARS = np.dtype([('u', 'f8'), ('v', 'f8'), ('du', 'f8'), ('dv', 'f8'), ('catalog_id', 'u4'),
                  ('nis', 'f4'), ('accepted', 'u1')])


def state(**sigmas):
    """Return data of `starcal/state` with a sigma of 1 in human units, or another."""
    data = np.zeros(STATE_SIZE)
    data[0] = 1_782_993_600.25
    sigma = np.array([sigmas.get(name, 1.0) for name in STATE_NAMES]) * UNIT
    data[1 + N_STATES:] = np.diag(sigma**2).ravel()
    return data


def test_before_anything_is_heard_there_is_a_picture_that_says_so():
    told = json.loads(encoded(Seen()))
    assert told['verdict'] == {'word': 'silence', 'text': 'no estimator is heard so far',
                               'kind': 'gone'}
    assert told['states'] == told['tests'] == told['rates'] == told['counts'] == []
    assert told['stars'] is None and told['detector'] is None and told['stamp'] == ''


@pytest.mark.parametrize('message, level, kind', [
    ('converged', 0, 'good'), ('not yet: u0, v0; rotate about Y', 0, 'open'),
    ('disabled', 1, 'warning'), ('inconsistent: NIS of the turns 2', 2, 'bad'),
    ('lost: most stars are rejected', 2, 'bad')])
def test_only_what_has_converged_is_good(message, level, kind):
    told = picture(Seen(message=message, level=level, silent_s=0.0))['verdict']
    word, _, rest = message.partition(': ')
    assert told == {'word': word, 'text': rest, 'kind': kind}
    assert picture(Seen(message=message, level=level, silent_s=9.0))['verdict']['kind'] == 'gone'


def test_states_are_called_the_same_in_tables_and_in_sentences():
    told = picture(Seen(
        state(), message='not yet: epsilon_x, psi_z, u0; rotate about Y', silent_s=0.0,
        values={'not_told_apart': 'psi_y, u0 (why): more frames are needed'}))
    assert told['verdict']['text'] == 'ε_x, Ψ_z, u0; rotate about Y'
    assert told['not_told_apart'] == 'Ψ_y, u0 (why): more frames are needed'
    assert {'ε_x', 'Ψ_y', 'Ψ_z', 'u0'} < {each['label'] for each in told['states']}


@pytest.mark.parametrize('level', [0, 1, 2, 3])
def test_where_the_data_contradict_the_model_the_sigmas_are_doubted(level):
    assert ('not to be believed' in picture(Seen(level=level))['doubt']) == (level == 2)


def test_states_have_their_sigmas_over_their_tolerances():
    values = {'tolerance_u0': '0.5', 'tolerance_psi_x': '4'}
    told = {each['name']: each for each in picture(Seen(state(), values=values))['states']}
    assert list(told) == list(STATE_NAMES[3:])          # no attitude: it is no calibration
    assert told['u0']['ratio'] == pytest.approx(2.0) and not told['u0']['within']
    assert told['psi_x']['ratio'] == pytest.approx(0.25) and told['psi_x']['within']
    assert (told['psi_x']['of'], told['psi_x']['unit']) == ('°', '″')
    assert (told['u0']['sigma'], told['u0']['tolerance'], told['u0']['unit']) == ('1', '0.5', 'px')
    assert told['f']['ratio'] is None and not told['f']['within']       # not known


def test_tests_stand_at_their_places_in_their_bands():
    values = {'nis_of_the_turns': '1.5', 'nis_of_the_turns_low': '0.5',
              'nis_of_the_turns_high': '1.5', 'other': '6', 'other_low': '0', 'other_high': '1',
              'sigma_u0': '3'}
    first, second = picture(Seen(values=values))['tests']
    assert first == {'name': 'NIS of the turns', 'value': '1.5', 'low': '0.5', 'high': '1.5',
                     'passed': True, 'place': 1.0}
    # eleven half widths from the middle
    assert second['place'] == pytest.approx(1.0 + np.log10(11.0)) and not second['passed']


def test_stars_are_rows_of_finite_numbers_and_say_how_odd_they_are():
    stars = np.array([(1.25, 2.5, 0.1, -0.2, 7, nis, used) for nis, used in (
        (2.29, 1), (2.31, 1), (9.22, 1), (99.0, 0), (np.nan, 1))], STARS)
    told = picture(Seen(stars=stars, size=(1024, 768)))
    assert told['detector'] == [1024, 768]
    assert [row[:4] for row in told['stars']] == [[1.25, 2.5, 0.1, -0.2]] * 4
    assert [row[5:] for row in told['stars']] == [[1, 0], [1, 1], [1, 2], [0, 2]]


def test_numbers_that_are_not_finite_are_no_part_of_the_picture():
    values = {'tolerance_u0': 'inf', 'x': 'nan', 'x_low': '0', 'x_high': '1',
              'time_to_go_s': 'nan'}
    told = json.loads(encoded(Seen(state(), values=values)))
    assert told['tests'][0]['place'] is None and told['time_to_go'] == ''
    assert {each['name']: each['ratio'] for each in told['states']}['u0'] == 0.0
    assert {each['name']: each['ratio'] for each in told['states']}['v0'] is None


def test_no_time_goes_where_it_is_done():
    assert picture(Seen(values={'time_to_go_s': '0'}))['time_to_go'] == ''
    assert picture(Seen(values={'time_to_go_s': '30'}))['time_to_go'] == '30 s more'


def test_rates_counts_time_and_what_can_not_be_told_apart():
    told = picture(Seen(
        values={'frames': '40', 'waiting_frames': '1', 'advice': 'rotate about -Y; as it is more',
                'time_to_go_s': '720', 'not_told_apart': 'u0, psi_y: rotate',
                'reprojection_rms_u_px': '0.1', 'reprojection_rms_v_px': '0.2'},
        inputs_message='receiving', inputs={
            '/a/imu/data_raw messages_per_second': '99.5', '/a/imu/data_raw messages': '95',
            '/a/imu/data_raw lost_by_middleware': '2'}))
    assert told['rates'] == [{'topic': '/a/imu/data_raw', 'hz': '99.5', 'lost': '2'}]
    assert told['counts'] == [['frames', '40'], ['waiting frames', '1']]
    assert (told['axis'], told['time_to_go']) == ('-Y', '12 min more')
    assert told['not_told_apart'] == 'u0, Ψ_y: rotate'
    assert told['reprojection'] == '0.1000, 0.2000 px'


def test_the_axis_is_found_in_every_rotation_that_is_advised():
    found = [advice.advised_axis(motion.text) for rate in (np.zeros(3), np.ones(3))
             for motion in advice.motions(rate, 0.1)]
    turns = {'X', 'Y', 'Z', '-X', '-Y', '-Z'}
    assert turns <= set(found) <= turns | {''}


def test_text_that_steers_a_terminal_is_written_out():
    hostile = 'lost: \x1b[31m\u202e'
    told = json.loads(encoded(Seen(
        message=hostile, values={'advice': hostile, 'frames': hostile}, inputs_message=hostile,
        inputs={f'{hostile} messages_per_second': '1'}, silent_s=0.0)))
    said = ' '.join([*told['verdict'].values(), told['advice'], told['inputs'],
                     told['rates'][0]['topic'], told['counts'][0][1]])
    assert said.isprintable() and said.count(r'\x1b[31m') == 5
