# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What weighs against a calibration of the effects that its model leaves out.

The effects are those of `hypotheses` and the steps of `changes`, their sizes those that fit best
(`responses`). One counts where it is beyond chance *and* does harm: the part of it that shifts no
state by more than `HARM` of its sigma is taken off first. Over hours the data tell effects that
are much smaller than what the calibration is good to.
"""

from __future__ import annotations

from collections.abc import Iterator, Set as AbstractSet
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import ALARM, Statistic, chi2_beyond
from starcal_ros.filter.allowances import HARM
from starcal_ros.filter.changes import N_EFFECTS
from starcal_ros.filter.hypotheses import CELL, CHANGING, HYPOTHESES, STEP_NUMBERS
from starcal_ros.core.statistic import MARGIN
from starcal_ros.filter.innovation_tests import cell_name
from starcal_ros.filter.responses import Fit

STEADY = slice(CELL.start + 1)
"""Of the effects that are told: what is there all the time, of the cells the worst."""
STEPS = slice(CELL.start + 1, None)
"""The steps, each at its worst time."""


class Effect(NamedTuple):
    """An effect that is fitted.

    Attributes
    ----------
    name : str
        What it is called.
    numbers : tuple of str
        Its numbers, with their units.
    place : int
        Among all.
    tried : int
        Number of effects of which this is the worst.
    """

    name: str
    numbers: tuple[str, ...]
    place: int
    tried: int

    def limit(self, fit: Fit, place: int) -> Array:
        """Return the sizes, one a number, from which on it is found at a place among all."""
        return np.asarray(fit.sigma[place][:len(self.numbers)] * np.sqrt(self.bound(fit, place)))

    def bound(self, fit: Fit, place: int) -> float:
        """Return what its gain at a place is beyond chance from."""
        return MARGIN * chi2_beyond(ALARM / self.tried, max(int(fit.freedom[place]), 1))


class Weighed(NamedTuple):
    """An effect, and how much it weighs.

    Attributes
    ----------
    effect : Effect
    counted : float
        Twice the logarithm of the likelihood ratio, what does no harm taken off.
    bound : float
        What is beyond chance.
    harm : float
        Largest shift of a state, in its sigmas.
    """

    effect: Effect
    counted: float
    bound: float
    harm: float

    def statistic(self, fit: Fit, frames: int) -> Statistic:
        """Return it as a test over so many frames."""
        k = self.effect.place
        return Statistic(
            self.effect.name, self.counted, 0.0, self.bound, frames,
            fits=_sizes(self.effect.numbers, fit, k, self.harm), gain=float(fit.gain[k]))


_ALONE = [Effect(each.name, each.numbers, k, 1)
          for k, each in enumerate(HYPOTHESES[:CELL.start])]
_PLACES = len(HYPOTHESES) + np.arange(N_EFFECTS).reshape(-1, len(CHANGING))     # of the steps


def weighed(E: Array, root: Array, fit: Fit, begun: int, known: AbstractSet[int]
            ) -> Iterator[Weighed]:
    """Yield the effects of which something is told.

    Parameters
    ----------
    E : (n, g, 3) array
        Response of the scaled errors to each effect.
    root : (n, n) array
        Of their covariance.
    fit : Fit
        Sizes of the effects.
    begun : int
        Number of times at which steps were thought of.
    known : set of int
        Effects that are states of the filter.
    """
    shifted = np.einsum('ngk,gk->gn', E, fit.p)
    sigma = np.linalg.norm(root, axis=-1)
    harm = np.max(np.abs(shifted) / np.maximum(sigma, 1e-300), axis=-1)
    counted = fit.gain * np.maximum(1.0 - HARM / np.maximum(harm, 1e-300), 0.0)**2
    for effect in told(counted, begun):
        k = effect.place
        if fit.freedom[k] > 0 and k not in known:
            yield Weighed(effect, float(counted[k]), effect.bound(fit, k), float(harm[k]))


def told(counted: Array, begun: int) -> list[Effect]:
    """Return the effects to be told, of those of one kind the worst.

    Parameters
    ----------
    counted : (g,) array
        What each counts.
    begun : int
        As for `weighed`.
    """
    found = list(_ALONE)
    cell = CELL.start + int(np.argmax(counted[CELL]))
    found.append(Effect('displacement in the worst cell', tuple(
        f'{name} {cell_name(cell - CELL.start)}' for name in HYPOTHESES[cell].numbers), cell,
        CELL.stop - CELL.start))
    worst = np.argmax(counted[_PLACES], axis=0).tolist()
    for state, (name, numbers) in enumerate(zip(CHANGING, STEP_NUMBERS)):
        found.append(Effect(f'step of the {name}', numbers, int(_PLACES[worst[state], state]),
                            len(CHANGING) * max(begun, 1)))
    return found


def _sizes(numbers: tuple[str, ...], fit: Fit, k: int, harm: float) -> str:
    sizes = ', '.join(
        f'{name} {size:+.4g} +- {sigma:.2g}'
        for name, size, sigma in zip(numbers, fit.p[k], fit.sigma[k]) if np.isfinite(sigma))
    return f'{sizes}: shifts a state by {harm:.2g} sigma'
