# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How far chance takes a test."""

import pytest
from scipy.stats import chi2, norm

from starcal_ros.checks.chance import CHANCE, SIGMAS, beyond_chance


def test_chance_goes_so_far_with_the_probability_that_is_stated():
    assert chi2.sf(beyond_chance(3), 3) == pytest.approx(CHANCE, rel=1e-9)
    assert chi2.sf(beyond_chance(3, tried=10), 3) == pytest.approx(CHANCE / 10, rel=1e-9)
    assert 2.0 * norm.sf(SIGMAS) == pytest.approx(CHANCE, rel=1e-9)
    assert SIGMAS**2 == pytest.approx(beyond_chance(1), rel=1e-14)
