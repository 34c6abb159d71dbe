# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which optional states are on, and where they stand behind the 16.

`STATES` lists those that there are; a further one is an entry there and a field of
`AugmentConfig`. The values of those that are on stand in one vector (..., m), in the order of the
list; their errors, estimate minus truth, follow the 16.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from starcal_ros.config.estimator import AugmentConfig
from starcal_ros.core.arrays import Array
from starcal_ros.filter.gyro_matrix import GyroMatrix
from starcal_ros.filter.optional_state import Drawn, OptionalState
from starcal_ros.filter.pixel_phase import PixelPhase
from starcal_ros.filter.rate_noise import NoiseMoments
from starcal_ros.filter.states import N_STATES, SCALE
from starcal_ros.filter.time_offset import TimeOffset

STATES: tuple[OptionalState, ...] = (GyroMatrix(), TimeOffset(), PixelPhase())


@dataclass(frozen=True)
class Augmentation:
    """The optional states of one filter.

    Attributes
    ----------
    on : tuple of OptionalState
        Those that are on, in their order.
    """

    on: tuple[OptionalState, ...] = ()

    @classmethod
    def of(cls, config: AugmentConfig) -> Augmentation:
        """Return those whose initial sigma is given."""
        return cls(tuple(state for state in STATES if getattr(config, state.key) is not None))

    @property
    def size(self) -> int:
        """Number m of values."""
        return len(self.names)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each value, with its human unit."""
        return tuple(name for state in self.on for name in state.names)

    @cached_property
    def units(self) -> Array:
        """Human unit of each value, (m,), in the unit that the filter counts in."""
        return np.array([state.unit for state in self.on for _ in state.names])

    @cached_property
    def scale(self) -> Array:
        """What the filter divides each of the 16 + m errors by, (16 + m,)."""
        return np.append(SCALE, [state.scale for state in self.on for _ in state.names])

    @cached_property
    def rescale(self) -> Array:
        """What turns a matrix (16 + m, 16 + m) on errors into one on scaled errors, by element."""
        rescale: Array = self.scale / self.scale[:, None]
        return rescale

    @cached_property
    def needs_matrix(self) -> bool:
        """Whether `preintegration` has to give the derivative by the gyro matrix."""
        return any(state.needs_matrix for state in self.on)

    def initial_sigma(self, config: AugmentConfig) -> Array:
        """Return the first standard deviation of each value, (m,), in the filter's units."""
        return np.array([getattr(config, state.key) * state.unit
                         for state in self.on for _ in state.names])

    @cached_property
    def places(self) -> tuple[tuple[OptionalState, slice], ...]:
        """Each state that is on, and where its values stand among the m."""
        ends = np.cumsum([0, *(len(state.names) for state in self.on)]).tolist()
        return tuple((state, slice(low, high))
                     for state, low, high in zip(self.on, ends[:-1], ends[1:]))

    def errors(self) -> Iterator[tuple[OptionalState, slice, slice]]:
        """Yield each state that is on, where its values stand, and where among the 16 + m."""
        for state, place in self.places:
            yield state, place, slice(N_STATES + place.start, N_STATES + place.stop)

    def gain(self, values: Array) -> Array:
        """Return G, (..., 3, 3), of values (..., m): the rate of g is G (reading - bias)."""
        G = np.eye(3)
        for state, place in self.places:
            G = G @ state.gain(values[..., place])
        return G

    @cached_property
    def effects(self) -> frozenset[int]:
        """Effects of `hypotheses` that a state is."""
        return frozenset(effect for state in self.on for effect in state.effects)

    @cached_property
    def draws(self) -> bool:
        """Whether the noise of the gyro draws a state along."""
        return any(type(state).drawn is not OptionalState.drawn for state in self.on)

    def drawn(self, N: Array, T: Array, moments: NoiseMoments, values: Array) -> Drawn:
        """Return what it adds for the scaled errors, (..., 16 + m) each, as `OptionalState.drawn`.

        ``values`` are those of all states that are on, (..., m).
        """
        added = Drawn(*np.zeros((2, *N.shape[:-2], len(self.scale))))
        for state, place, among in self.errors():
            drawn = state.drawn(N, T, moments, values[..., place])
            if drawn is not None:
                added.score[..., among] = drawn.score * self.scale[among]
                added.information[..., among] = drawn.information * self.scale[among]**2
        return added


NONE = Augmentation()
