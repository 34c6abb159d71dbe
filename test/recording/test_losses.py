# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is missing is counted by the stamps, and told to who reads the recording."""

import numpy as np
import pytest

from starcal_ros.recording import losses
from starcal_ros.recording.losses import Loss, StampGaps

STAMPS = 1_782_993_600_000_000_000 + 10_000_000 * np.arange(40_000)


def counted(stamps, batch=70):
    """Return what is counted of stamps that come in batches."""
    gaps = StampGaps(3600.0)
    for low in range(0, len(stamps), batch):
        gaps.add(stamps[low:low + batch].tolist())
    return gaps.missing, round(gaps.longest_s, 3)


@pytest.mark.parametrize('gone, missing, longest_s', [
    ([], 0, 0.0), (range(100, 101), 1, 0.02), (range(20_000, 31_700), 11_700, 117.01),
    ([500, 900, 901, *range(2000, 2050)], 53, 0.51)])
def test_gaps_of_a_steady_topic_are_counted(gone, missing, longest_s):
    assert counted(np.delete(STAMPS, [*gone])) == (missing, longest_s)


def test_jitter_duplicates_and_what_goes_back_are_no_gaps():
    rng = np.random.default_rng(1)
    jitter = STAMPS + rng.integers(-2_000_000, 2_000_000, len(STAMPS))
    assert counted(jitter) == (0, 0.0)
    assert counted(np.repeat(STAMPS, 2)) == (0, 0.0)
    back = STAMPS.copy()
    back[5000:5100] -= 10**9
    assert counted(back)[0] == 100          # those that went back are missing where they were


def test_a_topic_without_a_steady_rate_has_no_gaps():
    rng = np.random.default_rng(1)
    assert counted(np.cumsum(rng.exponential(1e8, 5000)).astype(np.int64) + STAMPS[0]) == (0, 0.0)


def test_another_run_is_no_gap():
    assert counted(np.concatenate((STAMPS, STAMPS + 10**14))) == (0, 0.0)


def test_records_are_told_in_words_whatever_they_hold():
    record = losses.dump({'/a': Loss(3, 0.04, 2), '/b': Loss()})
    assert losses.texts(record) == [
        '/a: 3 messages are missing by their stamps, the longest gap is 0.04 s; 2 messages were '
        'lost by the middleware']
    assert losses.texts(losses.dump({losses.RECORDER: Loss(held_up_s=60.04)})) == [
        'recorder: held up for 60.0 s, what came meanwhile may be missing']
    assert losses.texts({'/c': '[1]'}) == ['/c: messages are missing: [1]']
    assert losses.texts({'/c': '{"missing_by_stamps": {}}'})
