# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the comparison of the turns finds, in sentences: bias, mounting, stamps, noise, scale."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from starcal_ros.checks.chance import SIGMAS
from starcal_ros.checks.effects import (BIAS_STEP, BIAS_WALK, CLOCK_DRIFT, GYRO_MATRIX,
                                        MATRIX_NAMES, SCALE, STAMP_DRIFT, STAMPS, TIME_OFFSET,
                                        TIME_STEP, WALK)
from starcal_ros.checks.explanations import TurnModel
from starcal_ros.checks.finding import Finding
from starcal_ros.checks.model_selection import Explained
from starcal_ros.checks.stamps import known_difference
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, SQRT_HOUR

_NOISE_OFF = 1.3            # times or parts of a stated noise that counts
_NAMED = 0.03               # part of a named time offset by which it may be missed
_LONGEST_S = 0.03           # time offset that the estimator can be asked to find
_LARGEST_S = 10.0           # that may be stated


def findings(outcome: TurnModel, scenario: Scenario, C_sg: Array, camera_sigma: Array,
             named_mounting: bool) -> Iterator[Finding]:
    """Yield what is wrong.

    Parameters
    ----------
    outcome : TurnModel
        Of `explanations`.
    scenario : Scenario
        What is stated.
    C_sg : (3, 3) array
        The stated mounting, or the one that has been named in its place.
    camera_sigma : (2,) array
        Sigma of the mounting about x and y by the principal point [rad].
    named_mounting : bool
        Whether a wrong mounting has been named by `axes`.
    """
    if not named_mounting:
        yield from _mounting(outcome, scenario, C_sg, camera_sigma)
    yield from _bias(outcome, scenario)
    for each in outcome.explained:
        yield from _EACH[each.effect.name](each, outcome, scenario)


def quaternion(C_sg: Array) -> tuple[float, ...]:
    """Return a mounting as a parameter file has it."""
    return tuple(rotation.to_quaternion(C_sg).tolist())


def _mounting(outcome: TurnModel, scenario: Scenario, C_sg: Array, camera_sigma: Array
              ) -> Iterator[Finding]:
    psi = rotation.log(outcome.C_sg @ C_sg.T)
    initial = scenario.estimator.initial_sigma.fixed_angles_arcsec * ARCSEC
    sigma = np.hypot(outcome.psi_sigma, [*camera_sigma, 0.0])
    if not (np.abs(psi) > SIGMAS * np.hypot(initial, sigma)).any():
        return
    yield Finding(
        'mounting', f'the mounting is off by {_vector(psi / ARCSEC)} +- '
        f'{_vector(sigma / ARCSEC)} arcsec about x, y, z of the star tracker; '
        f'estimator.initial_sigma.fixed_angles_arcsec is {initial / ARCSEC:g}', 'mounting',
        tuple((psi / ARCSEC).tolist()), tuple((sigma / ARCSEC).tolist()), 'arcsec',
        {'mounting.fixed_angles_deg': None, 'mounting.quaternion_xyzw': quaternion(outcome.C_sg)})


def _bias(outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    stated = np.array(scenario.gyro.bias_deg_h)
    bias, sigma = outcome.bias / DEG_PER_HOUR, outcome.bias_sigma / DEG_PER_HOUR
    initial = scenario.estimator.initial_sigma.gyro_bias_deg_h
    if not (np.abs(bias - stated) > SIGMAS * np.hypot(initial, sigma)).any():
        return
    parameters: dict[str, object] = {'gyro.bias_deg_h': tuple(bias.tolist())}
    if sigma.max() > initial:
        parameters['estimator.initial_sigma.gyro_bias_deg_h'] = float(3.0 * sigma.max())
    yield Finding(
        'bias', f'bias about {_vector(bias)} +- {_vector(sigma)} deg/h, gyro.bias_deg_h is '
        f'{_vector(stated)} and estimator.initial_sigma.gyro_bias_deg_h {initial:g}',
        'gyro.bias_deg_h', tuple(bias.tolist()), tuple(sigma.tolist()), 'deg/h', parameters)


def _else(each: Explained, said: str) -> str:
    """Say how much better than anything else it explains, or that something else does as well."""
    if each.ambiguous:
        return (f'{said}; or a {each.rival}, which explains it as well: neither is believed '
                f'(twice the log-likelihood {each.gain:.0f}, {each.rival_gain:.0f})')
    return (f'{said} (twice the log-likelihood {each.gain:.0f}; the next best, {each.rival}, '
            f'{max(each.rival_gain, 0.0):.0f})')


def _made(each: Explained, kind: str, said: str, points_at: str, value: Array, sigma: Array,
          unit: str, parameters: dict[str, object], driver: dict[str, object] | None = None
          ) -> Finding:
    if each.ambiguous:
        kind, parameters, driver = f'{kind} or {each.rival}', {}, None
    return Finding(kind, _else(each, said), points_at, tuple(np.atleast_1d(value).tolist()),
                   tuple(np.atleast_1d(sigma).tolist()), unit, parameters, driver or {},
                   each.gain, f'{each.rival} {each.rival_gain:.0f}')


def _named_offset(tau_s: float, sigma_s: float, scenario: Scenario) -> str:
    """Return what a time offset is when it is the size of something known."""
    period_s, exposure_s = 1.0 / scenario.gyro.rate_hz, scenario.star_tracker.exposure_s
    known = [(0.5 * exposure_s, 'half the exposure: frames are stamped at its start?'),
             (-0.5 * exposure_s, 'half the exposure: frames are stamped at its end?'),
             (-0.5 * period_s, 'half a gyro period: readings are stamped in the middle of their '
              'interval?'),
             (-period_s, 'a gyro period: readings are stamped at the start of their interval?')]
    if (of_clocks := known_difference(tau_s)) is not None:
        return f': {of_clocks.name}?'
    near = [text for size, text in known if size and abs(tau_s - size) < max(
        4.0 * sigma_s, _NAMED * abs(size)) and sigma_s < 0.1 * abs(size)]
    return f': {near[0]}' if len(near) == 1 else ''


def _offset_text(tau_s: float, sigma_s: float) -> str:
    ms, digits = 1e3 * tau_s, max(0, min(4, 1 - math.floor(math.log10(max(1e3 * sigma_s, 1e-4)))))
    return (f'{abs(ms):.{digits}f} +- {1e3 * sigma_s:.{digits}f} ms '
            + ('early' if tau_s > 0.0 else 'late'))


def _parameters(tau_s: float, sigma_s: float, scenario: Scenario) -> dict[str, object]:
    late_s = scenario.star_tracker.time_offset_s - tau_s
    if abs(tau_s) > _LONGEST_S:
        # More than the estimator can be asked to find: what is known goes beforehand.
        return {} if abs(late_s) > _LARGEST_S else {
            'star_tracker.time_offset_s': float(f'{late_s:.7g}')}
    return {'estimator.augment.time_offset_sigma_s': float(
        f'{max(2.0 * abs(tau_s), 10.0 * sigma_s):.1g}')}


def _time_offset(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    tau, sigma = float(each.value[0]), float(each.sigma[0])
    allowed = scenario.estimator.augment.time_offset_sigma_s or 0.0
    if abs(tau) < SIGMAS * math.hypot(allowed, sigma):
        return
    yield _made(each, TIME_OFFSET, f'frames are stamped {_offset_text(tau, sigma)} by the clock '
                f'of the gyro{_named_offset(tau, sigma, scenario)}',
                'driver of the star tracker or of the gyro', each.value * 1e3, each.sigma * 1e3,
                'ms', _parameters(tau, sigma, scenario), {'frame_stamps_plus_s': tau})


def _clock_drift(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    (tau, drift), (sigma, drift_sigma) = each.value, each.sigma
    own = STAMP_DRIFT in each.effect.columns
    which = ('stamps of the gyro, not its readings,' if own else 'clock and readings of the gyro')
    driver: dict[str, object] = {'frame_stamps_plus_s': float(tau),
                                 'gyro_stamps_drift' if own else 'frame_stamps_drift':
                                 float(-drift if own else drift)}
    yield _made(each, CLOCK_DRIFT, f'by the frames, {which} run {1e6 * drift:+.3g} +- '
                f'{1e6 * drift_sigma:.2g} ppm fast, and the frames are stamped '
                f'{_offset_text(float(tau), float(sigma))} in the middle of the recording',
                'driver of the star tracker or of the gyro',
                np.array([1e3 * tau, 1e6 * drift]), np.array([1e3 * sigma, 1e6 * drift_sigma]),
                'ms, ppm', {}, driver)


def _time_step(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    when = outcome.step_s[TIME_STEP][each.effect.at]
    yield _made(each, TIME_STEP, f'the stamps of frames and gyro step against each other by '
                f'{_offset_text(float(each.value[1]), float(each.sigma[1]))}, about '
                f'{when:.0f} s after the first frame', 'driver of the star tracker or of the '
                'gyro', 1e3 * each.value, 1e3 * each.sigma, 'ms', {})


def _scale(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    value, sigma = 1e6 * each.value, 1e6 * each.sigma
    yield from _of_matrix(each, scenario, value, sigma,
                          f'gyro scale {value[0]:+.0f} +- {sigma[0]:.0f} ppm')


def _gyro_matrix(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    value, sigma = 1e6 * each.value, 1e6 * each.sigma
    listed = ', '.join(f'{name} {size:+.0f} +- {spread:.0f}' for name, size, spread in zip(
        MATRIX_NAMES, value, sigma) if abs(size) > 4.0 * spread)
    yield from _of_matrix(each, scenario, value, sigma,
                          f'gyro scale and misalignment: {listed} ppm')


def _of_matrix(each: Explained, scenario: Scenario, value: Array, sigma: Array, said: str
               ) -> Iterator[Finding]:
    allowed = scenario.estimator.augment.gyro_matrix_sigma_ppm or 0.0
    if (np.abs(value) < SIGMAS * np.hypot(allowed, sigma)).all():
        return
    largest = float(np.abs(value).max())
    parameters: dict[str, object] = {'estimator.augment.gyro_matrix_sigma_ppm': float(
        f'{max(2.0 * largest, float(sigma.max())):.1g}')} if largest < 5e3 else {}
    yield _made(each, each.effect.name, said, 'estimator.augment.gyro_matrix_sigma_ppm', value,
                sigma, 'ppm', parameters)


def _bias_step(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    value, sigma = each.value / DEG_PER_HOUR, each.sigma / DEG_PER_HOUR
    when = outcome.step_s[BIAS_STEP][each.effect.at]
    yield _made(each, BIAS_STEP, f'the bias steps by {_vector(value)} +- {_vector(sigma)} deg/h, '
                f'about {when:.0f} s after the first frame', 'gyro', value, sigma, 'deg/h', {})


def _walk(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    value, sigma = (float(part[0]) / DEG_PER_SQRT_HOUR for part in (each.value, each.sigma))
    stated = scenario.gyro.arw_deg_sqrt_h
    if stated / _NOISE_OFF < value < stated * _NOISE_OFF:
        return
    walks = [other.value[0] for other in outcome.explained if other.effect.name == BIAS_WALK]
    if walks and value * DEG_PER_SQRT_HOUR < walks[0] * outcome.resolved_s:
        return          # the bias walks faster than its waves follow: that is no other noise
    yield _made(each, WALK, f'angular random walk {value:.3g} +- {sigma:.1g} deg/sqrt(h), '
                f'gyro.arw_deg_sqrt_h is {stated:g}', 'gyro.arw_deg_sqrt_h', np.array(value),
                np.array(sigma), 'deg/sqrt(h)', {'gyro.arw_deg_sqrt_h': value})


def _bias_walk(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    value, sigma = (float(part[0]) / DEG_PER_HOUR * SQRT_HOUR
                    for part in (each.value, each.sigma))
    key = 'estimator.process_noise.gyro_bias_deg_h_sqrt_h'
    stated = scenario.estimator.process_noise.gyro_bias_deg_h_sqrt_h
    if stated / _NOISE_OFF < value < stated * _NOISE_OFF:
        return
    yield _made(each, BIAS_WALK, f'the bias walks by {value:.2g} +- {sigma:.1g} deg/h/sqrt(h), '
                f'{key} is {stated:g}', key, np.array(value), np.array(sigma),
                'deg/h/sqrt(h)', {key: value})


def _scatter(each: Explained, outcome: TurnModel, scenario: Scenario) -> Iterator[Finding]:
    yield _made(each, STAMPS, f'the stamps of the frames scatter by {1e3 * each.value[0]:.2g} +- '
                f'{1e3 * each.sigma[0]:.1g} ms against the gyro: are they stamped on arrival?',
                'driver of the star tracker', 1e3 * each.value, 1e3 * each.sigma, 'ms', {})


_EACH = {TIME_OFFSET: _time_offset, CLOCK_DRIFT: _clock_drift, TIME_STEP: _time_step,
         SCALE: _scale, GYRO_MATRIX: _gyro_matrix, BIAS_STEP: _bias_step, WALK: _walk,
         BIAS_WALK: _bias_walk, STAMPS: _scatter}


def _vector(values: Array) -> str:
    return '[' + ', '.join(f'{value:.3g}' for value in values) + ']'
