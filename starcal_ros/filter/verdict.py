# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimates are worth, and what would make them better.

Couplings
---------
Which states can not be told apart `ambiguity` finds; those count of which one is outside its
tolerance.

In the middle of the field Psi_y shifts all stars as u0 does, and Psi_x as v0 (T18 Sec. 3.4). What
matters for the attitude is their common effect, the equivalent principal point (T18 Fig. 9) ::

    du0' = du0 - (f / d) Psi_y,      dv0' = dv0 + (f / d) Psi_x                        (V.1)

so the correlation of u0 with Psi_y goes to +1 and that of v0 with Psi_x to -1, long before the
four are known: only the edges of the field tell them apart.

Advice
------
What motion would help `advice` finds, how long it will take `progress`. Only states count that are
outside their tolerance and can get inside, and those of `augmentation` that are coupled with them.

The word
--------
A sigma is a promise of the model. `converged` needs every sigma inside its tolerance, stars that
agree with the attitude, and innovations that keep the promise: where one of `innovation_tests`
fails the data contradict the model, and the calibration is `inconsistent`, however small its
sigmas are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.verdict_words import CONVERGED, INCONSISTENT, LOST, NOT_YET
from starcal_ros.filter import ambiguity
from starcal_ros.filter.advice import FRAMES, look_ahead
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.progress import Progress, unreachable
from starcal_ros.filter.states import CALIBRATED, N_STATES, STATE_NAMES, STATE_UNITS, UNIT

_PSI_X, _PSI_Y, _U0, _V0, _F = (STATE_NAMES.index(name)
                                for name in ('psi_x', 'psi_y', 'u0', 'v0', 'f'))

NEVER = 'never'
"""Advice on states that nothing tells apart."""


class State(NamedTuple):
    """One calibrated state, in its unit."""

    name: str
    unit: str
    sigma: float
    tolerance: float

    @property
    def within(self) -> bool:
        """Whether sigma is inside the tolerance."""
        return self.sigma <= self.tolerance


class Coupling(NamedTuple):
    """States that can not be told apart yet.

    Attributes
    ----------
    names : tuple of str
        Out of `Verdict.names`.
    advice : str
        What would tell them apart; NEVER where nothing would.
    """

    names: tuple[str, ...]
    advice: str

    @property
    def reason(self) -> str:
        """What makes them alike."""
        return ambiguity.reason(self.names)

    @property
    def sentence(self) -> str:
        """Which states, why, and what to do."""
        return f'{", ".join(self.names)} ({self.reason}): {self.advice}'


@dataclass(frozen=True)
class Verdict:
    """Where a calibration stands.

    Attributes
    ----------
    states : tuple of State
        The 13 calibrated states.
    names : tuple of str
        All states, the attitude in s, those of `augmentation` behind the 16.
    correlation : (16 + m, 16 + m) array
        Of these.
    equivalent_sigma_px : (2,) array
        Standard deviation of the equivalent principal point, Eq. (V.1) [px].
    couplings : tuple of Coupling
        What can not be told apart yet.
    motion : str
        What would help the states that are outside their tolerance; empty where nothing can.
    tracking : bool
        Whether the stars agree with the attitude.
    statistics : tuple of Statistic
        Tests of the innovations.
    never : dict
        The states that no time and no motion brings inside their tolerance, and why.
    remaining_s : float
        How long the others will take at the present rate of gain [s]; infinite for no end, NaN
        where it is not known.
    """

    states: tuple[State, ...]
    names: tuple[str, ...]
    correlation: Array
    equivalent_sigma_px: Array
    couplings: tuple[Coupling, ...]
    motion: str
    tracking: bool
    statistics: tuple[Statistic, ...] = ()
    never: Mapping[str, str] = field(default_factory=dict)
    remaining_s: float = np.nan

    @property
    def outside(self) -> tuple[str, ...]:
        """Names of the states whose sigma is outside its tolerance."""
        return tuple(state.name for state in self.states if not state.within)

    @property
    def word(self) -> str:
        """One of the four words."""
        return word(not self.outside, self.tracking, self.statistics)

    @property
    def converged(self) -> bool:
        """Whether the calibration may be trusted as its covariance says."""
        return self.word == CONVERGED

    @property
    def u0_psi_y(self) -> float:
        """Correlation of u0 with Psi_y."""
        return float(self.correlation[_U0, _PSI_Y])

    @property
    def v0_psi_x(self) -> float:
        """Correlation of v0 with Psi_x."""
        return float(self.correlation[_V0, _PSI_X])

    @property
    def advice(self) -> str:
        """What to do; empty where nothing is to be done."""
        said = self.word
        if said == CONVERGED:
            return ''
        if said == LOST:
            return 'see whether stamps, gaps or the mounting have lost the attitude'
        if said == INCONSISTENT:
            return 'do not believe the sigmas: find what contradicts the model'
        more = time_text(self.remaining_s) if self.motion else ''
        if self.motion == FRAMES:
            parts = [more if np.isinf(self.remaining_s) else FRAMES, more]
        else:
            parts = [self.motion, f'as it is {more}' if more else '']
        for reason in dict.fromkeys(self.never.values()):
            names = [name for name, its in self.never.items() if its == reason]
            parts.append(f'never within the tolerance: {", ".join(names)} ({reason})')
        return '; '.join(dict.fromkeys(filter(None, parts)))

    @property
    def summary(self) -> str:
        """One sentence."""
        if self.word == CONVERGED:
            return CONVERGED
        if self.word == LOST:
            return f'{LOST}: most stars are rejected'
        if self.word == INCONSISTENT:
            return f'{INCONSISTENT}: {failures(self.statistics)}'
        if not self.outside:
            return f'{NOT_YET}: too few frames have tested the model'
        return f'{NOT_YET}: {", ".join(self.outside)}; {self.advice}'


def failures(statistics: Sequence[Statistic]) -> str:
    """Say which tests fail: the clearest in full, the others by their names."""
    first, *others = sorted((each for each in statistics if not each.passed),
                            key=lambda each: -each.excess)
    also = f'; also {", ".join(each.name for each in others)}' if others else ''
    return first.sentence + also


def time_text(remaining_s: float) -> str:
    """Say how long it will take; nothing where that is not known."""
    if np.isnan(remaining_s):
        return ''
    if np.isinf(remaining_s):
        return 'never at the present rate of gain'
    for unit, seconds in (('s', 1.0), ('min', 60.0), ('h', 3600.0)):
        if remaining_s < 100.0 * seconds or unit == 'h':
            break
    value = remaining_s / seconds
    return f'{value:.1f} {unit} more' if value < 10.0 else f'{value:.0f} {unit} more'


def word(known: bool, tracking: bool, statistics: Sequence[Statistic]) -> str:
    """Return the word for a calibration.

    Without any statistic, as in the first frames, nothing has converged: a covariance that was
    loaded is not yet seen to be true of these data.

    Parameters
    ----------
    known : bool
        Whether every sigma is inside its tolerance.
    tracking : bool
        Whether the stars agree with the attitude.
    statistics : sequence of Statistic
        Tests of the innovations.
    """
    if not tracking:
        return LOST
    if not all(each.passed for each in statistics):
        return INCONSISTENT
    return CONVERGED if known and statistics else NOT_YET


def of(calibrator: Calibrator, progress: Progress | None = None) -> Verdict:
    """Return the verdict on a calibrator that has an attitude."""
    assert calibrator.belief is not None
    return judge(calibrator.filter, calibrator.belief, calibrator.tracking,
                 calibrator.consistency.statistics(), progress)


def judge(filter_: Filter, belief: Belief, tracking: bool = True,
          statistics: tuple[Statistic, ...] = (), progress: Progress | None = None) -> Verdict:
    """Return the verdict on a belief.

    Parameters
    ----------
    filter_ : Filter
        With the tolerances, and the models to look ahead with.
    belief : Belief
        Of one run.
    tracking : bool
        Whether the stars agree with the attitude.
    statistics : tuple of Statistic
        Tests of the innovations.
    progress : Progress, optional
        How the run went; without it nothing is said of the time that it will take.
    """
    names, correlation = ambiguity.names(belief), ambiguity.correlation(belief)
    sigma = belief.sigma
    states = tuple(State(*row) for row in zip(
        STATE_NAMES[CALIBRATED], STATE_UNITS[CALIBRATED], (sigma / UNIT)[CALIBRATED].tolist(),
        (filter_.tolerance / UNIT[CALIBRATED]).tolist()))
    outside = {k for k, state in enumerate(states, CALIBRATED.start) if not state.within}
    never = {name: reason for name, reason in unreachable(filter_).items()
             if STATE_NAMES.index(name) in outside} if outside else {}
    open_ = {k for k in outside if names[k] not in never}
    couplings, motion, remaining_s = [], '', 0.0
    if outside:
        ahead = look_ahead(filter_, belief)
        stuck: set[int] = set()
        for group in ambiguity.groups(correlation):
            if outside & set(group):
                counted = _counted(group, names, never) if open_ & set(group) else []
                said = ahead.best(counted) if counted else NEVER
                couplings.append(Coupling(tuple(names[k] for k in group), said))
                # First what a motion must tell apart: the rest comes with time.
                stuck |= set(counted) if said not in (FRAMES, NEVER) else set()
        motion = ahead.best(sorted(stuck or open_)) if open_ else ''
        times = progress.remaining_s(filter_, sigma) if progress else None
        remaining_s = np.nan if times is None or not open_ else float(
            times[[k - CALIBRATED.start for k in open_]].max())
    return Verdict(states, names, correlation, equivalent_sigma(
        belief.state_root, belief.estimate.intrinsics, filter_.detector.pitch_mm),
        tuple(couplings), motion, tracking, statistics, never, remaining_s)


def _counted(group: list[int], names: tuple[str, ...], never: Mapping[str, str]) -> list[int]:
    """Return what a motion is judged by of the states that hang together: all it can do good."""
    fixed = ambiguity.antisymmetric(frozenset(names[k] for k in group))
    return [k for k in group if k >= CALIBRATED.start and names[k] not in never
            and not (fixed and k >= N_STATES)]


def equivalent_sigma(state_root: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the sigma of the equivalent principal point, (..., 2) [px], Eq. (V.1).

    Parameters
    ----------
    state_root : (..., 16, 16) array
        Root of the covariance of T18's states.
    intrinsics : (..., 7) array
        Camera.
    pitch_mm : float
        Pixel pitch [mm].
    """
    return np.linalg.norm(equivalent(state_root, intrinsics, pitch_mm), axis=-1)


def equivalent(states: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the equivalent principal point, (..., 2, k) [px], of k errors or columns of a root.

    Parameters
    ----------
    states : (..., 16, k) array
        T18's states, in the filter's units.
    intrinsics, pitch_mm
        As for `equivalent_sigma`.
    """
    scale = (intrinsics[..., camera.INTRINSICS.index('f')] / pitch_mm)[..., None]
    return np.stack((states[..., _U0, :] - scale * states[..., _PSI_Y, :],
                     states[..., _V0, :] + scale * states[..., _PSI_X, :]), axis=-2)
