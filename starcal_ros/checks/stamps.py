# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the stamps say by themselves: rates, bursts, clocks that differ, dates that can not be."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from starcal_ros.checks.finding import Finding
from starcal_ros.core import robust
from starcal_ros.core.arrays import Ints
from starcal_ros.core.units import ARCSEC, NS
from starcal_ros.core.utc import utc_text
from starcal_ros.measurements.samples import Frames, GyroSamples

if TYPE_CHECKING:
    from starcal_ros.config.scenario import Scenario

_LEAST = 20             # messages that a rate needs
_RATE_OFF = 0.03        # part by which a rate may be off its parameter
_IRREGULAR = 0.2        # part of a period, at the 95th percentile
_BURST = 0.05           # part of a period that messages of a burst are apart
_BURSTS = 0.3           # part of all that come in bursts
_BACK = 0.001           # part of the stamps that may stand or go back
_HOUR_S, _MINUTE_S = 3600.0, 60.0
_CLOSE_S = 0.6          # by which a difference of clocks may miss a known one
_SECONDS = ((37.0, 'TAI'), (18.0, 'GPS time'), (19.0, 'GPS time against TAI'))
_FIRST_NS = 946_684_800 * 10**9         # 2000: before it no camera had a clock that was right
_ABERRATION_ARCSEC = 20.5
_LOG_S = 86400.0        # by which the log time may differ from the stamps: a replay has its own


class LogTimes(NamedTuple):
    """When the first and the last message of a topic were recorded [ns]; None where unknown."""

    first_ns: int | None
    last_ns: int | None


def of_stamps(gyro: GyroSamples, frames: Frames, scenario: Scenario,
              logged: LogTimes | None = None) -> Iterator[Finding]:
    """Yield what is wrong with the stamps, in one pass over both topics."""
    yield from of_topic('gyro readings', gyro.stamp_ns, 'gyro.rate_hz', scenario.gyro.rate_hz,
                        'driver of the gyro')
    yield from of_topic('frames', frames.stamp_ns, 'star_tracker.rate_hz',
                        scenario.star_tracker.rate_hz, 'driver of the star tracker')
    camera = scenario.camera
    yield from of_clocks(
        gyro.stamp_ns, frames.stamp_ns, logged, scenario.star_tracker.centroid_sigma_px
        * camera.pixel_pitch_mm / camera.focal_length_mm / ARCSEC)


def of_topic(what: str, stamp_ns: Ints, key: str | None, stated_hz: float, driver: str
             ) -> Iterator[Finding]:
    """Yield what is wrong with the stamps of one topic.

    Parameters
    ----------
    what : str
        What its messages are.
    stamp_ns : (n,) int64 array
        In the order of arrival.
    key : str or None
        The parameter of its rate; None where none is stated.
    stated_hz : float
        Its value.
    driver : str
        What stamps them.
    """
    if len(stamp_ns) < _LEAST:
        return
    step = np.diff(stamp_ns)
    if not stamp_ns.any():
        yield Finding('no stamps', f'all stamps of the {what} are 0', driver)
        return
    back = int((step <= 0).sum())
    if back > _BACK * len(step):
        again = int((step == 0).sum())
        yield Finding('stamps go back', f'{back} of {len(step)} stamps of the {what} are not '
                      f'newer than the one before, {again} of them the same: sent twice, or out '
                      'of order', driver)
    period = robust.middle(step[step > 0]) if (step > 0).any() else 0.0
    if not period:
        return
    apart = min(20, len(step))
    mean = robust.middle(stamp_ns[apart:] - stamp_ns[:-apart]) / apart
    near = float((step < _BURST * mean).mean())
    scatter = float(np.percentile(np.abs(step - mean), 95)) / mean
    if near > _BURSTS and back <= _BACK * len(step):
        yield Finding('bursts', f'{100 * near:.0f} % of the {what} are stamped within '
                      f'{_BURST * mean * 1e-6:.2g} ms of the one before: stamped on arrival, in '
                      'bursts', driver)
    elif scatter > _IRREGULAR and back <= _BACK * len(step):
        yield Finding('irregular stamps', f'the stamps of the {what} are irregular, by '
                      f'{100 * scatter:.0f} % of their period of {mean * 1e-6:.4g} ms: stamped on '
                      'arrival?', driver, (scatter * mean * 1e-6,), (), 'ms')
    rate = 1e9 / mean if mean > 0.0 else 0.0
    if key and rate and abs(rate / stated_hz - 1.0) > _RATE_OFF:
        then = ': every interval counts as a silence' if (
            key == 'gyro.rate_hz' and rate < stated_hz / 1.5) else ''
        proposed = float(f'{rate:.4g}')
        yield Finding('rate', f'the stamps of the {what} show {rate:.4g} Hz, {key} is '
                      f'{stated_hz:g}{then}', key, (rate,), (), 'Hz', {key: proposed})


def of_clocks(gyro_ns: Ints, frames_ns: Ints, logged: LogTimes | None = None,
              sigma_arcsec: float | None = None) -> Iterator[Finding]:
    """Yield clocks that differ, and dates that can not be.

    Parameters
    ----------
    gyro_ns, frames_ns : (n,) int64 arrays
        The stamps.
    logged : LogTimes, optional
        Of the frames.
    sigma_arcsec : float, optional
        Of a centroid, to tell by it what a wrong date does.
    """
    apart = False
    if len(gyro_ns) and len(frames_ns):
        first, last = int(frames_ns[0] - gyro_ns[0]), int(frames_ns[-1] - gyro_ns[-1])
        overlap = (min(gyro_ns.max(), frames_ns.max()) - max(gyro_ns.min(), frames_ns.min())) * NS
        span = min(np.ptp(gyro_ns), np.ptp(frames_ns)) * NS
        shift = 0.5 * (first + last) * NS
        known = known_difference(shift)
        if known is not None:
            shift = math.copysign(known.seconds, shift)
        # Both ends must be off by the same: a topic that is cut short has one end off.
        both = abs(first - last) * NS < 2.0 + 0.01 * abs(shift)
        if overlap < 0.5 * span or (known is not None and both):
            apart = True
            text = (f': by {shift:.1f} s' + (f', {known.name}?' if known else '')) if both else ''
            yield Finding('clocks', f'gyro from {utc_text(int(gyro_ns[0]))}, frames from '
                          f'{utc_text(int(frames_ns[0]))}: different clocks{text}',
                          'driver of the gyro or of the star tracker', (shift,), (), 's',
                          driver={'gyro_stamps_plus_s': shift} if both else {})
    if len(frames_ns):
        yield from _dates(frames_ns, logged, apart, sigma_arcsec)


class Difference(NamedTuple):
    """A difference of clocks that has a name."""

    seconds: float
    name: str


def known_difference(seconds: float) -> Difference | None:
    """Return what a difference of clocks may be, by its size; None for nothing known."""
    size = abs(seconds)
    for known, name in _SECONDS:
        if abs(size - known) < _CLOSE_S:
            return Difference(known, f'{known:.0f} s: {name}')
    hours = size / _HOUR_S
    if 0.9 < hours < 14.1 and abs(size - 1800.0 * round(2.0 * hours)) < 5.0:
        half = round(2.0 * hours)
        return Difference(1800.0 * half, f'{0.5 * half:g} h: a time zone')
    return None


def _dates(frames_ns: Ints, logged: LogTimes | None, apart: bool,
           sigma_arcsec: float | None) -> Iterator[Finding]:
    first = int(frames_ns[0])
    if first < _FIRST_NS:
        when, shift = '', 0.0
        if logged is not None and logged.first_ns is not None and logged.first_ns > _FIRST_NS:
            shift = (logged.first_ns - first) * NS
            when = f', and were recorded at {utc_text(int(logged.first_ns))}'
        wrong = 2.0 * _ABERRATION_ARCSEC
        sigmas = f', {wrong / sigma_arcsec:.2g} sigmas of a centroid' if sigma_arcsec else ''
        yield Finding('no UTC', f'the frames are stamped {utc_text(first)}{when}: no UTC. Proper '
                      'motion and aberration are those of that date, of which aberration alone '
                      f'displaces stars by up to {wrong:.0f} arcsec{sigmas}',
                      'driver of the star tracker', (shift,) if shift else (), (), 's',
                      driver={'both_stamps_plus_s': shift} if shift else {})
        return
    if logged is None or logged.first_ns is None or apart:
        return
    shift = (logged.first_ns - first) * NS
    known = known_difference(shift)
    if abs(shift) > _LOG_S:
        # A simulator or a replay may well run at another date.
        return
    if known is not None:
        yield Finding('stamps and log', f'the frames are stamped {utc_text(first)} and were '
                      f'recorded at {utc_text(int(logged.first_ns))}: {known.name}?',
                      'driver of the star tracker', (shift,), (), 's')
