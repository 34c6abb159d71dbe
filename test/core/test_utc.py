# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Times as people and YAML read them."""

import pytest
import yaml

from starcal_ros.core.utc import unix_ns, worded


@pytest.mark.parametrize('text', [
    '2026-07-02T12:00:00', '2026-07-02T12:00:00Z', '2026-07-02T14:00:00+02:00', '2026-07-02',
    '2026-07-02T12:00:00.250', '2026-07-02 12:00:00 UTC'])
def test_time_that_says_utc_by_the_word_is_the_same_and_a_text_to_yaml(text):
    word = worded(text)
    assert unix_ns(word) == unix_ns(text)
    assert yaml.safe_load(word) == word == worded(word)
