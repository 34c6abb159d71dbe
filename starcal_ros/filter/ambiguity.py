# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which states can not be told apart, and why.

Model
-----
Each state is divided by its own standard deviation, which makes its covariance the correlation C,
of eigenvalues lambda and eigenvectors v. A combination v'x whose lambda is near zero is known far
better than the states in it: they are bound to each other, and each of them alone is as wide as
what the relation leaves free. Of a pair of correlation rho the eigenvalues are 1 - rho and
1 + rho, so a bound of ``1 - COUPLED`` on lambda is one of COUPLED on rho. Pairs do not show all:
at a constant rate omega a bias and ``omega x Psi`` turn the camera alike, four states of two
relations, of which no two need be correlated by more than 0.9.

Where several eigenvalues are near zero the eigenvectors are any mixture of the relations. What is
one and the same for all mixtures is the projector on them, ``P = sum v v'``: states hang together
where an element of it is not small.

For the sake of this the attitude error is counted in s, ``C_si phi``: at rest a frame sees only
its sum with Psi (E.1 of `error_state`), axis by axis, where phi in i is mixed with all three
components of Psi.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.states import CALIBRATED, PHI, STATE_NAMES

NAMES = ('attitude_x', 'attitude_y', 'attitude_z', *STATE_NAMES[CALIBRATED])
"""The 16 states, the attitude in s."""
COUPLED = 0.95
"""Correlation of two states above which they can not be told apart."""

_SHARE = 0.1            # element of the projector that binds two states; of a pair it is a half


def names(belief: Belief) -> tuple[str, ...]:
    """Return the names of all states, those of `augmentation` behind the 16."""
    return (*NAMES, *belief.nominal.augmentation.names)


def correlation(belief: Belief) -> Array:
    """Return the correlation of all states, (16 + m, 16 + m), in the order of their names."""
    root = belief.whole_root.copy()
    root[PHI] = belief.nominal.C_si @ root[PHI]
    root /= np.linalg.norm(root, axis=-1, keepdims=True)
    return root @ root.T


def groups(correlation: Array) -> list[list[int]]:
    """Return the states that are bound to each other by relations of their own."""
    value, vector = np.linalg.eigh(correlation)
    known = vector[:, value < 1.0 - COUPLED]
    linked = np.abs(known @ known.T) > _SHARE
    # Bound to each other over as many others as there are: who is bound to the same is a group.
    bound = np.linalg.matrix_power(linked + np.eye(len(linked)), len(linked)) > 0.0
    members = [np.flatnonzero(row).tolist() for row in np.unique(bound, axis=0)[::-1]]
    return [group for group in members if len(group) > 1]


def reason(states: Sequence[str]) -> str:
    """Say what makes the states of a group alike."""
    return next(_reasons(frozenset(states)), 'what the stars have shown of them is almost alike')


def antisymmetric(states: frozenset[str]) -> bool:
    """Whether a group holds a turn of the gyros against each other and the mounting."""
    return any({f'psi_{z}', f'M_{x}{y}_ppm', f'M_{y}{x}_ppm'} <= states
               for x, y, z in ('xyz', 'yzx', 'zxy'))


def _reasons(states: frozenset[str]) -> Iterator[str]:
    kinds = {name.partition('_')[0] for name in states}
    if antisymmetric(states):
        yield 'the antisymmetric part of the gyro matrix is a turn of the mounting'
    if {'tau', 'M'} <= kinds or {'tau', 'epsilon'} <= kinds:
        yield 'so far a time offset turns the stars as the gyro error does'
    if {'tau'} < kinds:
        yield 'at a constant rate a time offset is a turn of the camera'
    if {'epsilon', 'psi'} <= kinds:
        yield 'at a constant rate a turn of the mounting looks like a bias'
    if {'epsilon', 'M'} <= kinds:
        yield 'at a constant rate the gyro matrix looks like a bias'
    if {'psi', 'M'} <= kinds:
        yield 'about one axis the gyro matrix looks like a turn of the mounting'
    if 'psi' in kinds and kinds & {'u0', 'v0'}:
        yield 'in the middle of the field a turn shifts all stars as the principal point does'
    if {'attitude', 'psi'} <= kinds:
        yield 'so far the stars show only their sum'
