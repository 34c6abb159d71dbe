# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes are named, with a value inside its sigma; right recordings give no finding."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from instruments import DETECTOR, EXTERNAL, PITCH_MM, TAN2018
from starcal_ros.checks.check import check
from starcal_ros.checks.finding import Finding, proposed
from starcal_ros.config import parameter_file
from starcal_ros.config.models import mounting_matrix
from starcal_ros.core import camera, rotation
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.recording import reader
from starcal_ros.reproduction import mistake_trial
from starcal_ros.reproduction.mistake_trial import KnownRecording
from starcal_ros.reproduction.user_mistakes import CLEAN, INSTRUMENTS, ROWS
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

NAMED = ('rates in deg/s', 'mounting inverse', "mounting to ROS's optical frame",
         'quaternion w first', 'gyro x and y swapped', 'all gyros reversed',
         'deg/s, and z reversed', 'bias of 98, -20, 41 deg/h', 'frames 2 ms late',
         'frames 3 s late', 'gyro clock 200 ppm fast', 'frames step by 40 ms',
         'angular random walk 0.01', 'gyro scale 1000 ppm', 'misalignments of 300 ppm',
         'centroids scatter by 0.15 px', 'messages state 0.1 px', 'pixel phase of 0.05 px',
         'centroids from the centre', 'v counts upwards', 'focal length of 16 mm stated',
         'detector 1280 x 1024 stated', 'gyro in TAI', '10 % wrong numbers')
ROW = {row.name: row for row in ROWS}
SHORT = TAN2018.replace({'simulation.duration_s': 150.0, 'motion.dwell_s': 2.0,
                         'motion.rate_deg_s': 1.5})


@cache
def messages(scenario=SHORT):
    """Return the readings and frames of a scenario."""
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    return gyro.next(gyro.count), tracker.next(tracker.count)


def source():
    """Return the short recording with its truth."""
    gyro, frames = messages()
    true = nominal(Truth.from_scenario(SHORT), int(frames.stamp_ns[-1]))
    return KnownRecording(gyro, frames, SHORT, true)


@pytest.mark.parametrize('name', NAMED)
def test_a_mistake_is_named_and_nothing_else(name):
    outcome = mistake_trial.run(ROW[name], source(), 1, calibrated=False)
    assert outcome.right and not outcome.wrong, outcome.checked
    assert not outcome.off > 4.5                    # NaN where it has no value


def test_what_is_right_gives_no_finding():
    outcome = mistake_trial.run(CLEAN, source(), 1, calibrated=False)
    assert outcome.checked.findings == outcome.checked.untold == ()


@pytest.mark.parametrize('name', [name for name in INSTRUMENTS if name != 'as configured'])
def test_other_instruments_that_are_right_give_no_finding(name):
    scenario = SHORT.replace(INSTRUMENTS[name])
    assert check(*messages(scenario), scenario).findings == ()


def test_sigmas_that_hold_the_trail_as_a_mean_give_no_finding():
    """As those of measured images: along the trail the noise is larger, across it smaller."""
    scenario = TAN2018.replace({'simulation.duration_s': 310.0, 'star_tracker.exposure_s': 0.2,
                                'star_tracker.smear': True})
    gyro, frames = messages(scenario)
    true, tracker = Truth.from_scenario(scenario), scenario.star_tracker
    rows = np.repeat(np.arange(len(frames)), np.diff(frames.first))
    half_ns = round(tracker.exposure_s * 0.5e9)
    before, at, after = (
        true.C_sg @ np.swapaxes(true.motion.attitude(frames.stamp_ns + shift), -1, -2)
        for shift in (-half_ns, 0, half_ns))
    r_s = camera.unproject(frames.uv_raster - DETECTOR.centre_raster, true.intrinsics, PITCH_MM)
    r_i = (np.swapaxes(at, -1, -2)[rows] @ r_s[..., None])[..., 0]
    begin, end = (camera.project((C_si[rows] @ r_i[..., None])[..., 0], true.intrinsics, PITCH_MM)
                  for C_si in (before, after))
    q = np.sum((end - begin)**2, axis=-1) / (12.0 * scenario.image.psf_sigma_px**2)
    stated = replace(frames, sigma=frames.sigma * np.sqrt(1.0 + q / 2.0))
    scenario = scenario.replace({'star_tracker.smear': False})
    assert q.max() > 5.0
    assert check(gyro, stated, scenario).findings == ()


@pytest.mark.skipif(not EXTERNAL.is_dir(), reason='not part of the checkout')
def test_a_recording_of_others_that_is_right_gives_no_finding():
    recording = reader.read(EXTERNAL)
    checked = check(recording.gyro, recording.frames,
                    parameter_file.load(EXTERNAL / 'config.yaml'))
    assert checked.findings == checked.untold == ()


def test_a_mounting_is_proposed_that_calibrates():
    outcome = mistake_trial.run(ROW['mounting inverse'], source(), 1)
    assert outcome.words[0] != 'not yet' and outcome.words[1] == 'not yet'
    assert outcome.after < 4.5
    finding, = outcome.checked.findings
    assert '60.' in finding.sentence and 'inverse' in finding.sentence
    found = proposed(SHORT, outcome.checked.findings)
    off = rotation.log(mounting_matrix(found.mounting) @ Truth.from_scenario(SHORT).C_sg.T)
    assert np.degrees(np.linalg.norm(off)) < 0.3


def test_at_rest_nothing_is_told_of_the_mounting():
    scenario = SHORT.replace({'motion.angles_deg': (0.0,) * 6})
    wrong = scenario.replace({'mounting.quaternion_xyzw': (0.0, 0.0, 0.0, 1.0)})
    checked = check(*messages(scenario), wrong)
    assert checked.findings == ()
    assert 'does not turn enough' in checked.untold[0]


@pytest.mark.parametrize('gyro_s', [5.0, 20.0, 31.0])
def test_readings_of_a_part_of_the_frames_are_compared_with_that_part(gyro_s):
    """As where a gyro falls silent, or its readings come later than the frames."""
    scenario = TAN2018.replace({'simulation.duration_s': 120.0})    # 30 s at rest, then a turn
    gyro, frames = messages(scenario)
    checked = check(gyro[:round(gyro_s * scenario.gyro.rate_hz)], frames, scenario)
    assert checked.findings == () and checked.untold


def test_a_turn_about_one_axis_does_not_tell_what_was_done_to_the_others():
    scenario = SHORT.replace({'motion.axes': ('z', 'z'), 'motion.angles_deg': (30.0, -30.0)})
    gyro, frames = messages(scenario)
    right = check(gyro, frames, scenario)
    assert right.findings == ()
    swapped = replace(gyro, rate=gyro.rate[:, [1, 0, 2]])
    assert not [each for each in check(swapped, frames, scenario).findings
                if each.parameters or each.driver]


def test_proposals_make_a_scenario_and_take_what_is_none_out_of_it():
    fixed = proposed(SHORT.replace({'gyro.arw_deg_sqrt_h': 0.5}), [
        Finding('mounting', '', '', parameters={'mounting.quaternion_xyzw': None,
                                                'mounting.fixed_angles_deg': (1.0, 2.0, 3.0)}),
        Finding('angular random walk', '', '', parameters={'gyro.arw_deg_sqrt_h': 0.25})])
    assert fixed.mounting.fixed_angles_deg == (1.0, 2.0, 3.0)
    assert fixed.mounting.quaternion_xyzw is None and fixed.gyro.arw_deg_sqrt_h == 0.25
