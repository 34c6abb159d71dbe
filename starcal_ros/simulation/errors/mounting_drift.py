# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Drift of the mounting: heat turns the star tracker against the gyros and back.

Model
-----
A first-order Gauss-Markov process about each axis of the star tracker (Gelb, *Applied Optimal
Estimation*, 1974, Sec. 3.8), stationary from the start of the run::

    C_sg(t) = exp(Psi(t)) C_sg
    Psi_k+1 = a Psi_k + sigma sqrt(1 - a^2) n_k,    a = exp(-h / tau)          (D.1)

    Psi    (3,)  rad    in s, as in T18 Eq. 8; mean 0, autocorrelation sigma^2 exp(-|t| / tau)
    sigma        rad    standard deviation of each component
    tau, h       s      time constant; step, linear between: h = tau / 100 costs 0.25 % of sigma^2

The constant C_sg of the truth is thus the mean. The gyros do not feel the drift.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from starcal_ros.config.parameter import Spec
from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import ARCSEC
from starcal_ros.simulation.process import Process
from starcal_ros.simulation.randomness import stream

GROUP = 'mounting_drift'
ORDER = 50
ON = {'drift 1"': {'sigma_arcsec': 1.0}}
NOTE = 'drift: Gauss-Markov of 1 h, errors from the mounting at the end.'

_STEPS = 100                # to a time constant
_MARGIN_S = 20              # by which exposures and late stamps reach beyond the run


@dataclass(frozen=True)
class Config:
    """How the mounting wanders about the true one."""

    sigma_arcsec: Annotated[float, Spec(
        'Standard deviation of the drift about each axis of the star tracker, 0 is off',
        'arcsec', 0.0, 3600.0)] = 0.0
    time_constant_s: Annotated[float, Spec(
        'Time constant of the drift, a first-order Gauss-Markov process', 's', 10.0, 1e7)
    ] = 3600.0


def mounting(scenario: Scenario) -> Callable[[Ints], Array] | None:
    """Return Psi(t) [rad], or None where it is off."""
    drift, simulation = scenario.truth.of(Config), scenario.simulation
    if drift.sigma_arcsec == 0.0:
        return None
    step = drift.time_constant_s / _STEPS
    count = int(np.ceil((simulation.duration_s + 2 * _MARGIN_S) / step)) + 1
    Psi = drift.sigma_arcsec * ARCSEC * stream(scenario, 'mounting_drift').standard_normal(
        (count, 3))
    a = np.exp(-1.0 / _STEPS)
    Psi[1:] *= np.sqrt(1.0 - a * a)
    for k in range(1, count):
        Psi[k] += a * Psi[k - 1]
    start_ns = stamp_ns('simulation.start_utc', simulation.start_utc)
    return Process(start_ns - _MARGIN_S * 10**9, step, Psi).at
