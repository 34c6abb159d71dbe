# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Quantiles and probabilities against those of scipy.stats, far out in both tails too."""

import numpy as np
import pytest
from scipy.stats import binom, chi2, f as fisher, norm, poisson

from starcal_ros.core import distributions

PROBABILITIES = np.array([0.0, 1e-12, 1e-5, 0.5, 0.999, 1.0 - 1e-9, 1.0])
VALUES = np.array([0.0, 1e-6, 0.7, 13.0, 400.0])


@pytest.mark.parametrize('freedom', [1, 2, 2.5, 30, 1e5])
def test_chi_square(freedom):
    same = np.testing.assert_array_equal
    same(distributions.chi2_ppf(PROBABILITIES, freedom), chi2.ppf(PROBABILITIES, freedom))
    same(distributions.chi2_isf(PROBABILITIES, freedom), chi2.isf(PROBABILITIES, freedom))
    same(distributions.chi2_cdf(VALUES, freedom), chi2.cdf(VALUES, freedom))
    same(distributions.chi2_sf(VALUES, freedom), chi2.sf(VALUES, freedom))
    half, full = distributions.chi2_ppf([0.1, 0.9], [1, 4])
    assert (half, full) == (chi2.ppf(0.1, 1), chi2.ppf(0.9, 4))


@pytest.mark.parametrize('probability', PROBABILITIES)
def test_two_degrees_of_freedom_have_a_closed_form(probability):
    assert distributions.chi2_ppf_of_two(probability) == pytest.approx(
        chi2.ppf(probability, 2), rel=1e-14, abs=0.0)


@pytest.mark.parametrize('freedom, other', [(1, 1), (3, 40), (2.5, 17.3), (800, 12000)])
def test_fishers_ratio(freedom, other):
    for probability in (1e-9, 1e-5, 0.3, 1.0 - 1e-6):
        assert distributions.f_ppf(probability, freedom, other) == pytest.approx(
            fisher.ppf(probability, freedom, other), rel=1e-12)
        assert distributions.f_isf(probability, freedom, other) == pytest.approx(
            fisher.isf(probability, freedom, other), rel=1e-12)


def test_normal_numbers():
    values = np.array([-38.0, -3.0, 0.0, 1.2, 9.0])
    np.testing.assert_array_equal(distributions.normal_cdf(values), norm.cdf(values))
    np.testing.assert_allclose(distributions.normal_pdf(values), norm.pdf(values), rtol=1e-15)
    np.testing.assert_array_equal(distributions.normal_isf(PROBABILITIES),
                                  norm.isf(PROBABILITIES))


@pytest.mark.parametrize('value, trials', [(0, 10), (3, 10), (10, 10), (250, 100_000)])
def test_counts(value, trials):
    assert distributions.binomial_sf(value, trials, 2e-3) == pytest.approx(
        binom.sf(value, trials, 2e-3), rel=1e-12)
    for mean in (0.0, 2.0, 300.0):
        assert distributions.poisson_sf(value, mean) == poisson.sf(value, mean)
    assert distributions.poisson_sf(-1, 2.0) == poisson.sf(-1, 2.0)
