# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the linear model of a frame leaves out, and what becomes of sigmas that would ignore it."""

import numpy as np
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config.models import detector, intrinsics
from starcal_ros.core import camera, rotation
from starcal_ros.filter.curvature import REPEATS, Curvature, bends
from starcal_ros.filter.error_state import Filter
from starcal_ros.measurements.samples import Stars
from starcal_ros.reproduction import first_errors

NARROW = TAN2018.replace({
    'camera.focal_length_mm': 189.0, 'star_tracker.limiting_magnitude': 9.5,
    'motion.dwell_s': 5.0, 'simulation.duration_s': 60.0})
DETECTOR, CAMERA = detector(NARROW.camera), intrinsics(NARROW.camera)
SIGMA = np.array([*(1e-4,) * 3, 5.0, 5.0, 0.1, 1e-3, 1e-5, 1e-4, 1e-4])


def directions(rng, n=20):
    uv = rng.uniform(-500.0, 500.0, (n, 2))
    return camera.unproject(uv, CAMERA, DETECTOR.pitch_mm)


def test_what_is_left_out_is_what_the_exact_camera_shows():
    """Against the second differences of the projection itself, over drawn pairs of errors."""
    rng = np.random.default_rng(1)
    r_s, L = directions(rng), rng.normal(size=(10, 10)) * SIGMA[:, None] * 0.3
    xi = rng.normal(size=(4000, 10))

    def seen(x):
        turned = r_s @ np.swapaxes(rotation.exp(x[..., :3]), -1, -2)
        return camera.project(turned, CAMERA + x[..., 3:], DETECTOR.pitch_mm)

    x = xi @ L.T
    second = 0.5 * (seen(x) + seen(-x) - 2.0 * seen(np.zeros(10)))
    expected = np.sqrt(REPEATS) * second.std(axis=0).max(axis=-1)
    found = Curvature(DETECTOR, CAMERA).left_out(r_s, CAMERA, L, np.full(len(r_s), 0.05))
    np.testing.assert_allclose(found, expected, rtol=0.1)


def test_it_is_nothing_where_the_linear_model_holds():
    rng = np.random.default_rng(2)
    left_out = Curvature(DETECTOR, CAMERA).left_out
    sigma = np.full(20, 0.05)
    for part, matters in ((1.0, True), (1e-3, False)):
        found = left_out(directions(rng), CAMERA, np.diag(SIGMA) * part, sigma)
        assert found.any() == matters
    assert not left_out(np.empty((0, 3)), CAMERA, np.diag(SIGMA), np.empty(0)).size
    assert not left_out(directions(rng), CAMERA, np.diag(SIGMA), np.full(20, np.inf)).any()


def test_where_it_is_said_not_to_matter_nothing_is_left_out():
    """For errors that belong together in any way, near the nominal camera and off it."""
    rng = np.random.default_rng(5)
    curvature, sigma = Curvature(DETECTOR, CAMERA), np.full(60, 0.05)
    told, left = [], []
    for size in np.geomspace(1e-3, 1.0, 400):
        root = SIGMA[:, None] * rng.normal(size=(10, rng.integers(1, 17))) * size
        lens = CAMERA + size * SIGMA[3:] * rng.normal(size=7)
        told.append(bool(bends(root, sigma, curvature.shift, curvature.second, curvature.largest,
                               DETECTOR.pitch_mm / lens[2])))
        left.append(curvature.left_out(directions(rng, 60), lens, root, sigma).any())
    assert not (np.array(left) & ~np.array(told)).any()
    assert 100 < sum(left) < sum(told) < 1.5 * sum(left) < 400


def test_runs_of_a_batch_are_judged_each_by_itself():
    rng = np.random.default_rng(3)
    left_out = Curvature(DETECTOR, CAMERA).left_out
    r_s, sigma = np.stack([directions(rng), directions(rng)]), np.full((2, 20), 0.05)
    root = np.stack([np.diag(SIGMA), np.diag(SIGMA) * 1e-3])
    together = left_out(r_s, np.stack([CAMERA, CAMERA]), root, sigma)
    for run in range(2):
        np.testing.assert_array_equal(
            together[run], left_out(r_s[run], CAMERA, root[run], sigma[run]))


def test_a_frame_is_believed_less_and_the_paper_s_filter_stays_as_it_is():
    rng = np.random.default_rng(4)
    r_s = directions(rng)
    frame = Stars(r_s, camera.project(r_s, CAMERA, DETECTOR.pitch_mm), np.full(20, 0.05))
    for feedback in (True, False):
        filter_ = Filter(NARROW.replace({'estimator.feedback': feedback}))
        belief = filter_.begin(filter_.start.C_sg.T)
        update = filter_.update(belief, frame)
        plain = filter_.update(belief, frame, gated=False)
        wider = (update.belief.sigma / plain.belief.sigma).max() > 1.5
        assert (wider, bool(update.linear)) == (feedback, not feedback)


def test_sigmas_of_a_narrow_field_hold_for_all_that_may_be_true():
    """A field of 4.7 deg, initial errors of tens of pixels: without it NEES 33, one run of 289."""
    nees = first_errors.nees(NARROW, 12, lambda part: None)
    assert nees.sum() < chi2.ppf(0.99, 16 * len(nees))
    assert nees.max() < chi2.ppf(1.0 - 1e-4, 16)
