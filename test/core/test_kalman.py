# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The square-root filter against the textbook's covariances, and where those fail."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
import pytest

from starcal_ros.core import kalman

N_STATES, N_PAIRS = 16, 12
EPS = np.finfo(float).eps


class Case(NamedTuple):
    """A prior and one set of measurements."""

    root: NDArray
    H: NDArray
    z: NDArray
    sigma: NDArray

    @property
    def P(self):
        return self.root @ np.swapaxes(self.root, -1, -2)

    @property
    def R(self):
        return np.diag(np.repeat(self.sigma, 2)**2)

    @property
    def stacked(self):
        return self.H.reshape(-1, N_STATES), self.z.ravel()


def make(rng, *batch):
    """Return a well-conditioned case: all numbers near one."""
    root = np.eye(N_STATES) + 0.2 * rng.normal(size=(*batch, N_STATES, N_STATES))
    return Case(root, rng.normal(size=(*batch, N_PAIRS, 2, N_STATES)),
                rng.normal(size=(*batch, N_PAIRS, 2)),
                rng.uniform(0.5, 2.0, (*batch, N_PAIRS)))


def update(case, use=None):
    innovation = kalman.innovate(*case)
    return kalman.correct(case.root, innovation,
                          np.ones(case.sigma.shape, bool) if use is None else use)


@pytest.fixture
def case():
    return make(np.random.default_rng(1))


@pytest.fixture
def textbook(case):
    """Return x, P (Joseph's form) and z' S^-1 z, and the rounding of S^-1 relative to it."""
    H, z = case.stacked
    S = H @ case.P @ H.T + case.R
    K = np.linalg.solve(S, H @ case.P).T
    keep = np.eye(N_STATES) - K @ H
    return (K @ z, keep @ case.P @ keep.T + K @ case.R @ K.T, z @ np.linalg.solve(S, z),
            10 * np.linalg.cond(S) * EPS)


def assert_close(actual, expected, relative):
    """Compare arrays by a rounding relative to their largest element."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * np.abs(expected).max())


# Predict

def test_predict_is_the_textbooks(case):
    rng = np.random.default_rng(2)
    Phi, Q_root = rng.normal(size=(N_STATES, N_STATES)), rng.normal(size=(N_STATES, 3))
    root = kalman.predict(case.root, Phi, Q_root)
    # 16 products an element, each rounded: of a sum of squares, so nothing cancels at the top
    assert_close(root @ root.T, Phi @ case.P @ Phi.T + Q_root @ Q_root.T, 2 * N_STATES * EPS)
    np.testing.assert_array_equal(root, np.tril(root))


def test_predict_without_motion_and_noise_keeps_the_covariance(case):
    root = kalman.predict(case.root, np.eye(N_STATES), np.zeros((N_STATES, 1)))
    assert_close(root @ root.T, case.P, 2 * N_STATES * EPS)


# Roots

def test_root_of_a_covariance_has_it_as_its_square_and_no_negative_part():
    """Also of a batch; -1e-3 stands for what rounding leaves below zero."""
    rng = np.random.default_rng(8)
    turn = np.linalg.qr(rng.normal(size=(2, 3, 4, 4)))[0]
    for values, kept in (([4.0, 1.0, 0.25, 1e-6],) * 2,
                         ([4.0, 1.0, 0.25, -1e-3], [4.0, 1.0, 0.25, 0.0])):
        root = kalman.root_of(turn * values @ np.swapaxes(turn, -1, -2))
        assert_close(root @ np.swapaxes(root, -1, -2), turn * kept @ np.swapaxes(turn, -1, -2),
                     20 * EPS)


@pytest.mark.parametrize('k', [1, 3, 5])
def test_marginal_root_has_the_corner_of_the_covariance_as_its_square(k):
    root = np.random.default_rng(9).normal(size=(2, 3, 5, 5))
    corner = kalman.marginal(root, k)
    assert corner.shape == (2, 3, k, k)
    assert_close(corner @ np.swapaxes(corner, -1, -2),
                 (root @ np.swapaxes(root, -1, -2))[..., :k, :k], 20 * EPS)


# Correct

def test_correct_is_the_textbooks(case, textbook):
    x, P, nis, rounding = textbook
    x_new, root, nis_new = update(case)
    assert_close(x_new, x, rounding)
    assert_close(root @ root.T, P, rounding)
    assert_close(nis_new, nis, rounding)


def test_correct_with_one_measurement_of_one_state_is_the_weighted_mean():
    """Prior sigma 2, measurement sigma 1, innovation 5: gain 4/5, variance 4/5, by hand."""
    H = np.zeros((1, 2, 2))
    H[0, 0, 0] = 1.0
    case = Case(2.0 * np.eye(2), H, np.array([[5.0, 0.0]]), np.ones(1))
    x, root, nis = update(case)
    np.testing.assert_allclose(x, [4.0, 0.0], rtol=4 * EPS)
    np.testing.assert_allclose(root @ root.T, [[0.8, 0.0], [0.0, 4.0]], rtol=4 * EPS)
    np.testing.assert_allclose(nis, 5.0, rtol=4 * EPS)


def test_a_pair_that_is_not_used_might_as_well_not_be_there(case, textbook):
    use = np.arange(N_PAIRS) % 3 != 1
    fewer = Case(case.root, case.H[use], case.z[use], case.sigma[use])
    for actual, expected in zip(update(case, use), update(fewer)):
        assert_close(actual, expected, textbook[-1])


def test_a_pair_of_infinite_sigma_might_as_well_not_be_there(case, textbook):
    use = np.arange(N_PAIRS) % 3 != 1
    blind = case._replace(sigma=np.where(use, case.sigma, np.inf))
    fewer = Case(case.root, case.H[use], case.z[use], case.sigma[use])
    for actual, expected in zip(update(blind), update(fewer)):
        assert_close(actual, expected, textbook[-1])


def test_without_a_pair_nothing_changes(case):
    x, root, nis = update(case, np.zeros(N_PAIRS, bool))
    np.testing.assert_array_equal(x, 0.0)
    np.testing.assert_array_equal(root, case.root)
    assert nis == 0.0


def test_arguments_are_left_as_they_are(case):
    before = Case(*(part.copy() for part in case))
    update(case)
    kalman.predict(case.root, np.eye(N_STATES), np.ones((N_STATES, 3)))
    for part, copy in zip(case, before):
        np.testing.assert_array_equal(part, copy)


def test_covariance_stays_positive_where_the_textbooks_does_not():
    """Measurements of a variance 1e-12 of the prior's in six of the states, as in a first fix."""
    case = make(np.random.default_rng(3))._replace(
        root=np.diag([1e6] * 6 + [1.0] * 10), sigma=np.ones(N_PAIRS))
    H, _ = case.stacked
    S = H @ case.P @ H.T + case.R
    textbook = (np.eye(N_STATES) - case.P @ H.T @ np.linalg.inv(S) @ H) @ case.P
    assert np.linalg.eigvalsh(0.5 * (textbook + textbook.T)).min() < 0.0

    _, root, _ = update(case)
    # The 24 measurements determine all 16 states: P^-1 = P0^-1 + H'H is well conditioned.
    P = np.linalg.inv(np.linalg.inv(case.P) + H.T @ H)
    A = np.eye(N_STATES) + case.root.T @ H.T @ H @ case.root
    assert np.linalg.eigvalsh(root @ root.T).min() > 0.0
    assert_close(root @ root.T, P, np.linalg.cond(A) * EPS)


# Innovate

def test_chi2_is_that_of_each_pair_alone(case):
    innovation = kalman.innovate(*case)
    for k in range(N_PAIRS):
        S = case.H[k] @ case.P @ case.H[k].T + case.sigma[k]**2 * np.eye(2)
        expected = case.z[k] @ np.linalg.solve(S, case.z[k])
        np.testing.assert_allclose(innovation.chi2[k], expected,
                                   rtol=10 * np.linalg.cond(S) * EPS)


def test_chi2_of_an_infinite_sigma_is_zero(case):
    innovation = kalman.innovate(*case._replace(sigma=np.full(N_PAIRS, np.inf)))
    np.testing.assert_array_equal(innovation.chi2, 0.0)


def test_chi2_of_a_vague_prior_is_that_of_the_difference():
    """One state moves both coordinates alike: z = (0, 1) has chi2 1/2 whatever the prior's size.

    S = s^2 [[1, 1], [1, 1]] + I, so z' S^-1 z = 1 - s^2 / (1 + 2 s^2).
    """
    sizes = np.array([1e3, 1e6, 1e9])
    innovation = kalman.innovate(sizes[:, None, None], np.ones((3, 1, 2, 1)),
                                 np.tile([0.0, 1.0], (3, 1, 1)), np.ones((3, 1)))
    np.testing.assert_allclose(innovation.chi2[:, 0], 1.0 - sizes**2 / (1.0 + 2.0 * sizes**2),
                               rtol=1e-6)


def test_chi2_and_nis_of_simulated_innovations_are_chi_square(case):
    """Mean of n chi-squares of d degrees of freedom: d, with standard deviation sqrt(2 d / n)."""
    n, rng = 4000, np.random.default_rng(4)
    error = rng.normal(size=(n, N_STATES)) @ case.root.T
    z = (error @ case.stacked[0].T).reshape(n, N_PAIRS, 2) + (
        case.sigma[:, None] * rng.normal(size=(n, N_PAIRS, 2)))
    many = Case(*(np.broadcast_to(part, (n, *part.shape)) for part in case))._replace(z=z)
    chi2 = kalman.innovate(*many).chi2
    np.testing.assert_allclose(chi2.mean(axis=0), 2.0, atol=4 * np.sqrt(4 / n))
    nis = update(many)[2]
    degrees = 2 * N_PAIRS
    np.testing.assert_allclose(nis.mean(), degrees, atol=4 * np.sqrt(2 * degrees / n))


def test_leading_axes_are_batches():
    batch = make(np.random.default_rng(5), 2, 3)
    use = np.random.default_rng(6).random((2, 3, N_PAIRS)) < 0.7
    Phi, Q_root = np.random.default_rng(7).normal(size=(2, 2, 3, N_STATES, N_STATES))
    innovation = kalman.innovate(*batch)
    whole = (*innovation, *update(batch, use), kalman.predict(batch.root, Phi, Q_root))
    for run in np.ndindex(2, 3):
        case = Case(*(part[run] for part in batch))
        parts = (*kalman.innovate(*case), *update(case, use[run]),
                 kalman.predict(case.root, Phi[run], Q_root[run]))
        for actual, expected in zip(whole, parts):
            assert_close(actual[run], expected, 1e-12)      # sums in another order, cond < 1e3
