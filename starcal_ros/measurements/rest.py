# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The longest stretch of gyro readings at rest, ten seconds at least, without a silence.

The readings are cut into blocks of a second. A block in which they scatter far more than from one
reading to the next is one of motion; between blocks at rest the mean does not jump. Of what is
steady, a slew at a constant rate too, that which turns least is the rest.

A gyro that turns at a constant rate from the first reading to the last looks as one with a bias.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.measurements.samples import GyroSamples

_BLOCK_S, _BLOCK_READINGS = 1.0, 16
_LEAST_BLOCKS = 10
_REGULAR = 0.2              # part of a period by which stamps may scatter
_SILENCE, _BURST = 1.5, 20  # periods that are a silence, of regular stamps and of others
_SCATTER = 10.0             # times the variance of a quiet block that is motion
_JUMP = 6.0                 # standard deviations that are a change of the rate
_COLOURED = 5.0             # times as much as white noise may the mean of a block scatter
_SAME = 50.0                # standard deviations of a block that the bias may be another at
_DEG_S = np.degrees(1.0)
_LARGE_BIAS, _NO_BIAS = 0.1, 1.0    # deg/s


@dataclass(frozen=True)
class RestStretch:
    """Readings at rest.

    Attributes
    ----------
    readings : slice
        Which they are.
    rate_hz : float
        How many a second.
    begin_s, end_s : float
        When, from the first reading of all on.
    notices : tuple of str
        What a user should know.
    """

    readings: slice
    rate_hz: float
    begin_s: float
    end_s: float
    notices: tuple[str, ...]


@dataclass(frozen=True)
class _Blocks:
    """Successive blocks between two silences: means, variances, those of differences, (n, 3)."""

    first: int
    mean: Array
    variance: Array
    high_pass: Array


def longest_rest(gyro: GyroSamples) -> RestStretch:
    """Find the longest stretch at rest.

    Raises
    ------
    ValueError
        Where there is none, with the reason.
    """
    n = len(gyro)
    if n <= 2 * _BLOCK_READINGS:
        raise ValueError(f'{n} gyro readings, too few to see whether it is at rest')
    for axis, span in zip('xyz', np.ptp(gyro.rate, axis=0)):
        if not span > 0.0:
            raise ValueError(f'the gyro readings about {axis} never change')
    period_ns, ends, notices = _silences(gyro.stamp_ns)
    size = max(round(_BLOCK_S / (period_ns * NS)), _BLOCK_READINGS)
    runs = [_blocks(gyro.rate, low, high, size)
            for low, high in zip([0, *ends], [*ends, n]) if high - low >= size]
    found = [part for part in (_steady(runs, size) if runs else ())
             if part[1] - part[0] >= _LEAST_BLOCKS * size]
    if not found:
        raise ValueError(f'nowhere at rest: of {n} gyro readings no {_LEAST_BLOCKS * size} in a '
                         'row are steady')
    quiet = _quiet(runs)
    level = min((rate for *_, rate in found), key=lambda rate: float(np.linalg.norm(rate)))
    if np.abs(level).max() * _DEG_S > _NO_BIAS:
        raise ValueError(f'nowhere at rest: it turns at {_text(level)} deg/s where it turns least')
    begin, end = max(((low, high) for low, high, rate in found
                      if (np.abs(rate - level) <= _SAME * np.sqrt(quiet / size)).all()),
                     key=lambda part: part[1] - part[0])
    seconds = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
    if end - begin < n - size:
        notices.append('not at rest, or not without a silence, all the time: '
                       f'{seconds[begin]:.1f} to {seconds[end - 1]:.1f} s of {seconds[-1]:.1f} s '
                       'are used')
    mean = gyro.rate[begin:end].mean(axis=0)
    if np.abs(mean).max() * _DEG_S > _LARGE_BIAS:
        notices.append(f'it reads {_text(mean)} deg/s on the mean: a bias, or does it turn?')
    rate_hz = (end - begin - 1) / (seconds[end - 1] - seconds[begin])
    return RestStretch(slice(begin, end), float(rate_hz), float(seconds[begin]),
                       float(seconds[end - 1]), tuple(notices))


def _silences(stamp_ns: Ints) -> tuple[float, list[int], list[str]]:
    """Return the period [ns], after how many readings a silence is, and what to say."""
    step = np.diff(stamp_ns)
    apart = min(20, len(step))
    period = float(np.median(stamp_ns[apart:] - stamp_ns[:-apart])) / apart
    if period <= 0.0:
        raise ValueError('the stamps of the gyro readings do not increase')
    notices = []
    scatter = float(np.percentile(np.abs(step - period), 95)) / period
    if scatter > _REGULAR:
        notices.append(f'the stamps are irregular, by {100.0 * scatter:.0f} % of the period of '
                       f'{period * 1e-6:.3g} ms: the readings are taken as equally spaced')
    longest = (_BURST if scatter > _REGULAR else _SILENCE) * period
    back, silent = step < (0 if scatter > _REGULAR else 1), step > longest
    if back.any():
        notices.append(f'the stamps stand or go back, {back.sum()} times')
    if silent.any():
        notices.append(f'the gyro is silent {silent.sum()} times, for {step.max() * NS:.3f} s at '
                       'most')
    return period, (np.flatnonzero(back | silent) + 1).tolist(), notices


def _blocks(rate: Array, low: int, high: int, size: int) -> _Blocks:
    count = (high - low) // size
    blocks = rate[low:low + count * size].reshape(count, size, 3)
    return _Blocks(low, blocks.mean(axis=1), blocks.var(axis=1),
                   0.5 * (np.diff(blocks, axis=1)**2).mean(axis=1))


def _quiet(runs: list[_Blocks]) -> Array:
    """Return the variance of a reading at rest, (3,), as most blocks have it."""
    variance = np.median(np.concatenate([run.variance for run in runs]), axis=0)
    high_pass = np.concatenate([run.high_pass for run in runs])
    smallest = [float(column[column > 0.0].min(initial=np.inf)) for column in high_pass.T]
    floor = np.where(np.isfinite(smallest), smallest, np.finfo(float).tiny)
    return np.maximum(np.minimum(variance, _SCATTER * np.median(high_pass, axis=0)), floor)


def _steady(runs: list[_Blocks], size: int) -> Iterator[tuple[int, int, Array]]:
    """Yield the steady stretches: first reading, the one after the last, mean rate."""
    quiet = _quiet(runs)
    white = np.sqrt(quiet / size)
    steps = np.concatenate([np.abs(np.diff(run.mean, axis=0)) for run in runs])
    usual = np.median(steps, axis=0) / 0.9539 if len(steps) else white    # of |N(0, 2)|
    allowed = _JUMP * np.sqrt(2.0) * np.clip(usual, white, _COLOURED * white)
    for run in runs:
        moving: Mask = np.any(run.variance > _SCATTER * quiet, axis=1)
        begin = moving.copy()
        begin[0] = True
        begin[1:] |= moving[:-1] | (np.abs(np.diff(run.mean, axis=0)) > allowed).any(axis=1)
        edges = [*np.flatnonzero(begin).tolist(), len(begin)]
        for low, high in zip(edges, edges[1:]):
            if not moving[low]:
                yield (run.first + low * size, run.first + high * size,
                       run.mean[low:high].mean(axis=0))


def _text(rate: Array) -> str:
    return ', '.join(f'{value:.3g}' for value in rate * _DEG_S)
