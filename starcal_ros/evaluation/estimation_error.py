# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""True values behind a simulated run, and the errors of an estimate of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation.augmented import true_values
from starcal_ros.filter.augmentation import NONE, Augmentation
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.states import N_STATES, PHI
from starcal_ros.simulation.truth import Truth


def nominal(truth: Truth, stamp_ns: int, augmentation: Augmentation = NONE) -> Nominal:
    """Return the true values at a stamp, where bias and mounting are on their way there."""
    stamp = np.array([stamp_ns])
    return Nominal(truth.motion.attitude(stamp)[0].T, truth.bias_at(stamp)[0],
                   truth.mounting_at(stamp)[0], truth.intrinsics,
                   true_values(augmentation, truth), augmentation=augmentation)


@dataclass(frozen=True)
class TrueRuns:
    """The true values behind the runs of a batch.

    Attributes
    ----------
    seeds : sequence of int
        One for each run.
    truths : sequence of Truth
        Of each run; the first alone where nothing moves, since they then differ in nothing.
    augmentation : Augmentation
        Which optional states the filter has.
    """

    seeds: Sequence[int]
    truths: Sequence[Truth]
    augmentation: Augmentation

    @classmethod
    def of(cls, scenario: Scenario, seeds: Sequence[int]) -> TrueRuns:
        """Return those of a scenario with several seeds."""
        truths = [Truth.from_scenario(scenario.replace({'simulation.seed': int(seed)}))
                  for seed in seeds]
        return cls(seeds, truths if truths[0].moves else truths[:1],
                   Augmentation.of(scenario.estimator.augment))

    def at(self, stamp_ns: int) -> Nominal:
        """Return the true values at a stamp; bias and mounting of each run where they move."""
        first, stamp = self.truths[0], np.array([stamp_ns])
        true = nominal(first, stamp_ns, self.augmentation)
        if not first.moves:
            return true
        return replace(true, bias=np.stack([run.bias_at(stamp)[0] for run in self.truths]),
                       C_sg=np.stack([run.mounting_at(stamp)[0] for run in self.truths]))


def attitude_error(C_gi: Array, true: Nominal) -> Array:
    """Return phi, (..., 3), of attitudes (..., 3, 3) [rad], T18 Eq. 7."""
    return rotation.log(true.C_gi.T @ C_gi)


def state_error(estimate: Nominal, true: Nominal) -> Array:
    """Return the errors of T18's states and of augmented values, (..., 16 + m)."""
    error = estimate.minus(true)
    error[..., PHI] = attitude_error(estimate.C_gi, true)
    error[..., N_STATES:] = estimate.augmented - true.augmented
    return error
