# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimates are worth, and the motion that would make them better.

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
The filter's own covariance is carried through a rotation by 30 degrees about each of the gyro's
axes and through a rest of the same length, each seen by a few frames of an even star field. The
axis that lowers the sigmas most is recommended, if it does more than the rest: what more frames
alone would settle needs no rotation. Which axis it is hardly depends on the noise that is assumed.

The word
--------
A sigma is a promise of the model. `converged` needs every sigma inside its tolerance, stars that
agree with the attitude, and innovations that keep the promise: where one of `innovation_tests`
fails the data contradict the model, and the calibration is `inconsistent`, however small its
sigmas are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera, kalman, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.units import DEG
from starcal_ros.filter import ambiguity
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, N_STATES, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Stars

_PSI_X, _PSI_Y, _U0, _V0, _F = (STATE_NAMES.index(name)
                                for name in ('psi_x', 'psi_y', 'u0', 'v0', 'f'))
_TURN = 30.0 * DEG      # the rotation that is tried, T18 Table 2
_TURN_S = 60.0          # its length
_LOOKS = 6              # times that the stars are looked at on the way
_LOOK_PX = 0.02         # sigma of a centroid of a look: some six frames of 0.05 px
_GRID = 5               # stars of a look, along each side of the detector
_WORTH = 0.9            # what a rotation may leave, at most, of the sigmas that a rest leaves


CONVERGED, NOT_YET, INCONSISTENT, LOST = 'converged', 'not yet', 'inconsistent', 'lost'


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
    axis : str
        Gyro axis, X, Y or Z, about which to rotate; empty where frames alone will do.
    """

    names: tuple[str, ...]
    axis: str

    @property
    def sentence(self) -> str:
        """Which states, why, and what to do."""
        return f'{", ".join(self.names)} ({ambiguity.reason(self.names)}): {advice(self.axis)}'


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
    axis : str
        Gyro axis, X, Y or Z, about which to rotate next; empty where frames alone will do.
    tracking : bool
        Whether the stars agree with the attitude.
    statistics : tuple of Statistic
        Tests of the innovations.
    """

    states: tuple[State, ...]
    names: tuple[str, ...]
    correlation: Array
    equivalent_sigma_px: Array
    couplings: tuple[Coupling, ...]
    axis: str
    tracking: bool
    statistics: tuple[Statistic, ...] = ()

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
    def summary(self) -> str:
        """One sentence."""
        if self.word == CONVERGED:
            return CONVERGED
        if self.word == LOST:
            return f'{LOST}: most stars are rejected'
        if self.word == INCONSISTENT:
            failed = next(each for each in self.statistics if not each.passed)
            return f'{INCONSISTENT}: {failed.sentence}'
        return f'{NOT_YET}: {", ".join(self.outside)}; {advice(self.axis)}'


def word(known: bool, tracking: bool, statistics: Sequence[Statistic]) -> str:
    """Return the word for a calibration.

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
    return CONVERGED if known else NOT_YET


def advice(axis: str) -> str:
    """Say what to do, for the axis of a `Verdict` or a `Coupling`."""
    return f'rotate about {axis}' if axis else 'more frames are needed'


def judge(filter_: Filter, belief: Belief, tracking: bool = True,
          statistics: tuple[Statistic, ...] = ()) -> Verdict:
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
    """
    names, correlation = ambiguity.names(belief), ambiguity.correlation(belief)
    states = tuple(State(*row) for row in zip(
        STATE_NAMES[CALIBRATED], STATE_UNITS[CALIBRATED],
        (belief.sigma / UNIT)[CALIBRATED].tolist(),
        (filter_.tolerance / UNIT[CALIBRATED]).tolist()))
    outside = {k for k, state in enumerate(states, CALIBRATED.start) if not state.within}
    couplings, axis = [], ''
    if outside:
        ahead = _look_ahead(filter_, belief)
        groups = [group for group in ambiguity.groups(correlation) if outside & set(group)]
        couplings = [Coupling(tuple(names[k] for k in group), _axis(ahead, group))
                     for group in groups]
        # First what a rotation must tell apart: the rest comes with time.
        stuck = [k for group, coupling in zip(groups, couplings) if coupling.axis for k in group]
        axis = _axis(ahead, stuck or sorted(outside))
    return Verdict(states, names, correlation, equivalent_sigma(
        belief.state_root, belief.estimate.intrinsics, filter_.detector.pitch_mm),
        tuple(couplings), axis, tracking, statistics)


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


def _look_ahead(filter_: Filter, belief: Belief) -> Array:
    """Return the sigmas of the states, (4, 16), after a rest and after each rotation."""
    turn = np.zeros((4, 3))
    turn[1:] = np.eye(3) * (_TURN / _LOOKS)
    dt = np.full(4, _TURN_S / _LOOKS)
    step = Preintegrated(rotation.exp(-turn), dt[:, None, None] * rotation.right_jacobian(-turn),
                         dt, np.zeros(4))
    half = 0.5 * np.array([filter_.detector.width, filter_.detector.height])
    side = np.linspace(-1.0, 1.0, _GRID) * (1.0 - 1.0 / _GRID)
    uv = half * np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    now = belief.estimate
    r_s = camera.unproject(uv, now.intrinsics, filter_.detector.pitch_mm)
    sigma = np.full((4, len(uv)), _LOOK_PX)
    C_gi, bias, C_sg, intrinsics = (np.broadcast_to(part, (4, *part.shape)) for part in (
        now.C_gi, now.bias, now.C_sg, now.intrinsics))
    nominal = Nominal(C_gi, bias, C_sg, intrinsics)
    ahead = Belief(nominal, np.zeros((4, N_STATES)),
                   np.broadcast_to(kalman.marginal(belief.root, N_STATES),
                                   (4, N_STATES, N_STATES)))
    for _ in range(_LOOKS):
        ahead = filter_.propagate(ahead, step)
        u_i = r_s @ ahead.nominal.C_si
        ahead = filter_.update(ahead, Stars(u_i, np.broadcast_to(uv, (4, *uv.shape)), sigma),
                               gated=False).belief
    return ahead.sigma


def _axis(ahead: Array, states: list[int]) -> str:
    """Return the axis whose rotation leaves least of the sigmas of the calibrated states."""
    counted = [k for k in states if CALIBRATED.start <= k < CALIBRATED.stop]
    left = np.exp(np.mean(np.log(ahead[1:, counted] / ahead[0, counted]), axis=-1))
    return 'XYZ'[int(left.argmin())] if left.min() < _WORTH else ''
