# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Units, axes and mounting: which matrix takes the gyros' turns to the stars', and its name.

From the turns of `turns`, at a lag that is searched, the least squares of ::

    r_k = A g_k + c dt                                                                   (K.4)

give A and its covariance. A = O / s with O orthogonal: s is the unit of the rates, O the mounting
with whatever was done to the axes. Each explanation is a matrix with a name; it fits where it
leaves of the turns no more than the initial sigma of the fixed angles allows. Matrices that differ
by less are the same explanation, and where the motion does not tell them apart both are named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import itertools
from typing import NamedTuple

import numpy as np

from starcal_ros.checks.chance import SIGMAS
from starcal_ros.checks.finding import Finding
from starcal_ros.checks.turns import LEAST, Running, Turns
from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR, NS
from starcal_ros.messages.conventions import C_os

UNITS = ((np.degrees(1.0), 'degrees a second'),
         (np.degrees(1.0) * 3600.0, 'arcseconds a second, or degrees an hour'),
         (1e3, 'milliradians a second'), (60.0, 'radians a minute'),
         (np.degrees(1.0) * 60.0, 'degrees a minute'), (1e-3, 'kiloradians a second'),
         (30.0 / np.pi, 'revolutions a minute'), (0.5 / np.pi, 'revolutions a second'),
         (1.0 / np.degrees(1.0), 'converted from degrees to radians once too often'),
         (0.01, 'hundreds of radians a second'))
"""What rates may be in, and how many of it 1 rad/s is."""
_UNIT = 0.01            # part by which a unit may be missed
_SCALED = 0.02          # part from which on the turns differ in size: less is a scale factor
_LAGS_S, _LAG_STEP_S = 40.0, 0.25
_FINE_STEPS = 25
_MOST = 2000            # intervals that a lag is searched with
_SEEN = 30.0            # times the noise of an interval that the camera must turn, RMS
_TOGETHER = 0.5         # part of the turns that no linear map leaves where both turn together
_LEAST_ANGLE = np.radians(0.3)
_APART = 5.0            # times what a name must leave more than the best to be ruled out


class Named(NamedTuple):
    """A matrix C_sg, its name, and whether a mounting can be that."""

    name: str
    O: Array                                            # noqa: E741  # as in the text above
    kind: str


@dataclass(frozen=True)
class Coarse:
    """What relates the two histories, roughly.

    Attributes
    ----------
    lag_s : float
        Time on the gyro's clock less the stamp of a frame.
    unit : float
        Times 1 rad/s that the readings are in.
    C_sg : (3, 3) array
        Orthogonal; a reflection where the handedness differs.
    bias : (3,) array
        Of the readings divided by their unit [rad/s].
    findings : tuple of Finding
    known : bool
        Whether the matrix is believed: else no finer comparison is made.
    """

    lag_s: float
    unit: float
    C_sg: Array
    bias: Array
    findings: tuple[Finding, ...]
    known: bool


class _Moments:
    """Least squares of Eq. (K.4) from moments: what any matrix leaves."""

    def __init__(self, dt: Array, r: Array, g: Array) -> None:
        self.n = len(g)
        self.rate_r, self.rate_g = (dt @ turn / max(float(dt @ dt), 1e-300) for turn in (r, g))
        g, r = g - dt[:, None] * self.rate_g, r - dt[:, None] * self.rate_r
        self.gg, self.rg = g.T @ g, r.T @ g
        self.rr = float(np.sum(r**2))

    def best(self) -> Array:
        """Return A of Eq. (K.4), of least norm where the motion leaves it open."""
        return self.rg @ np.linalg.pinv(self.gg, rcond=1e-7, hermitian=True)

    def left(self, A: Array) -> float:
        """Return the sum of squares that a matrix leaves."""
        return float(self.rr - 2.0 * np.sum(A * self.rg) + np.sum((A @ self.gg) * A))


def coarse(turns: Turns, running: Running, first_ns: int, scenario: Scenario) -> Coarse | None:
    """Find lag, unit and matrix; None where the motion is too little to say anything.

    Parameters
    ----------
    turns : Turns
        By the stars.
    running : Running
        The integral of the readings.
    first_ns : int
        Stamp of the first reading.
    scenario : Scenario
        What is believed of the mounting.
    """
    if len(turns) < LEAST:
        return None
    noise = np.sqrt(np.trace(turns.R_begin + turns.R_end, axis1=1, axis2=2).mean())
    centred = turns.r - np.median(turns.r, axis=0)
    if np.sqrt(np.mean(np.sum(centred**2, axis=-1))) < _SEEN * noise:
        return None
    lag_s, moments = _lag(turns, running, first_ns)
    C_sg = mounting_matrix(scenario.mounting)
    A = moments.best()
    if moments.left(A) > _TOGETHER * moments.rr:
        return Coarse(lag_s, 1.0, C_sg, np.zeros(3), (_apart(moments, A),), False)
    return _named(turns, moments, A, lag_s, C_sg, scenario)


def _lag(turns: Turns, running: Running, first_ns: int) -> tuple[float, _Moments]:
    """Return the lag at which a linear map leaves least, 0 where that does nearly as well."""
    step = -(-len(turns) // _MOST)
    some = turns.take(np.arange(len(turns)) % step == 0)

    def moments(of: Turns, lag_s: float) -> _Moments:
        begin_s, end_s = (np.asarray((stamp - first_ns) * NS + lag_s, np.float64)
                          for stamp in (of.begin_ns, of.end_ns))
        g, inside = running.turned(begin_s, end_s)
        return _Moments(of.dt[inside], of.r[inside], g)

    def left(lag_s: float) -> float:
        found = moments(some, lag_s)
        if found.n < max(LEAST, 0.5 * len(some)):
            return 1.0
        return found.left(found.best()) / max(found.rr, 1e-300)

    grid = np.arange(-_LAGS_S, _LAGS_S + 1e-9, _LAG_STEP_S)
    lags = grid[np.argmin([left(lag) for lag in grid])] + _LAG_STEP_S * np.linspace(
        -1.0, 1.0, 2 * _FINE_STEPS + 1)
    part = [left(lag) for lag in lags]
    best = int(np.argmin(part))
    lag_s = float(lags[best]) if left(0.0) > 2.0 * part[best] else 0.0
    return lag_s, moments(turns, lag_s)


def _apart(moments: _Moments, A: Array) -> Finding:
    part = 100.0 * (1.0 - moments.left(A) / moments.rr)
    return Finding('no common motion', 'what the gyros read explains '
                   f'{max(part, 0.0):.0f} % of how the camera turned among the stars, with any '
                   f'unit, axes and mounting and any lag up to {_LAGS_S:.0f} s: are the readings '
                   'of this instrument, and are the stamps of both those of one clock?',
                   'driver of the gyro')


def _named(turns: Turns, moments: _Moments, A: Array, lag_s: float, C_sg: Array,
           scenario: Scenario) -> Coarse:
    """Name the matrix."""
    allowed = max(SIGMAS * np.sqrt(3.0) * ARCSEC
                  * scenario.estimator.initial_sigma.fixed_angles_arcsec, _LEAST_ANGLE)
    free = moments.left(A)
    unit, unit_finding = _unit(moments, A)

    def miss(O: Array) -> float:                        # noqa: E741
        """Return what an orthogonal matrix leaves more than any, as an angle."""
        more = max(moments.left(O / unit) - free, 0.0)
        return float(np.sqrt(more / moments.rr))

    fits_best = max(allowed, 3.0 * np.sqrt(free / moments.rr / moments.n))
    findings = [unit_finding] if unit_finding else []
    explained = [(miss(each.O), each) for each in _explanations(C_sg, scenario)]
    nominal = explained[0][0]
    proper, improper = (_orthogonal(moments, sign) for sign in (1.0, -1.0))
    if nominal <= fits_best:
        return _coarse(moments, C_sg, unit, lag_s, findings, True)
    if min(miss(proper), miss(improper)) > max(2.0 * _SCALED, fits_best):
        findings.append(Finding('axes', 'the readings are no turned or mirrored axes of the '
                                'camera: the best linear map has the rows '
                                f'{_rows(A * unit)}', 'driver of the gyro'))
        return _coarse(moments, C_sg, unit, lag_s, findings, False)
    good = [(left, each) for left, each in explained[1:] if left <= fits_best]
    distinct = _distinct(good, allowed)
    if len(distinct) > 1:
        names = ' or '.join(each.name for _, each in distinct)
        findings.append(Finding('axes', f'the stated axes leave {np.degrees(nominal):.1f} deg of '
                                f'a radian turned; {names}: the motion does not tell which, turn '
                                'about another axis too', 'mounting'))
        return _coarse(moments, C_sg, unit, lag_s, findings, False)
    if not distinct and min(miss(proper), miss(improper)) > fits_best:
        return _coarse(moments, C_sg, unit, lag_s, findings, False)
    determined = _determined(moments)
    if not distinct and not determined:
        findings.append(Finding('axes', 'the stated mounting and axes leave '
                                f'{np.degrees(nominal):.1f} deg of a radian turned, and the '
                                'motion does not tell what would fit: turn about another axis too',
                                'mounting'))
        return _coarse(moments, C_sg, unit, lag_s, findings, False)
    # Where two axes alone are turned about, a reflection fits as well as a rotation.
    O = improper if determined and miss(improper) < miss(proper) else proper    # noqa: E741
    if distinct:
        O = _near(distinct[0][1].O, O) if determined else distinct[0][1].O      # noqa: E741
    findings.append(_mounting(O, C_sg, good, distinct, allowed, nominal))
    return _coarse(moments, O, unit, lag_s, findings, True)


def _coarse(moments: _Moments, O: Array, unit: float, lag_s: float,      # noqa: E741
            findings: list[Finding], known: bool) -> Coarse:
    # r / dt = O (g / dt / unit + b): what the constant parts leave is the bias, seen in g.
    bias = O.T @ moments.rate_r - moments.rate_g / unit
    return Coarse(lag_s, unit, O, bias, tuple(findings), known)


def _unit(moments: _Moments, A: Array) -> tuple[float, Finding | None]:
    """Return the unit of the readings, 1 for rad/s."""
    ratio = float(np.sqrt(np.sum(moments.gg.trace()) / np.sum((A @ moments.gg) * A)))
    if abs(ratio - 1.0) <= _SCALED:
        return 1.0, None
    named = [(size, text) for size, text in UNITS if abs(ratio / size - 1.0) <= _UNIT]
    size, text = named[0] if named else (ratio, '')
    return size, Finding(
        'unit of the rates', f'the gyros turn {ratio:.4g} times as fast as the stars'
        + (f': {text}, where rad/s are asked for?' if text else
           ', which is no usual unit: what does the driver scale its rates by?'),
        'driver of the gyro', (ratio,), (), '', driver={'rates_times': float(1.0 / size)})


def _orthogonal(moments: _Moments, sign: float) -> Array:
    """Return the rotation or the reflection that fits best (Kabsch)."""
    U, _, Vt = np.linalg.svd(moments.rg)
    U[:, 2] *= sign * np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    return U @ Vt


def _determined(moments: _Moments) -> bool:
    """Tell whether the motion is about all three axes: about the least by 3 % of the most."""
    values = np.linalg.eigvalsh(moments.gg)
    return bool(values[0] > 1e-3 * values[2])


def _explanations(C_sg: Array, scenario: Scenario) -> Iterator[Named]:
    """Yield what may have been done, the stated first and what is simple before the rest."""
    yield Named('as stated', C_sg, 'mounting')
    yield Named('its inverse (from the star tracker to the gyros)', C_sg.T, 'mounting')
    yield Named("it stated for ROS's optical frame, not for that of T18", C_os @ C_sg, 'mounting')
    yield Named("the inverse of one for ROS's optical frame", C_os @ C_sg.T, 'mounting')
    yield Named("the orientation of ROS's optical frame in the gyros",
                (C_sg @ C_os).T, 'mounting')
    if (given := scenario.mounting.quaternion_xyzw) is not None:
        x, y, z, w = given
        for text, q in (('its quaternion written w, x, y, z', (y, z, w, x)),
                        ('its quaternion with w first, and inverse', (-y, -z, -w, x)),):
            yield Named(text, rotation.to_matrix(np.array(q) / np.linalg.norm(q)), 'mounting')
    if (angles := scenario.mounting.fixed_angles_deg) is not None:
        x, y, z = np.radians(angles)
        turns = [rotation.exp(angle * axis) for angle, axis in zip((x, y, z), np.eye(3))]
        yield Named('its angles as turns about x, then the new y, then the new z',
                    turns[0] @ turns[1] @ turns[2], 'mounting')
        yield Named('its angles in radians, not degrees',
                    rotation.from_fixed_angles(np.array(angles)), 'mounting')
    for P in _signed_permutations():
        kind = 'mounting' if np.linalg.det(P) > 0.0 else 'gyro axes'
        yield Named(_axes_text(P), C_sg @ P, kind)


def _signed_permutations() -> Iterator[Array]:
    """Yield the 47 that change anything, those of few changes first."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            P = np.zeros((3, 3))
            P[range(3), order] = signs
            found.append((sum(k != at for k, at in enumerate(order))
                          + sum(sign < 0.0 for sign in signs), P))
    yield from (P for changes, P in sorted(found, key=lambda each: each[0]) if changes)


def _axes_text(P: Array) -> str:
    """Say which reading is the rate about which axis: the rate is P times the readings."""
    order, signs = np.abs(P).argmax(axis=1), P.sum(axis=1)
    reversed_ = [axis for axis, sign in zip('xyz', signs) if sign < 0.0]
    if (order == np.arange(3)).all():
        return f'gyro {" and ".join(reversed_)} reversed'
    fixed = [k for k in range(3) if order[k] == k]
    if len(fixed) == 1:
        text = 'gyro {} and {} swapped'.format(*('xyz'[k] for k in range(3) if k != fixed[0]))
        return text + (f', {" and ".join(reversed_)} reversed' if reversed_ else '')
    listed = ', '.join(('-' if sign < 0.0 else '') + 'xyz'[k] for k, sign in zip(order, signs))
    return f'gyro axes in the order {listed}'


def _distinct(good: list[tuple[float, Named]], allowed: float) -> list[tuple[float, Named]]:
    """Return explanations that are not the same matrix as a simpler one, nor far worse."""
    found: list[tuple[float, Named]] = []
    least = min((left for left, _ in good), default=0.0)
    for left, each in good:
        if left > _APART * max(least, np.radians(0.1)):
            continue
        if all(np.linalg.norm(each.O - other.O) > allowed for _, other in found):
            found.append((left, each))
    return found


def _near(named: Array, best: Array) -> Array:
    """Return the best matrix where it is of the same handedness as the named one."""
    return best if np.linalg.det(named) * np.linalg.det(best) > 0.0 else named


def _mounting(O: Array, C_sg: Array, good: list[tuple[float, Named]],    # noqa: E741
              distinct: list[tuple[float, Named]], allowed: float, nominal: float) -> Finding:
    turned = O @ C_sg.T
    if distinct:
        left, best = distinct[0]
        same = [each.name for _, each in good
                if np.linalg.norm(each.O - best.O) <= allowed and each is not best]
        names = ' or '.join([best.name, *same])
        fits = f'{names} fits to {np.degrees(left):.2g} deg'
    if np.linalg.det(O) < 0.0:
        P = C_sg.T @ (distinct[0][1].O if distinct else O)
        text = (f'{fits}' if distinct else 'gyros and camera differ in handedness')
        return Finding('axes of the gyro', f'{text}; as stated, {np.degrees(nominal):.1f} deg of '
                       'each radian turned are left, and no rotation does better than a '
                       'reflection', 'driver of the gyro', driver={
                           'rates_matrix': np.round(P, 6).tolist()})
    phi = rotation.log(turned)
    angle = float(np.degrees(np.linalg.norm(phi)))
    axis = phi / np.linalg.norm(phi)
    main = int(np.abs(axis).argmax())
    about = ('xyz'[main] if abs(axis[main]) > 0.999 else
             '[{:.2f}, {:.2f}, {:.2f}]'.format(*axis)) + ' of the star tracker'
    q = rotation.to_quaternion(O)
    name = f'; {fits}' if distinct else ''
    return Finding('mounting', f'the mounting is off by {angle:.1f} deg about {about}{name}',
                   'mounting', (angle,), (), 'deg', parameters={
                       'mounting.fixed_angles_deg': None,
                       'mounting.quaternion_xyzw': tuple(q.tolist())})


def _rows(A: Array) -> str:
    return '; '.join(', '.join(f'{value:.2f}' for value in row) for row in A)


def bias_deg_h(found: Coarse) -> Array:
    """Return the bias of the readings in their right unit [deg/h]."""
    return found.bias / DEG_PER_HOUR
