# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Probabilities and quantiles, by the names that scipy.stats has for them.

They are the functions of scipy.special behind those of scipy.stats, which takes as long to import
as all else that a command or a node needs. scipy.special is imported when the first of them is
called: what only simulates or records needs none. Parameters are floats or arrays that broadcast.

``cdf`` is the probability of less, ``sf`` of more, ``ppf`` and ``isf`` are their inverses, and
``pdf`` is the density.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def chi2_cdf(value: ArrayLike, freedom: ArrayLike) -> Any:
    """Return the probability with which a chi-square number is less than a value."""
    return _special().chdtr(freedom, value)


def chi2_sf(value: ArrayLike, freedom: ArrayLike) -> Any:
    """Return the probability with which a chi-square number is more than a value."""
    return _special().chdtrc(freedom, value)


def chi2_ppf(probability: ArrayLike, freedom: ArrayLike) -> Any:
    """Return what a chi-square number is less than with a probability."""
    return 2.0 * _special().gammaincinv(0.5 * np.asarray(freedom), probability)


def chi2_isf(probability: ArrayLike, freedom: ArrayLike) -> Any:
    """Return what a chi-square number is more than with a probability."""
    return _special().chdtri(freedom, probability)


def chi2_ppf_of_two(probability: float) -> float:
    """Return the same as `chi2_ppf` for two degrees of freedom, where it has a closed form."""
    return -2.0 * math.log1p(-probability) if probability < 1.0 else math.inf


def f_ppf(probability: ArrayLike, freedom: float, other: float) -> Any:
    """Return what Fisher's ratio is less than with a probability."""
    return _special().fdtri(freedom, other, probability)


def f_isf(probability: float, freedom: float, other: float) -> Any:
    """Return what Fisher's ratio is more than with a probability."""
    return _special().fdtri(freedom, other, 1.0 - probability)


def normal_cdf(value: ArrayLike) -> Any:
    """Return the probability with which a normal number is less than a value."""
    return _special().ndtr(value)


def normal_pdf(value: ArrayLike) -> Any:
    """Return the density of a normal number at a value."""
    return np.exp(-0.5 * np.square(value)) / math.sqrt(2.0 * math.pi)


def normal_isf(probability: ArrayLike) -> Any:
    """Return what a normal number is more than with a probability."""
    return -_special().ndtri(probability)


def binomial_sf(value: int, trials: int, probability: float) -> Any:
    """Return the probability of more successes than a number of them."""
    return _special().bdtrc(value, trials, probability)


def poisson_sf(value: int, mean: float) -> Any:
    """Return the probability of more events than a number of them, which may be -1."""
    return _special().pdtrc(value, mean) if value >= 0 else 1.0


def load() -> None:
    """Import what they are made of now, and not 50 ms in the middle of a run."""
    _special()


def _special() -> Any:
    from scipy import special
    return special
