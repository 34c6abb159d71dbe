# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The fitted size of an unmodelled effect is that of a filter which has it as a state."""

import numpy as np
import pytest

from starcal_ros.core import kalman
from starcal_ros.filter.responses import Responses, fitted, respond

N, M, FRAMES = 4, 3, 30


def linear(seed=1):
    """Return a random linear system: transition, measurement matrices, shift, direct effect."""
    rng = np.random.default_rng(seed)
    Phi = np.eye(N) + 0.1 * rng.normal(size=(FRAMES, N, N))
    H = rng.normal(size=(FRAMES, M, 2, N))
    V, d = rng.normal(size=(FRAMES, N, 3)), rng.normal(size=(FRAMES, M, 2, 3))
    return Phi, H, V, d


def meet(responses, said, d, judged):
    """Take a frame in."""
    respond(said, d, np.asarray(judged), responses.E, responses.s, responses.information)


def fit_of(responses, run=()):
    """Return the sizes that fit best in a run."""
    return fitted(responses.s[run], responses.information[run], responses.largest)


def run(p, seed=1, begin=0, judged=lambda k: True, noise=True, p_sigma=1e3):
    """Return the responses of a filter without p, and the root of one with p as three states."""
    Phi, H, V, d = linear(seed)
    rng = np.random.default_rng(100 + seed)
    x, x_hat, root = rng.normal(size=N), np.zeros(N), np.eye(N)
    error = np.zeros(N + 3)
    whole = np.diag([*(1.0,) * N, *(p_sigma,) * 3])
    responses = Responses((), N, np.full((1, 3), 1e9))
    sigma, use = np.ones(M), np.ones(M, bool)
    for k in range(FRAMES):
        on = k >= begin
        # The truth moves by the effect, so that an error, estimate less truth, does by -V p.
        x = Phi[k] @ x - on * V[k] @ p
        x_hat = Phi[k] @ x_hat
        root = kalman.predict(root, Phi[k], np.zeros((N, 1)))
        responses.E = Phi[k] @ responses.E + on * V[k]
        wide = np.eye(N + 3)
        wide[:N, :N], wide[:N, N:] = Phi[k], on * V[k]
        error = wide @ error
        whole = kalman.predict(whole, wide, np.zeros((N + 3, 1)))
        # Predicted less measured.
        z = H[k] @ (x_hat - x) + on * d[k] @ p - noise * rng.normal(size=(M, 2))
        innovation = kalman.innovate(root, H[k], z, sigma)
        step, after, _ = kalman.correct(root, innovation, use)
        said = kalman.evidence(innovation, H[k], use, after)
        meet(responses, said, (on * d[k]).reshape(2 * M, 3), judged(k))
        x_hat, root = x_hat - step, after
        H_wide = np.concatenate((H[k], on * d[k]), axis=-1)
        # The filter with p sees the same measurement, about its own estimate.
        innovation = kalman.innovate(whole, H_wide, z - H_wide @ error, sigma)
        moved, whole, _ = kalman.correct(whole, innovation, use)
        error = error + moved
        error[:N] -= step                           # the first estimate was corrected
    return responses, error, whole, x_hat - x


@pytest.mark.parametrize('begin', [0, 12])
def test_fit_is_the_estimate_of_the_filter_with_the_effect_as_a_state(begin):
    p = np.array([0.7, -0.4, 1.1])
    responses, error, whole, _ = run(p, begin=begin)
    fit = fit_of(responses)
    covariance = whole @ whole.T
    np.testing.assert_allclose(fit.p[0], error[N:], rtol=1e-4)
    np.testing.assert_allclose(fit.root[0] @ fit.root[0].T, covariance[N:, N:], rtol=1e-4,
                               atol=1e-8)
    assert fit.freedom[0] == 3
    np.testing.assert_allclose(fit.sigma[0], np.sqrt(np.diag(covariance)[N:]), rtol=1e-4)


def test_response_and_size_make_of_one_estimate_the_other():
    """Friedland: x of the filter with p is that without it less E p; so are the covariances."""
    p = np.array([0.7, -0.4, 1.1])
    responses, error, whole, _ = run(p)
    fit = fit_of(responses)
    np.testing.assert_allclose(responses.of(0) @ fit.p[0], error[:N], rtol=1e-4, atol=1e-6)
    root = responses.of(0) @ fit.root[0]
    Phi, H, *_ = linear()
    alone = np.eye(N)
    for k in range(FRAMES):
        alone = kalman.predict(alone, Phi[k], np.zeros((N, 1)))
        innovation = kalman.innovate(alone, H[k], np.zeros((M, 2)), np.ones(M))
        _, alone, _ = kalman.correct(alone, innovation, np.ones(M, bool))
    np.testing.assert_allclose(alone @ alone.T + root @ root.T, (whole @ whole.T)[:N, :N],
                               rtol=1e-4, atol=1e-8)


def test_without_noise_the_size_is_exact_and_the_response_is_the_error():
    p = np.array([0.3, 2.0, -1.0])
    responses, _, _, error = run(p, noise=False, seed=3)
    clean, _, _, start = run(np.zeros(3), noise=False, seed=3)
    np.testing.assert_allclose(error - start, responses.of(0) @ p, rtol=1e-9)
    assert fit_of(clean).gain[0] < fit_of(responses).gain[0]


def test_gain_of_a_right_model_is_chi_square():
    gains = np.array([fit_of(run(np.zeros(3), seed=seed)[0]).gain[0] for seed in range(200)])
    # run() begins at a true state drawn from the prior, so nothing is wrong.
    assert gains.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / 200))
    assert gains.var() == pytest.approx(6.0, rel=0.6)


def test_frames_that_are_not_judged_move_the_response_alone():
    p = np.array([0.7, -0.4, 1.1])
    judged, *_ = run(p)
    half, *_ = run(p, judged=lambda k: k >= 15)
    np.testing.assert_array_equal(judged.E, half.E)
    assert fit_of(half).gain[0] < fit_of(judged).gain[0]
    assert (fit_of(half).sigma > fit_of(judged).sigma).all()


def test_what_can_not_be_told_has_no_size():
    responses = Responses((), N, np.array([[1.0, 1.0, 1.0], [5.0, 0.0, 0.0]]))
    fit = fit_of(responses)
    assert (fit.freedom == 0).all() and (fit.gain == 0.0).all() and np.isinf(fit.sigma).all()
    assert (fit.p == 0.0).all()


def test_effects_of_fewer_numbers_and_batch_axes_are_each_for_itself():
    Phi, H, V, d = linear(5)
    rng = np.random.default_rng(6)
    largest = np.array([[1e9, 0.0, 0.0], [1e9, 1e9, 1e9]])
    many = Responses((2,), N, largest)
    alone = [Responses((), N, largest[k:k + 1]) for k in range(2)]
    root = np.broadcast_to(np.eye(N), (2, N, N))
    for k in range(FRAMES):
        V_both = np.concatenate((V[k] * [1.0, 0.0, 0.0], V[k]), axis=-1)
        d_both = np.concatenate((d[k] * [1.0, 0.0, 0.0], d[k]), axis=-1).reshape(2 * M, 6)
        z = rng.normal(size=(2, M, 2))
        root = kalman.predict(root, Phi[k], np.zeros((2, N, 1)))
        innovation = kalman.innovate(root, np.broadcast_to(H[k], (2, M, 2, N)), z, np.ones((2, M)))
        _, after, _ = kalman.correct(root, innovation, np.ones((2, M), bool))
        said = kalman.evidence(innovation, np.broadcast_to(H[k], (2, M, 2, N)),
                               np.ones((2, M), bool), after)
        many.E = Phi[k] @ many.E + V_both
        meet(many, said, np.broadcast_to(d_both, (2, 2 * M, 6)), np.ones(2, bool))
        for run_, one in enumerate(alone):
            one.E = Phi[k] @ one.E + V_both[:, 3 * run_:3 * run_ + 3]
            meet(one, kalman.Evidence(*(part[run_] for part in said)),
                 d_both[:, 3 * run_:3 * run_ + 3], True)
        root = after
    for run_, one in enumerate(alone):
        fit, single = fit_of(many, (run_,)), fit_of(one)
        np.testing.assert_allclose(fit.p[run_], single.p[0], rtol=1e-9)
        np.testing.assert_allclose(fit.gain[run_], single.gain[0], rtol=1e-9)
    assert fit_of(many, (0,)).freedom.tolist() == [1, 3]
    assert np.isinf(fit_of(many, (0,)).sigma[0, 1:]).all()
