# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled arithmetic is that of the reference, for any states, and run by run."""

from dataclasses import replace
from functools import partial
import os
import shutil
import subprocess
import sys

from numba.core.caching import _CacheLocator
import numpy as np
import pytest

from instruments import DETECTOR, INTRINSICS, TAN2018
from starcal_ros.core import rotation
from starcal_ros.filter import arithmetic, frame_innovation, kernel, reference
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.frame_innovation import SUMS, FrameInnovation
from starcal_ros.filter.states import SCALE
from starcal_ros.simulation import sensors

RUNS, STARS = 5, 9
CURVATURE = Filter(TAN2018).model.curvature
FUNCTIONS = ('advance', 'bends', 'carry', 'compose', 'correct', 'fit', 'judge', 'propagate',
             'tally')
OPTIONAL = {'estimator.augment.time_offset_sigma_s': 0.005,
            'estimator.augment.gyro_matrix_sigma_ppm': 500.0}


def some(m, runs=RUNS, seed=1):
    """Return nominal values, errors and the root of some runs with m optional states."""
    rng = np.random.default_rng(seed)
    C_gi, C_sg = (rotation.exp(rng.normal(size=(runs, 3))) for _ in range(2))
    root = np.tril(rng.normal(size=(runs, 16 + m, 16 + m))) + 3.0 * np.eye(16 + m)
    scale = np.append(SCALE, np.full(m, 1e-5))
    return (rng, C_gi, 1e-7 * rng.normal(size=(runs, 3)), C_sg,
            INTRINSICS * (1.0 + 1e-4 * rng.normal(size=(runs, 7))),
            scale * rng.normal(size=(runs, 16 + m)), root, scale)


def an_interval(m, walks, runs=RUNS):
    rng, C_gi, _, C_sg, _, error, root, scale = some(m, runs)
    density = walks * 1e-2 * SCALE[3:]
    return (C_gi, C_sg, error, root, rotation.exp(0.01 * rng.normal(size=(runs, 3))),
            1e-5 * rng.normal(size=(runs, 3)), rng.normal(size=(runs, 3, 3)),
            rng.normal(size=(runs, 3, m)), 1e-6 * rng.random(runs), rng.random(runs), density,
            scale)


def a_frame(m, trails=True, left_out=True, gate=np.inf, feedback=True, runs=RUNS):
    rng, C_gi, bias, C_sg, intrinsics, error, root, scale = some(m, runs)
    shift = rotation.exp(1e-4 * rng.normal(size=(runs, 3))) if m else np.broadcast_to(
        np.eye(3), (runs, 3, 3))
    C_si = shift @ C_sg @ C_gi
    half = 0.5 * np.array([DETECTOR.width, DETECTOR.height])
    uv = half * rng.uniform(-0.9, 0.9, size=(runs, STARS, 2))
    at_s = np.concatenate((-uv * DETECTOR.pitch_mm / INTRINSICS[2], np.ones((runs, STARS, 1))),
                          axis=-1)
    at_s[:, 2] = 1.0, 0.0, -1.0                     # behind the camera
    u_i = at_s @ C_si / np.linalg.norm(at_s, axis=-1, keepdims=True)
    sigma = rng.uniform(0.05, 0.2, size=(runs, STARS))
    sigma[:, 4] = np.inf
    return (C_gi, bias, C_sg, intrinsics, error if not feedback else 0.0 * error, root, C_si,
            shift, rng.normal(size=(runs, 3, m)), trails * 0.01 * rng.normal(size=(runs, 3)), u_i,
            uv + rng.normal(size=uv.shape), sigma,
            left_out * 0.1 * (rng.random(sigma.shape) < 0.3),
            0.3 * rng.normal(size=(*uv.shape, m)), scale, DETECTOR.pitch_mm, 0.9, gate,
            feedback)


def same(found, expected):
    for name, left, right in zip(expected._fields, found, expected):
        scale = 1.0 + np.abs(right).max(initial=0.0)
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-11 * scale, err_msg=name)


@pytest.mark.parametrize('with_matrix', [False, True])
@pytest.mark.parametrize('largest', [1e-9, 1e-3, 0.099, 0.101, 3.0])
def test_composed_pieces_are_those_of_the_reference(largest, with_matrix):
    rng = np.random.default_rng(5)
    first = np.array([0, 0, 1, 4, 60, 60, 200])         # of no piece, of one, of many
    theta = largest * rng.uniform(-1.0, 1.0, size=(first[-1], 3)) / np.sqrt(3.0)
    theta[2] = 0.0
    dt = rng.uniform(0.1, 1.0, size=len(theta))
    expected, found = (part.compose(theta, dt, first, with_matrix)
                       for part in (reference, kernel))
    for ours, theirs in zip(found, expected):
        np.testing.assert_allclose(ours, theirs, atol=2e-10 * np.abs(theirs).max())
    np.testing.assert_allclose(found[0], expected[0], atol=1e-13)


@pytest.mark.parametrize('walks', [False, True])
@pytest.mark.parametrize('m', [0, 4])
def test_an_interval_is_that_of_the_reference(m, walks):
    same(kernel.propagate(*an_interval(m, walks)), reference.propagate(*an_interval(m, walks)))


@pytest.mark.parametrize('options', [
    {}, {'m': 4}, {'trails': False, 'left_out': False}, {'gate': 200.0}, {'feedback': False},
    {'gate': -1.0}])
def test_a_frame_is_that_of_the_reference(options):
    frame = a_frame(**{'m': 0, **options})
    found, expected = kernel.correct(*frame), reference.correct(*frame)
    assert expected.accepted.any() == (options.get('gate') != -1.0)
    assert not expected.accepted.all()
    same(found, expected)


@pytest.mark.parametrize('m', [0, 4])
def test_the_tests_of_the_model_are_those_of_the_reference(m):
    rng = np.random.default_rng(3)
    frame = a_frame(m)
    after = reference.correct(*frame)
    E = rng.normal(size=(RUNS, 16 + m, 3 * 40))
    interval = an_interval(m, False)
    carried = reference.propagate(*interval)
    parts, noise = [], 1e-9 * rng.random((RUNS, 2))
    for part in (kernel, reference):
        E_one, s, information = E.copy(), np.ones((RUNS, 40, 3)), np.ones((RUNS, 40, 3, 3))
        part.carry(E_one, carried.Phi, interval[0], carried.C_gi, interval[1], interval[4],
                   interval[6], interval[9])
        spread = np.array([0.0, *after.spread[1:]])       # at least one tells something
        judged = part.judge(
            after.z, after.H, after.M, after.L, after.root, E_one, s, information, frame[6],
            rng.permutation(0.01 * np.ones((RUNS, 3))), frame[10], frame[11], frame[12],
            np.where(np.arange(STARS) % 3, 5.5, np.nan) * np.ones((RUNS, 1)), after.accepted,
            spread, after.nis, 0.5 * np.array([DETECTOR.width, DETECTOR.height], float),
            frame[2], noise)
        parts.append((E_one, s, information, judged))
    assert parts[0][-1].judged.any()
    for left, right in zip(parts[0][:3], parts[1][:3]):
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9 * np.abs(right).max())
    same(parts[0][-1], parts[1][-1])


def test_sizes_that_fit_are_those_of_the_reference():
    rng = np.random.default_rng(3)
    largest = np.tile([[1e3, 1e3, 1e3], [1e-4, 1e5, 1.0], [10.0, 10.0, 0.0], [5.0, 0.0, 0.0]],
                      (5, 1))
    A = rng.normal(size=(20, 3, 6)) / np.maximum(largest, 1e-12)[..., None] * 10.0
    A[largest == 0.0] = 0.0
    A[4:8, :, 1:] *= 1e-9                   # one direction is told alone
    A[8:12] *= 1e-9                         # or none
    A[12:16, 1] = 0.3 * A[12:16, 0] * largest[12:16, :1] / np.maximum(largest[12:16, 1:2], 1e-12)
    A[largest == 0.0] = 0.0
    A[17] = np.diag([20.0, 20.0, 20.0])[:, [0, 1, 2, 0, 1, 2]] / largest[17, :, None]
    information = A @ np.swapaxes(A, -1, -2)
    s = (information @ (largest * rng.normal(size=(20, 3)))[..., None])[..., 0]
    found, expected = (part.fit(s, information, largest) for part in (kernel, reference))
    np.testing.assert_array_equal(found.freedom, expected.freedom)
    assert set(found.freedom) == {0, 1, 2, 3}
    for name in ('p', 'sigma', 'gain'):
        ours, theirs = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.max(
            np.abs(theirs[np.isfinite(theirs)])) if name == 'gain' else 0.0)
    covariance, theirs = (root.root @ np.swapaxes(root.root, -1, -2) for root in (found, expected))
    scale = largest[:, :, None] * largest[:, None, :] + 1e-300
    np.testing.assert_allclose(covariance / scale, theirs / scale, atol=1e-9)


def test_the_bound_of_what_a_frame_leaves_out_is_that_of_the_reference():
    _, _, _, _, intrinsics, error, root, _, *_ = a_frame(0)
    frame = a_frame(0)
    told = set()
    for size in np.geomspace(1e-3, 1e3, 25):
        for still in (0.0, 1.0):
            parts = (frame[6], frame[10], frame[12], still * SCALE * np.ones((RUNS, 1)),
                     size * frame[5], frame[3], CURVATURE.shift,
                     CURVATURE.second, CURVATURE.largest, DETECTOR.pitch_mm, 0.9)
            assert kernel.bends(*parts) == reference.bends(*parts)
            told.add((still, kernel.bends(*parts)))
    assert told == {(0.0, False), (0.0, True), (1.0, False)}


def test_the_sums_over_frames_are_those_of_the_reference():
    rng = np.random.default_rng(4)
    sums = [[np.zeros(SUMS), np.zeros(SUMS), np.zeros(3), np.zeros(20), np.zeros((20, 2)),
             np.zeros(16, np.int64), np.zeros(16), np.zeros(6, np.int64), np.zeros(6)]
            for _ in range(2)]
    for k in range(20):
        magnitude = np.where(rng.random(7) < 0.2, np.nan, rng.choice([2.0, 3.0, 5.5, 9.0], 7))
        frame = FrameInnovation(
            rng.normal(size=3), rng.normal(size=(3, 3)), 20.0 * rng.random(), 7,
            rng.normal(size=3), np.arange(7), rng.normal(size=(7, 2)), rng.integers(0, 16, 7),
            magnitude, 1e-3 * rng.random())
        rows = rng.integers(0, 20, 7)
        for tally, (run, window, last, *rest) in zip(
                (kernel.tally, frame_innovation.tally), sums):
            tally(frame, run, window, last, k % 5 != 0, rows, *rest)
    for left, right in zip(*sums):
        np.testing.assert_allclose(left, right, rtol=1e-12)
    assert sums[0][0][frame_innovation.PAIRS] == 16.0


@pytest.mark.parametrize('m', [0, 4])
def test_a_run_is_the_same_alone_and_in_a_batch(m):
    """Bit for bit."""
    frame, interval = a_frame(m, gate=300.0), an_interval(m, True)
    for function, parts in ((kernel.correct, frame), (kernel.propagate, interval)):
        whole = function(*parts)
        for run in range(RUNS):
            alone = function(*(part[run:run + 1] if np.ndim(part) and len(part) == RUNS else part
                               for part in parts))
            for left, right in zip(alone, whole):
                np.testing.assert_array_equal(left[0], right[run])


def test_what_is_no_covariance_is_an_error_of_linear_algebra():
    frame = list(a_frame(0))
    # The square of one star is a number yet, the sum over all of them is not.
    frame[5] = np.sqrt(1e308) / reference.correct(*frame).spread[:, None, None] * frame[5]
    with np.errstate(all='ignore'):
        for part in (kernel, reference):
            with pytest.raises(np.linalg.LinAlgError):
                part.correct(*frame)


@pytest.mark.parametrize('optional', [{}, OPTIONAL])
def test_a_calibration_is_that_of_the_reference(optional, monkeypatch):
    """To a part in 1e9 of a sigma, all tests of the model included."""
    scenario = TAN2018.replace({'simulation.duration_s': 90.0, **optional})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    found = []
    for part in (kernel, reference):
        for name in FUNCTIONS:
            monkeypatch.setattr(arithmetic, name, getattr(part, name))
        calibrator = Calibrator(scenario)
        calibrator.add_gyro(samples)
        calibrator.add_frames(frames)
        for _ in calibrator.process():
            pass
        found.append(calibrator)
    compiled, plain = (each.belief for each in found)
    error = compiled.estimate.minus(plain.estimate)
    assert (np.abs(error[:16]) < 1e-9 * plain.sigma).all()
    np.testing.assert_allclose(compiled.sigma, plain.sigma, rtol=1e-9)
    assert found[0].counts == found[1].counts
    for left, right in zip(*(each.consistency.statistics() for each in found)):
        assert left.name == right.name
        assert left.value == pytest.approx(right.value, rel=1e-6, abs=1e-6)


KNOWN_CAMERA = {        # from before, so that the first frames are linear
    'camera.focal_length_mm': 25.6, 'camera.principal_point_px': [5.0, 10.0],
    'camera.distortion': [2e-4, -1e-6, 2e-5, 2e-5],
    'estimator.initial_sigma.focal_length_mm': 1e-3,
    'estimator.initial_sigma.principal_point_px': 0.1, 'estimator.initial_sigma.k1': 1e-6,
    'estimator.initial_sigma.k2': 1e-8, 'estimator.initial_sigma.p1': 1e-6,
    'estimator.initial_sigma.p2': 1e-6}


def disturbed(samples, frames):
    """Return a run with a silence, a frame without stars, and one of which most are wrong."""
    keep = np.ones(len(samples), bool)
    keep[4000:5500] = False
    uv = frames.uv_raster.copy()
    wrong = slice(frames.first[170], frames.first[170] + 15)
    uv[wrong] += np.random.default_rng(1).normal(0.0, 20.0, size=uv[wrong].shape)
    dark = slice(frames.first[60], frames.first[61])
    uv[dark] = np.nan
    return samples.take(keep), replace(frames, uv_raster=uv)


def test_ordinary_frames_done_in_one_go_are_those_done_singly(monkeypatch):
    """To 1e-9 of a sigma, whatever comes between them, and all that is told of each frame."""
    scenario = TAN2018.replace({'simulation.duration_s': 120.0, **KNOWN_CAMERA})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = disturbed(gyro.next(gyro.count), tracker.next(tracker.count))
    found = []
    for part in (kernel, reference):
        monkeypatch.setattr(arithmetic, 'advance', part.advance)
        calibrator = Calibrator(scenario)
        singly = []
        monkeypatch.setattr(calibrator, '_single', partial(
            lambda single, *given: singly.append(given[1]) or single(*given),
            calibrator._single))
        calibrator.add_gyro(samples)
        calibrator.add_frames(frames)
        found.append((calibrator, list(calibrator.process()), singly))
    (fast, results, few), (slow, expected, all_frames) = found
    assert 3 <= len(few) < 40 and all_frames == list(range(240))
    assert fast.counts == slow.counts and fast.counts.empty_frames == 1
    assert fast.stamp_ns == slow.stamp_ns and fast.take_notices() == slow.take_notices()
    np.testing.assert_allclose(fast.reprojection_rms_px, slow.reprojection_rms_px, rtol=1e-9)
    for left, right in zip(results, expected, strict=True):
        error = left.belief.estimate.minus(right.belief.estimate)
        assert (np.abs(error) < 1e-9 * right.belief.sigma).all()
        np.testing.assert_allclose(left.belief.sigma, right.belief.sigma, rtol=1e-9)
        np.testing.assert_array_equal(left.belief.nominal.reading, right.belief.nominal.reading)
        assert (left.stamp_ns, left.linear) == (right.stamp_ns, right.linear)
        for name in ('uv_raster', 'accepted', 'catalog_id'):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
        for name in ('residual', 'chi2', 'nis'):
            np.testing.assert_allclose(getattr(left, name), getattr(right, name), rtol=1e-6,
                                       atol=1e-8)
    for left, right in zip(*(each.consistency.statistics() for each in (fast, slow)),
                           strict=True):
        assert left._replace(value=right.value, gain=right.gain, fits=right.fits) == right
        assert left.value == pytest.approx(right.value, rel=1e-6, abs=1e-6)
    assert float(fast.consistency.likelihood.twice_log) == pytest.approx(
        float(slow.consistency.likelihood.twice_log), rel=1e-9)


def test_ordinary_frames_that_end_in_nothing_finite_are_left_out_and_said(monkeypatch):
    scenario = TAN2018.replace({'simulation.duration_s': 90.0, **KNOWN_CAMERA})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, answered = Calibrator(scenario), Calibrator._answered
    frames, failed = tracker.next(tracker.count), []
    begin_ns = int(frames.stamp_ns[0])

    def answer(self, belief):
        if self.stamp_ns > begin_ns + 25 * 10**9 and not failed:
            failed.append(self.stamp_ns)
            raise np.linalg.LinAlgError('eigenvalues did not converge')
        return answered(self, belief)

    monkeypatch.setattr(Calibrator, '_answered', answer)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(frames)
    results = list(calibrator.process())
    assert len(failed) == 1 and len(results) == 179 and calibrator.counts.frames == 180
    assert failed[0] not in {result.stamp_ns for result in results}
    assert any(f'the frame at {failed[0]} ns leaves nothing finite' in text
               for text in calibrator.take_notices())
    assert results[-1].belief.is_finite and calibrator.counts.acquisitions == 2


def test_without_numba_the_reference_runs():
    """In a process of its own, where numba can not be imported."""
    program = ("import sys; sys.modules['numba'] = None\n"
               'from starcal_ros.filter import arithmetic, reference\n'
               'assert not arithmetic.COMPILED and arithmetic.correct is reference.correct')
    subprocess.run([sys.executable, '-c', program], check=True)


@pytest.fixture
def cache(tmp_path):
    """Return a folder in which numba finds the compiled kernel, but for one function."""
    own = tmp_path / _CacheLocator.get_suitable_cache_subpath(kernel.__file__)
    shutil.copytree(kernel._propagate.stats.cache_path, own,
                    ignore=shutil.ignore_patterns('kernel._propagate*'))
    return own


def said_on_import(cache, program='import starcal_ros.filter.arithmetic'):
    """Return what a process says that imports the filter with this cache."""
    # Away from the checkout, of which the compiled filter may be another.
    return subprocess.run([sys.executable, '-c', program], check=True, text=True,
                          env={**os.environ, 'NUMBA_CACHE_DIR': str(cache.parent)},
                          cwd=cache, capture_output=True).stderr


@pytest.mark.slow
def test_a_compilation_is_said_once(cache):
    """With a cache that lacks one function, then with what the first process left in it."""
    assert [said_on_import(cache) for _ in range(2)] == [
        'starcal_ros: compiling the filter, once: half a minute\n', '']


def test_with_a_full_disk_the_reference_runs_and_it_is_said(cache):
    assert said_on_import(cache, 'import resource\n'
                          'resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n'
                          'from starcal_ros.filter import arithmetic\n'
                          'assert not arithmetic.COMPILED').endswith(
        'starcal_ros: the filter runs uncompiled: [Errno 27] File too large\n')


@pytest.mark.parametrize('left', [0, 10, 100])
def test_with_a_damaged_cache_the_reference_runs_and_it_is_said(cache, left):
    """As after a power cut: files that are there, but not whole."""
    for path in cache.glob('kernel._[a-c]*'):
        path.write_bytes(path.read_bytes()[:left])
    assert 'starcal_ros: the filter runs uncompiled: ' in said_on_import(
        cache, 'from starcal_ros.filter import arithmetic; assert not arithmetic.COMPILED')


def test_without_a_place_for_the_cache_the_reference_runs_and_it_is_said():
    program = ('import numba\n'
               'def refuse(*given, **options):\n'
               "    raise RuntimeError('cannot cache function')\n"
               'numba.njit = refuse\n'
               'from starcal_ros.filter import arithmetic; assert not arithmetic.COMPILED')
    said = subprocess.run([sys.executable, '-c', program], check=True, text=True,
                          capture_output=True).stderr
    assert said == 'starcal_ros: the filter runs uncompiled: cannot cache function\n'


def test_with_numba_the_kernel_runs():
    assert arithmetic.COMPILED and arithmetic.correct is kernel.correct
