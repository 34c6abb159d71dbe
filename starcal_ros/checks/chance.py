# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How far chance takes what a check looks at: what it does not reach is found."""

from __future__ import annotations

from starcal_ros.core.distributions import chi2_isf

CHANCE = 1e-6
"""Probability with which one test of right data finds something."""


def beyond_chance(dof: int, tried: int = 1) -> float:
    """Return the chi-square that chance exceeds with probability `CHANCE`, the most of several."""
    return float(chi2_isf(CHANCE / tried, dof))


SIGMAS = 4.89163847569859
"""The same of one Gaussian number, in its sigmas: the root of `beyond_chance` of 1."""
