# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What residuals depend on, in numbers: parts of like size, means and their errors."""

import numpy as np
import pytest

from starcal_ros.calibration.residual_trends import PARTS, trends


def test_an_effect_is_in_the_part_that_has_it():
    """A wave over the pixel along u, and a shift along v that grows with the colour."""
    rng = np.random.default_rng(1)
    n = 20_000
    uv, magnitude, colour = rng.uniform(0.0, 900.0, (n, 2)), rng.uniform(2, 7, n), rng.random(n)
    magnitude[:100], colour[:100] = np.nan, np.nan
    residual = 0.05 * rng.standard_normal((n, 2))
    residual[:, 0] += 0.05 * np.sin(2.0 * np.pi * uv[:, 0])
    residual[100:, 1] += 0.1 * (colour[100:] - 0.5)
    found = trends(uv, residual, magnitude, colour)
    assert {name: sum(part['stars'] for part in parts) for name, parts in found.items()} == {
        'pixel_u': n, 'pixel_v': n, 'magnitude': n - 100, 'b_v': n - 100}
    for name, axis, expected in (
            ('pixel_u', 0, lambda at: 0.05 * np.sin(2.0 * np.pi * at)), ('pixel_v', 0, None),
            ('b_v', 1, lambda at: 0.1 * (at - 0.5)), ('magnitude', 1, None)):
        assert len(found[name]) == PARTS
        for part in found[name]:
            there = 0.0 if expected is None else expected(part['at'])
            sigma = part['sigma_of_mean_px'][axis]
            # the middle of a part is not its mean where the wave bends
            assert abs(part['mean_px'][axis] - there) < 4.5 * sigma + 0.001, name
            assert sigma == pytest.approx(part['rms_px'][axis] / np.sqrt(part['stars']), rel=0.4)
    assert -0.5 <= found['pixel_u'][0]['at'] < -0.4 < 0.4 < found['pixel_u'][-1]['at'] <= 0.5


def test_of_few_stars_nothing_is_said():
    found = trends(np.full((3, 2), 0.3), np.zeros((3, 2)), np.full(3, np.nan), np.full(3, np.nan))
    assert found == {'pixel_u': [], 'pixel_v': [], 'magnitude': [], 'b_v': []}
