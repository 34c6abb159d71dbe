# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24's experiment: its scenes, its numbers, and studies that can be interrupted."""

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.core import camera
from starcal_ros.evaluation import consistency
from starcal_ros.reproduction import published, self2024, self2024_lens
from starcal_ros.reproduction.self2024 import (CAP, CONE, HALF_PX, METHODS, PINHOLE, PITCH_MM,
                                               RESULTS, TRUTH, UNIT, Point, bound, run, run_file,
                                               scenes, spots)
from starcal_ros.reproduction.self2024_lens import ESTIMATORS, Case

PAIRS = 50
T, S = [0, 1], [2, 3]


def rounds_of(point, pairs=PAIRS):
    return self2024.Rounds(**run_file(point, 1, 0, pairs))


@pytest.fixture(scope='module')
def rounds():
    """Return 100 rounds of the point that the paper states: 0.1 px, NF = 100, NS = 20."""
    return rounds_of(Point())


def test_all_stars_of_a_cone_are_seen_in_all_frames():
    v, C_si = scenes(np.random.default_rng(1), 3, Point(frames=50, stars=30))
    assert (v[..., 2] >= np.cos(CONE)).all()
    boresight = C_si[:, :, 2]
    assert (boresight[..., 2] >= np.cos(CAP)).all()
    uv = spots(v, C_si)
    assert (np.linalg.norm(uv - HALF_PX, axis=-1) < HALF_PX).all()
    np.testing.assert_allclose(C_si @ np.swapaxes(C_si, -1, -2),
                               np.broadcast_to(np.eye(3), C_si.shape), atol=1e-14)
    r_s = camera.unproject(uv[1, 7], PINHOLE, PITCH_MM)
    np.testing.assert_allclose(r_s, v[1] @ C_si[1, 7].T, atol=1e-13)


def test_stars_and_boresights_are_even_over_their_caps():
    """The cosine of the angle from the middle is even: its mean is the middle of its range."""
    v, C_si = scenes(np.random.default_rng(2), 40, Point(frames=50, stars=50))
    for cosine, half in ((v[..., 2], CONE), (C_si[:, :, 2, 2], CAP)):
        part = (1.0 - cosine) / (1.0 - np.cos(half))
        assert abs(part.mean() - 0.5) < 4.0 / np.sqrt(12.0 * part.size)


def test_two_rounds_of_a_pair_have_opposite_noise(rounds):
    """To first order the errors are opposite: what is left of their sum is the bias."""
    first, second = rounds.error[T, 0::2], rounds.error[T, 1::2]
    assert np.abs(first + second).max() < 0.03 * np.abs(first - second).max()


def test_total_errors_are_the_papers_and_near_the_bound(rounds):
    limit = bound(Point(), 1) * UNIT
    low, high = consistency.rms_interval(PAIRS, 0.999)
    f, x0 = rounds.total[:, 2], rounds.total[:, :2]
    assert low < f[0] / limit[0, 2] < 1.1 * high            # TCOC; the equations lose a little
    assert low < f[1] / limit[0, 2] < 1.1 * high
    assert low < f[3] / limit[1, 2] < 1.2 * high
    assert low < f[4] / limit[1, 2] < 1.2 * high
    assert ((low < x0 / limit[0, :2]) & (x0 / limit[0, :2] < 1.2 * high)).all()
    paper = [published.load('s24-point').PAPER_F_UM[name] for name in METHODS]
    # The paper's attitudes are not known, and matter in S.
    assert ((low / 1.1 < f[:4] / paper) & (f[:4] / paper < 1.1 * high)).all()
    assert ((low / 1.1 < x0 / 0.37) & (x0 / 0.37 < 1.1 * high)).all()


def test_biases_are_the_papers():
    """At 0.5 px (S24 Fig. 5): 0.07, 0.04 and 8.6 um, rounded, without signs; SCOC over 500 um."""
    rounds = rounds_of(Point(sigma_px=0.5), 30)
    bias, chance = rounds.bias[:, 2], 4.0 * rounds.bias_sigma[:, 2]
    for k, paper, rounding in ((0, 0.07, 0.005), (1, 0.04, 0.005), (3, 8.6, 0.05)):
        assert abs(abs(bias[k]) - paper) < rounding + 0.1 * paper + chance[k]
    assert bias[2] > 500.0
    # The principal point has none.
    unbiased = [0, 1, 3, 4]
    assert (np.abs(rounds.bias[unbiased, :2]) < 4.5 * rounds.bias_sigma[unbiased, :2]).all()


def test_expectation_taken_off_is_the_bias(rounds):
    bias, total = rounds.bias[:, 2], rounds.total[:, 2]
    assert bias[2] > 0.8 * total[2] > 70.0
    assert abs(bias[4]) < 0.005 * bias[2] and abs(bias[4]) < abs(bias[3])


def test_papers_iteration_leaves_some_rounds_of_tcwc_on_the_way(rounds):
    """Ten steps with lambda = 200; the slowest rounds are those with the least spread of stars."""
    late = np.abs(rounds.paper_error[0] - rounds.error[1])[:, 2] * UNIT[2]
    assert np.median(late) < 0.05 < late.max()
    assert self2024.rms(rounds.paper_error)[0, 2] > 1.5 * rounds.total[1, 2]
    v, _ = scenes(np.random.default_rng(np.random.SeedSequence(1, spawn_key=(100, 20, 0))), 4,
                  Point())
    spread = np.mean(1.0 - v @ np.swapaxes(v, -1, -2), axis=(1, 2))
    order = np.argsort(spread)
    assert late[0:8:2][order[0]] > late[0:8:2][order[-1]]


def test_bound_grows_with_the_noise_and_with_what_is_unknown():
    point = Point(frames=12, stars=8)
    limit = bound(point, 3)
    np.testing.assert_allclose(bound(Point(0.2, 12, 8), 3), 2.0 * limit, rtol=1e-6)
    assert (limit[1] > limit[0]).all() and limit[1, 2] > 50.0 * limit[0, 2]
    assert bound(point, 3, 4)[1, 2] > 2.0 * limit[1, 2]


def test_interrupted_study_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(self2024, '_PAIRS', 2)
    points, progress = [Point(0.1, 6, 5), Point(0.2, 6, 5)], []
    whole = run(points, 9, 1, tmp_path, progress.append)
    assert [len(result.error[0]) for result in whole] == [10, 10]      # whole pairs
    names = sorted(tmp_path.iterdir())
    assert len(names) == 6 and progress[-1] == 1.0
    before = {name: name.stat().st_mtime_ns for name in names[1:]}
    names[0].unlink()
    again = run(points, 9, 1, tmp_path, progress.append)
    assert {name: name.stat().st_mtime_ns for name in names[1:]} == before
    for a, b in zip(whole, again):
        np.testing.assert_array_equal(a.error, b.error)
        np.testing.assert_array_equal(a.paper_error, b.paper_error)


def test_point_gives_the_numbers_that_others_rely_on(tmp_path):
    outcome = published.load('s24-point').reproduce(TAN2018, 2, tmp_path, lambda part: None)
    entry = outcome.as_dict()
    for name in METHODS:
        assert set(entry[name]) == {'f_error_um', 'f_bias_um', 'x0_error_px', 'ms_per_round'}
        assert all(np.isfinite(value) for value in entry[name].values())
    assert len(entry['rows']) == len(RESULTS) + 2


def test_k1_is_worth_estimating_where_it_is_large(tmp_path):
    """1e-4 mm^-2 is 1.4 px at the edge of the field: the pinhole's f is wrong by over 1 mm."""
    point = Point(frames=60, stars=15)
    small, large = (self2024_lens.Errors(**self2024_lens.run_file(Case(point, k1), 1, 0, 8))
                    for k1 in (0.0, 1e-4))
    assert len(small.f_rms) == len(ESTIMATORS)
    limit = 1e3 * bound(point, 1, 4)[1, 2]
    low, high = consistency.rms_interval(8, 0.999)
    # SCOC less its expectation with k1: no bias, whatever k1 is, and near the bound.
    for errors in (small, large):
        assert low < errors.f_rms[2] / limit < 2.0 * high
    np.testing.assert_allclose(large.f_um[2], small.f_um[2], atol=0.02 * limit)
    # The pinhole: better without distortion, useless with it.
    assert small.f_rms[0] < 0.5 * small.f_rms[2] and small.angle_rms[0] < small.angle_rms[2]
    assert (large.f_um[0] < -1000.0).all()
    assert large.f_rms[0] > 3.0 * large.f_rms[2] and large.angle_rms[0] > 3.0 * large.angle_rms[2]
    assert TRUTH[2] * 1e3 > large.f_rms[1] > large.f_rms[2]     # r held tells less of f and k1
