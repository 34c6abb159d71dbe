# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Allan deviation of a gyro at rest, and the noise that it shows.

Model
-----
The Allan variance of the rate of one axis is the sum of five terms (IEEE Std 952-1997, Annex C),
tau in hours and rates in deg/h ::

    sigma^2 = 3 Q^2/tau^2 + N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3 + R^2 tau^2/2       (A.1)

    Q    deg            quantisation of the angle
    N    deg/sqrt(h)    angle random walk
    B    deg/h          bias instability (flicker)
    K    deg/h/sqrt(h)  rate random walk
    R    deg/h/h        rate ramp

The variances of octaves of tau, of the overlapping estimator of `allantools`, are fitted by
maximum likelihood: edf s^2/sigma^2 is chi-square with edf degrees of freedom. For the interval of
a variance these are Greenhall and Riley's (2003), for the fit as many as there are differences
that do not overlap: those of two octaves are as good as independent, overlapping ones are not. No
term is negative. The interval of a term is where its profile likelihood allows it. A term whose
interval begins at 0 is not known: the recording bounds it from above, and no more. A ramp is a
drift, not a noise, and with the bias instability looks as a random walk: it is counted only where
the curve shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, nnls

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.distributions import chi2_ppf, chi2_sf

CONFIDENCE = 0.95
LEAST = 64
"""Least number of readings."""

_PER_HOUR = 3600.0
_MODEL = 0.01           # part of a variance that (A.1) is trusted to, of discrete readings
_ROUNDS = 200
_STEADY = 1e-9
_UNLIKELY = 1e-3
_FAR = 1e8              # times what explains all of the variance at the tau where it is most


class NoiseTerm(NamedTuple):
    """One term of (A.1).

    Attributes
    ----------
    name, unit : str
    factor, power : float
        It is factor * coefficient^2 * tau^power.
    alpha : int
        Power of the frequency in its spectrum, for the degrees of freedom.
    scale : float
        Units in one of (A.1).
    """

    name: str
    unit: str
    factor: float
    power: int
    alpha: int
    scale: float = 1.0


TERMS = (NoiseTerm('quantisation', 'arcsec', 3.0, -2, 2, 3600.0),
         NoiseTerm('angle random walk', 'deg/sqrt(h)', 1.0, -1, 0),
         NoiseTerm('bias instability', 'deg/h', 2.0 * math.log(2.0) / math.pi, 0, -1),
         NoiseTerm('rate random walk', 'deg/h/sqrt(h)', 1.0 / 3.0, 1, -2),
         NoiseTerm('rate ramp', 'deg/h/h', 0.5, 2, -2))

_RAMP = 4                # of `TERMS`
_RAMP_SEEN = 1.64       # twice the gain of a log likelihood that chance has one time in ten


class Coefficient(NamedTuple):
    """What is known of a term: most likely value and interval; not known, value is None."""

    value: float | None
    low: float
    high: float


@dataclass(frozen=True)
class AllanCurve:
    """The Allan deviation of one axis, and what it is made of.

    Attributes
    ----------
    tau_s : (n,) array
    deviation, low, high : (n,) arrays
        With the interval of each [deg/h].
    fitted : (n,) array
        (A.1) with the most likely coefficients [deg/h].
    coefficients : tuple of Coefficient
        Of `TERMS`, in their units.
    misfit : float
        Deviance of the fit for each degree of freedom that is left; intervals are wider by its
        root where it is more than 1.
    fits : bool
        Whether a misfit as large is to be expected by chance.
    """

    tau_s: Array
    deviation: Array
    low: Array
    high: Array
    fitted: Array
    coefficients: tuple[Coefficient, ...]
    misfit: float
    fits: bool


def allan(rate_deg_h: Array, rate_hz: float) -> AllanCurve:
    """Return the Allan deviation of equally spaced readings of one axis.

    Parameters
    ----------
    rate_deg_h : (n,) array
        Means over the intervals between readings.
    rate_hz : float
        Readings a second.

    Raises
    ------
    ImportError
        Where allantools is missing.
    ValueError
        For fewer than `LEAST` readings, or readings that do not change.
    """
    n = len(rate_deg_h)
    if n < LEAST:
        raise ValueError(f'{n} readings at rest, an Allan deviation needs {LEAST}')
    if not np.ptp(rate_deg_h) > 0.0:
        raise ValueError(f'all readings are {rate_deg_h[0]:g} deg/h: they do not change')
    try:
        import allantools
    except ImportError:
        raise ImportError('for an Allan deviation, allantools is needed: '
                          "pip install 'starcal_ros[allan]'") from None
    m = 2**np.arange(int(math.log2(n / 3.0)) + 1)
    _, deviation, _, _ = allantools.oadev(rate_deg_h - rate_deg_h.mean(), rate=rate_hz,
                                          data_type='freq', taus=m / rate_hz)
    basis = _basis(m / rate_hz / _PER_HOUR)
    edf = np.minimum(n / (2.0 * m), 2.0 / _MODEL**2)
    counted = np.ones(len(TERMS), bool)
    squares = _fit(basis, deviation**2, edf)
    without = _fit(basis[:, :_RAMP], deviation**2, edf)
    if 2.0 * (_minus_log(basis[:, :_RAMP] @ without, deviation**2, edf)
              - _minus_log(basis @ squares, deviation**2, edf)) < _RAMP_SEEN:
        squares, counted[_RAMP] = np.append(without, 0.0), False
    alpha = np.array([term.alpha for term in TERMS])[np.argmax(basis * squares, axis=1)]
    own = _degrees(m, n, alpha)
    fitted = basis @ squares
    left = len(m) - int((squares > 0.0).sum())
    deviance = 2.0 * (_minus_log(fitted, deviation**2, edf)
                      - _minus_log(deviation**2, deviation**2, edf))
    misfit = deviance / max(left, 1)
    allowed = chi2_ppf(CONFIDENCE, 1) * max(misfit, 1.0)
    tail = (1.0 - CONFIDENCE) / 2.0
    return AllanCurve(
        m / rate_hz, deviation, deviation * np.sqrt(own / chi2_ppf(1.0 - tail, own)),
        deviation * np.sqrt(own / chi2_ppf(tail, own)), np.sqrt(fitted),
        tuple(_coefficient(k, basis, counted, deviation**2, edf, squares, allowed)
              for k in range(len(TERMS))),
        misfit, bool(chi2_sf(deviance, max(left, 1)) > _UNLIKELY))


def _basis(tau: Array) -> Array:
    return np.stack([term.factor * tau**float(term.power) for term in TERMS], axis=1)


def _degrees(m: Ints, n: int, alpha: Ints) -> Array:
    """Return the equivalent degrees of freedom of the overlapping estimator, (len(m),)."""
    from allantools import ci
    edf = [ci.edf_simple(n + 1, k, 2) if a == 2 else
           ci.edf_greenhall(a, 2, k, n + 1, overlapping=True) for k, a in zip(m.tolist(), alpha)]
    return np.minimum(edf, 2.0 / _MODEL**2)


def _minus_log(variance: Array, seen: Array, edf: Array) -> float:
    """Return minus the logarithm of the likelihood, but for a constant."""
    return float(0.5 * edf @ (np.log(variance) + seen / variance))


def _fit(basis: Array, seen: Array, edf: Array, fixed: Array | float = 0.0) -> Array:
    """Return the most likely squares of the coefficients, beside a fixed part of the variance."""
    variance, before = seen, math.inf
    squares = np.zeros(basis.shape[1])
    for _ in range(_ROUNDS):
        weight = np.sqrt(edf) / variance
        scaled = basis * weight[:, None]
        size = np.linalg.norm(scaled, axis=0)
        new = nnls(scaled / size, (seen - fixed) * weight)[0] / size
        squares = new if before is math.inf else 0.5 * (squares + new)
        variance = np.maximum(basis @ squares + fixed, 1e-12 * seen)
        value = _minus_log(variance, seen, edf)
        if abs(before - value) < _STEADY * (1.0 + abs(value)):
            break
        before = value
    return squares


def _coefficient(k: int, basis: Array, counted: Mask, seen: Array, edf: Array, squares: Array,
                 allowed: float) -> Coefficient:
    """Return a coefficient with the interval that its profile likelihood allows."""
    others = basis[:, counted & (np.arange(len(counted)) != k)]
    best = _minus_log(basis @ squares, seen, edf)

    def excess(square: float) -> float:
        fixed = square * basis[:, k]
        rest = others @ _fit(others, seen, edf, fixed) + fixed
        return 2.0 * (_minus_log(np.maximum(rest, 1e-12 * seen), seen, edf) - best) - allowed

    def limit(inside: float, outside: float) -> float:
        return math.exp(brentq(lambda x: excess(math.exp(x)), math.log(inside),
                               math.log(outside), xtol=1e-4))

    largest = float(np.min(seen / basis[:, k]))
    inside = squares[k] if squares[k] > 1e-9 * largest else 1e-9 * largest
    scale = TERMS[k].scale
    high = scale * math.sqrt(limit(inside, _FAR * largest))
    if inside != squares[k] or excess(0.0) <= 0.0:
        return Coefficient(None, 0.0, high)
    low = limit(1e-9 * largest, inside) if excess(1e-9 * largest) > 0.0 else 1e-9 * largest
    return Coefficient(scale * math.sqrt(squares[k]), scale * math.sqrt(low), high)
