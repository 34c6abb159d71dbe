# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A number that a right model keeps in a band, and how it is told to a user."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from starcal_ros.core.distributions import chi2_isf, chi2_ppf_of_two, normal_isf
from starcal_ros.core.utc import utc_text

ALARM = 1e-5
"""Probability with which a statistic fails though the model is right."""
MARGIN = 1.2
"""Factor by which variances may be off: sigmas that are off by a tenth."""


class Statistic(NamedTuple):
    """One test of a model.

    Attributes
    ----------
    name : str
        What is looked at.
    value : float
        What it is.
    low, high : float
        Band in which it is with the probability 1 - ALARM where the model is right.
    samples : int
        How many independent parts it is made of: frames, windows, stars.
    since_ns : int or None
        Stamp of the end of the window in which it failed first, and has failed since.
    fits : str
        What would make it pass, in words; empty where nothing is known.
    gain : float
        Twice the logarithm of the likelihood ratio of what fits; 0 where nothing was fitted.
    """

    name: str
    value: float
    low: float
    high: float
    samples: int
    since_ns: int | None = None
    fits: str = ''
    gain: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the value is in its band."""
        return self.low <= self.value <= self.high

    @property
    def excess(self) -> float:
        """How clearly it fails, 0 where it passes: beyond its band, as a part of the bound.

        What is fitted goes by its likelihood, whatever harm it does.
        """
        if self.passed:
            return 0.0
        bound, value = (self.high if self.value > self.high else self.low), self.value
        return abs(max(value, self.gain) - bound) / max(abs(bound), 1e-300)

    @property
    def sentence(self) -> str:
        """What it is, its band, and since when it is outside of that."""
        since = '' if self.since_ns is None else f', since {utc_text(self.since_ns)}'
        fits = f' ({self.fits})' if self.fits else ''
        return (f'{self.name} {self.value:.4g}, allowed {self.low:.4g} to {self.high:.4g}{fits}'
                f'{since}')


@lru_cache(maxsize=256)
def chi2_beyond(probability: float, freedom: int) -> float:
    """Return what a chi-square number exceeds with a probability."""
    return float(chi2_isf(probability, freedom))


@lru_cache(maxsize=256)
def normal_beyond(probability: float) -> float:
    """Return what a normal number exceeds with a probability."""
    return float(normal_isf(probability))


def gated_nis(gate_probability: float) -> float:
    """Return the mean of NIS over its degrees of freedom behind a gate of two degrees each.

    The gate takes the largest of the good stars, too: the mean of a chi-square number of two
    degrees below its quantile g is ``2 - g q / (1 - q)``, q the part above.
    """
    above = 1.0 - gate_probability
    if above == 0.0:
        return 1.0
    return 1.0 - 0.5 * chi2_ppf_of_two(gate_probability) * above / gate_probability
