# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a comparison says in words."""

import pytest

from starcal_ros.report.comparison import percent


@pytest.mark.parametrize('probability, text', [
    (1.0, '100 %'), (0.996, '100 %'), (0.5, '50 %'), (0.0994, '9.9 %'), (0.0996, '10 %'),
    (0.012, '1.2 %'), (3.4e-7, '3.4e-05 %'), (0.0, 'never')])
def test_a_probability_is_told_in_percent(probability, text):
    assert percent(probability) == text
