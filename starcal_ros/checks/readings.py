# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the numbers of the gyro say by themselves: frozen, repeated, saturated, too coarse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from starcal_ros.checks.finding import Finding
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import robust
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, NS
from starcal_ros.measurements.samples import GyroSamples

_LEAST = 100
_REPEATED = 0.02        # part of the readings that are the one before again
_FROZEN_S = 2.0
LARGEST_RATE = 1e9     # of a reading in whatever unit; beyond, it is no number
_AT_LIMIT = 0.003       # part of the readings at the largest
_IN_A_ROW = 5
_LEVELS = 4096          # different readings, at most, of one that is coarse
_COARSE = 2.0           # times the noise of a reading that it may be rounded to
_ENOUGH = 1 << 16       # readings that the levels are looked for in
_GRID = 1e-3            # by which a level may miss a multiple of the step
_DRIVER = 'driver of the gyro'


def of_readings(gyro: GyroSamples, scenario: Scenario) -> Iterator[Finding]:
    """Yield what is wrong with the readings, whatever the stars say."""
    bad = ~gyro.plausible(LARGEST_RATE)
    if bad.any():
        yield Finding('not finite', f'{int(bad.sum())} of {len(gyro)} gyro readings are not '
                      'finite numbers', _DRIVER)
    gyro = gyro.take(~bad)
    if len(gyro) < _LEAST:
        return
    if not gyro.rate.any():
        yield Finding('all zero', f'all {len(gyro)} gyro readings are 0', _DRIVER)
        return
    span = np.ptp(gyro.rate, axis=0)
    still = [axis for axis, width in zip('xyz', span) if width == 0.0]
    if still:
        yield Finding('frozen', f'the gyro readings about {" and ".join(still)} never change: '
                      + ', '.join(f'{value:g}' for value, width in zip(gyro.rate[0], span)
                                  if width == 0.0) + ' rad/s', _DRIVER)
        if len(still) == 3:
            return
    step = _steps(gyro.rate)
    coarse = np.isfinite(step)
    # A reading that is rounded may well be the largest for a while.
    saturated = list(_saturated(gyro.rate, np.where(coarse, 0.0, span)))
    yield from saturated or _repeated(gyro, bool(coarse.any()))
    if coarse.any():
        yield from _quantised(gyro, step, scenario)


def _runs(same: Mask) -> tuple[Ints, Ints]:
    """Return where runs of true begin and how long they are."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int8)))
    return edges[::2].astype(np.int64), (edges[1::2] - edges[::2]).astype(np.int64)


def _repeated(gyro: GyroSamples, coarse: bool) -> Iterator[Finding]:
    """Yield readings that are sent again; coarse ones may be the same by chance."""
    same: Mask = np.asarray((np.diff(gyro.rate, axis=0) == 0.0).all(axis=-1))
    begins, lengths = _runs(same)
    if not len(begins):
        return
    seconds = (gyro.stamp_ns[begins + lengths] - gyro.stamp_ns[begins]) * NS
    longest = int(np.argmax(seconds))
    if seconds[longest] > _FROZEN_S and not coarse:
        since = (gyro.stamp_ns[begins[longest]] - gyro.stamp_ns[0]) * NS
        yield Finding('frozen', f'the gyro repeats one reading for {seconds[longest]:.1f} s, from '
                      f'{since:.1f} s on, under new stamps', _DRIVER)
        return
    part = float(same.mean())
    if part > _REPEATED and not coarse:
        yield Finding('repeated readings', f'{100 * part:.0f} % of the gyro readings repeat the '
                      'one before under a new stamp: published more often than read',
                      _DRIVER, (part,), (), 'part')


def _saturated(rate: Array, span: Array) -> Iterator[Finding]:
    """Yield readings that stop at a limit, time after time and for a while."""
    told = []
    for axis, column, width in zip('xyz', rate.T, span):
        if not width:
            continue
        for limit in (column.max(), column.min()):
            at = column == limit
            _, lengths = _runs(np.asarray(at))
            if (at.mean() > _AT_LIMIT and lengths.max() >= _IN_A_ROW
                    and len(np.unique(column)) > 50):
                told.append((axis, float(limit)))
    if told:
        listed = ', '.join(f'{axis} at {np.degrees(limit):.4g}' for axis, limit in told)
        yield Finding('saturated', f'readings stop at a limit ({listed} deg/s): saturated',
                      _DRIVER, tuple(limit for _, limit in told), (), 'rad/s')


def _steps(rate: Array) -> Array:
    """Return the step that all readings of an axis are multiples of, (3,); infinite for none."""
    found = np.full(3, np.inf)
    for k, column in enumerate(rate[::-(-len(rate) // _ENOUGH)].T):
        levels = np.unique(column)
        if not 2 < len(levels) <= min(_LEVELS, len(column) // 8):
            continue
        gaps = np.diff(levels)
        step = float(gaps.min())
        if step > 1e-12 * np.abs(levels).max() and (np.abs(
                gaps / step - np.rint(gaps / step)) < _GRID * np.maximum(gaps / step, 1.0)).all():
            found[k] = step
    return found


def _quantised(gyro: GyroSamples, step: Array, scenario: Scenario) -> Iterator[Finding]:
    """Yield a quantisation that alone is worth more than the stated angular random walk."""
    largest = float(step[np.isfinite(step)].max())
    period_s = robust.middle(np.diff(gyro.stamp_ns)) * NS
    stated = scenario.gyro.arw_deg_sqrt_h
    noise = stated * DEG_PER_SQRT_HOUR / np.sqrt(period_s)
    if largest > _COARSE * noise:
        yield Finding('quantisation', 'the readings are multiples of '
                      f'{largest / DEG_PER_HOUR:.3g} deg/h, where gyro.arw_deg_sqrt_h of '
                      f'{stated:g} is a noise of {noise / DEG_PER_HOUR:.2g} deg/h a reading: '
                      'rounded so coarsely they do not average', _DRIVER,
                      (largest / DEG_PER_HOUR,), (), 'deg/h')
