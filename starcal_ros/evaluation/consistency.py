# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Does a filter say the truth about its own error? NEES, NIS, RMS and their intervals.

The mean of n independent chi-square numbers of d degrees of freedom is chi2(n d) / n; a mean
outside its interval says that the covariance is wrong. Bar-Shalom, Li, Kirubarajan, *Estimation
with Applications to Tracking and Navigation*, 2001, Sec. 5.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.distributions import chi2_ppf
from starcal_ros.core.statistic import gated_nis


class Interval(NamedTuple):
    """Where a statistic lies with some probability."""

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        return isinstance(value, (float, int)) and self.low <= value <= self.high


def mean_interval(degrees: float, count: int, probability: float) -> Interval:
    """Return the interval of the mean of `count` chi-square numbers of some degrees of freedom."""
    tail = 0.5 * (1.0 - probability)
    low, high = chi2_ppf([tail, 1.0 - tail], degrees * count) / count
    return Interval(float(low), float(high))


def matched_interval(mean: float, variance: float, count: int, probability: float) -> Interval:
    """Return the interval of the mean of `count` sums of squares of this mean and variance.

    As if they were a chi-square times a number that has both.
    """
    degrees = 2.0 * mean**2 / variance
    low, high = mean_interval(degrees, count, probability)
    return Interval(low * mean / degrees, high * mean / degrees)


def rms_interval(count: int, probability: float) -> Interval:
    """Return the interval of RMS over sigma of `count` independent normal errors."""
    low, high = np.sqrt(mean_interval(1.0, count, probability))
    return Interval(float(low), float(high))


def nis_interval(degrees: float, gate_probability: float, probability: float) -> Interval:
    """Return the interval of NIS over its degrees of freedom, behind a gate."""
    mean = gated_nis(gate_probability)
    low, high = mean_interval(degrees, 1, probability)
    return Interval(low * mean / degrees, high * mean / degrees)


def objections(nees: Array, nis: Array, nis_degrees: Array, error: Array, sigma: Array,
               bound: Array, gate_probability: float, probability: float) -> list[str]:
    """Return what speaks against a filter, in words; nothing where it is consistent.

    Parameters
    ----------
    nees : (n,) array
        Of independent runs, one degree of freedom a state.
    nis, nis_degrees : (n,) array
        Summed over each run.
    error, sigma : (n, states) array
        Errors at the end of the runs, and what the filter states.
    bound : (states,) array
        Cramér-Rao bound of the sigmas.
    gate_probability : float
        With which a good star passed the gate.
    probability : float
        With which a true filter passes each of NEES, NIS and RMS; the last of all states together.

    Notes
    -----
    The stated sigma must be the bound within 2 %: an efficient filter of this nearly linear
    problem has it to 0.1 %, and an error of 20 % in Q, R or a Jacobian moves it by 5 % or more.
    """
    n, states = error.shape
    said = []
    interval = mean_interval(states, n, probability)
    if float(nees.mean()) not in interval:
        said.append(f'NEES {nees.mean():.2f} outside {interval.low:.2f} to {interval.high:.2f}')
    degrees = float(nis_degrees.sum())
    interval = nis_interval(degrees, gate_probability, probability)
    if float(nis.sum()) / degrees not in interval:
        said.append(f'NIS {nis.sum() / degrees:.4f} outside {interval.low:.4f} to '
                    f'{interval.high:.4f}')
    interval = rms_interval(n, 1.0 - (1.0 - probability) / states)
    rms, stated = np.sqrt(np.mean(error**2, axis=0)) / bound, sigma.mean(axis=0) / bound
    said += [f'RMS of state {k} is {value:.3f} of the bound, outside {interval.low:.3f} to '
             f'{interval.high:.3f}' for k, value in enumerate(rms.tolist())
             if value not in interval]
    said += [f'stated sigma of state {k} is {value:.3f} of the bound'
             for k, value in enumerate(stated.tolist()) if abs(value - 1.0) > 0.02]
    return said
