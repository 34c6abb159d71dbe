# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The middle of integers is numpy's median."""

import numpy as np
import pytest

from starcal_ros.core import robust


@pytest.mark.parametrize('n', [1, 2, 3, 10, 1001])
@pytest.mark.parametrize('different', [1, 3, 10**9])
def test_the_middle_is_the_median(n, different):
    rng = np.random.default_rng(n)
    counts = 10**7 + rng.integers(0, different, n)
    assert robust.middle(counts) == np.median(counts)


def test_nothing_has_no_middle():
    assert np.isnan(robust.middle(np.empty(0, np.int64)))
