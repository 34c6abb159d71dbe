# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The run that tests of the calibrator share."""

import pytest

from streams import all_at_once, simulated


@pytest.fixture
def run():
    """Return the run that most tests feed."""
    return simulated()


@pytest.fixture
def at_once():
    """Return a calibrator that has had all its messages in one batch, and its results."""
    return all_at_once()
