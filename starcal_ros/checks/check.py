# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All checks of a recording, or of the first minutes of a live run, in their order.

What a finding explains is mended before what comes after it: rates are put to rad/s, axes in
order, frames to the gyro's clock. So a mounting is found behind a wrong unit, and a wrong unit is
not told of again as a scale factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from starcal_ros.checks import axes, explanations, from_sky, from_turns, readings, sky, stamps
from starcal_ros.checks.finding import Finding
from starcal_ros.checks.likelihood import StatedNoise
from starcal_ros.checks.stamps import known_difference
from starcal_ros.checks.turns import LEAST, Gyro, Running, covered, of_stars
from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.units import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, SQRT_HOUR
from starcal_ros.measurements.intake import in_gyro_time
from starcal_ros.measurements.samples import Frames, GyroSamples

_SPOILT = ('all zero', 'frozen', 'saturated', 'repeated readings', 'quantisation', 'bursts',
           'irregular stamps', 'no stamps', 'stamps go back')
"""Readings or stamps of which the turns say nothing reliable: they are not compared."""
_NO_STARS = {'unidentified stars', 'unknown numbers', 'no stars'}
_MOST = 5000            # frames that are compared
_MARGIN_S = 0.1
_CLOCKS_S = 5.0         # by which the difference of two clocks may be off at first
_LEAST_WALK = 1e-6      # deg/sqrt(h): no gyro has less


@dataclass(frozen=True)
class Checked:
    """What was found, and what could not be looked at.

    Attributes
    ----------
    findings : tuple of Finding
    untold : tuple of str
        What the recording does not show, and why.
    """

    findings: tuple[Finding, ...]
    untold: tuple[str, ...]

    def with_findings(self, more: Iterable[Finding]) -> Checked:
        """Return the same with other findings after these."""
        return replace(self, findings=(*self.findings, *more))


def check(gyro: GyroSamples, frames: Frames, scenario: Scenario,
          logged: stamps.LogTimes | None = None,
          on_progress: Callable[[float], None] | None = None) -> Checked:
    """Return what of a scenario the data deny.

    Parameters
    ----------
    gyro, frames
        In the order in which they were recorded.
    scenario : Scenario
        What the user states.
    logged : LogTimes, optional
        When the frames were recorded.
    on_progress : callable, optional
        Called with the part done, 0 to 1.
    """
    say = on_progress or (lambda part: None)
    frames = in_gyro_time(frames, scenario)
    found = [*stamps.of_stamps(gyro, frames, scenario, logged),
             *readings.of_readings(gyro, scenario), *from_sky.of_messages(frames, scenario)]
    say(0.1)
    date = [each for each in found if each.kind == 'no UTC']
    if date:
        shift_ns = round(float(date[0].driver.get('both_stamps_plus_s', 0.0)) * 1e9)
        if not shift_ns:
            return Checked(tuple(found), (
                'what the stars say: their places on the right date are not known',))
        gyro = GyroSamples(gyro.stamp_ns + shift_ns, gyro.rate)
        frames = replace(frames, stamp_ns=frames.stamp_ns + shift_ns)
    try:
        seen = sky.look(_some(frames), scenario)
    except sky.NoSkyError as error:
        if 'not where' in str(error) and not {each.kind for each in found} & _NO_STARS:
            found.append(Finding('wrong numbers', str(error), 'driver of the star tracker'))
        return Checked(tuple(found), (f'no attitudes from the stars: {error}',))
    say(0.4)
    found += from_sky.of_sky(seen, frames, scenario)
    if seen.mirrored:
        return Checked(tuple(found), ('the turns: a mirrored image turns the other way',))
    spoilt = sorted({each.kind for each in found} & set(_SPOILT))
    if spoilt:
        return Checked(tuple(found), (
            f'the turns: they are not compared with such readings ({", ".join(spoilt)})',))
    # Clocks that differ by something known: the turns tell whether they do.
    clocks = [each for each in found if each.driver.get('gyro_stamps_plus_s')]
    compared, why = _compare(gyro, _moved(seen, clocks), scenario)
    if clocks and any(each.kind == 'no common motion' or each.kind == 'time offset'
                      and abs(each.value[0]) > 1e3 * _CLOCKS_S for each in compared):
        found = [each for each in found if each not in clocks]
        compared, why = _compare(gyro, seen, scenario)
    elif clocks and known_difference(clocks[0].value[0]) is None:
        # By the first stamps alone two clocks are known to seconds: the turns know it better.
        more = sum(each.driver.get('frame_stamps_plus_s', 0.0) for each in compared
                   if each.kind == 'time offset')
        compared = [each for each in compared if each.kind != 'time offset']
        found = [replace(each, driver={'gyro_stamps_plus_s':
                                       each.driver['gyro_stamps_plus_s'] - more})
                 if each in clocks else each for each in found]
    say(1.0)
    return Checked((*found, *compared), tuple(why))


def _some(frames: Frames) -> Frames:
    """Return frames evenly spread over all, as many as are compared."""
    return frames.take(np.arange(0, len(frames), -(-len(frames) // _MOST) or 1))


def _moved(seen: sky.SeenSky, clocks: list[Finding]) -> sky.SeenSky:
    shift = sum(float(each.driver['gyro_stamps_plus_s']) for each in clocks)
    return replace(seen, stamp_ns=seen.stamp_ns - round(shift * 1e9))


def _compare(gyro: GyroSamples, seen: sky.SeenSky, scenario: Scenario
             ) -> tuple[list[Finding], list[str]]:
    """Compare the turns."""
    gyro = gyro.take(gyro.plausible(readings.LARGEST_RATE))
    gyro = gyro.take(sky.newer(gyro.stamp_ns))
    turns = of_stars(seen)
    if len(gyro) < 2 * LEAST or len(turns) < LEAST:
        return [], [f'the turns: {len(gyro)} readings and {len(turns)} intervals between frames '
                    'are too few']
    # Whether the camera turns enough is asked of what there are readings of. Where there are none
    # at all, the clocks differ.
    within = covered(turns, gyro, 0.0)
    if 0 < len(within) < LEAST:
        return [], [f'the turns: {len(within)} intervals between frames are covered by readings, '
                    'which are too few']
    rough = axes.coarse(within if len(within) else turns, Running.of(gyro),
                        int(gyro.stamp_ns[0]), scenario)
    if rough is None:
        return [], ['mounting, axes, units, stamps and scale: the camera does not turn enough']
    findings = list(rough.findings)
    if not rough.known:
        return findings, ['bias, stamps and noise: the axes are not known'] if findings else [
            'mounting, axes, bias and stamps: the motion does not tell']
    C_sg, rate, bias = rough.C_sg, gyro.rate / rough.unit, rough.bias
    if np.linalg.det(C_sg) < 0.0:
        C_sg = mounting_matrix(scenario.mounting)
        P = np.array(next(each.driver['rates_matrix'] for each in findings
                          if 'rates_matrix' in each.driver))
        rate, bias = rate @ P.T, P @ bias
    samples = GyroSamples(gyro.stamp_ns, rate)
    turns = covered(turns, samples, abs(rough.lag_s) + _MARGIN_S)
    if len(turns) < LEAST:
        return findings, ['bias, stamps and noise: too few intervals are covered by readings']
    noise = StatedNoise(
        max(scenario.gyro.arw_deg_sqrt_h, _LEAST_WALK) * DEG_PER_SQRT_HOUR,
        scenario.estimator.process_noise.gyro_bias_deg_h_sqrt_h * DEG_PER_HOUR / SQRT_HOUR)
    try:
        outcome = explanations.explain(turns, Gyro(samples), C_sg, bias, rough.lag_s, noise)
    except np.linalg.LinAlgError:       # as of attitudes that a frame's stars hardly give
        return findings, ['bias, stamps and noise: the turns are too badly known']
    named = [k for k, each in enumerate(findings) if 'mounting.quaternion_xyzw'
             in each.parameters]
    for k in named:
        findings[k] = replace(findings[k], parameters={
            'mounting.fixed_angles_deg': None,
            'mounting.quaternion_xyzw': from_turns.quaternion(outcome.C_sg)})
    # The mounting is that of the fitted camera: what its principal point is not known by, turns.
    scale = scenario.camera.pixel_pitch_mm / seen.camera.intrinsics[2]
    camera_sigma = np.sqrt(np.diag(seen.camera.covariance)[[1, 0]]) * scale
    findings += from_turns.findings(outcome, scenario, C_sg, camera_sigma, bool(named))
    return findings, []
