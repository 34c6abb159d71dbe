# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One mistake in one recording: what ``starcal check`` says, and what adopting it is worth.

What the check proposes is adopted: parameters as they are, and, where a driver is to be mended,
its numbers by what the finding says. The recording is then calibrated without and with it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from starcal_ros.checks.check import Checked, check
from starcal_ros.checks.finding import Finding, proposed
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import CALIBRATED, N_STATES, SCALE
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.reproduction.fault_injection import Messages
from starcal_ros.reproduction.user_mistakes import Mistake
from starcal_ros.results.result import word


@dataclass(frozen=True)
class KnownRecording:
    """A recording, what is rightly stated of it, and the truth at its end.

    Attributes
    ----------
    gyro, frames
        Its messages.
    scenario : Scenario
    truth : Nominal
        Attitude unknown: C_gi does not count.
    """

    gyro: GyroSamples
    frames: Frames
    scenario: Scenario
    truth: Nominal


class Judgement(NamedTuple):
    """What became of one mistake in one recording.

    Attributes
    ----------
    checked : Checked
    right : bool
        Whether its first kind was found.
    wrong : tuple of str
        Kinds that were found and are not right.
    off : float
        Largest error of the value over its sigma, relative error where it states none; NaN for
        no value.
    before, after : float
        Largest error of a calibrated state over its sigma, without and with what is proposed; NaN
        where there is no result, or nothing that can be adopted.
    words : tuple of str
        The verdicts of both.
    """

    checked: Checked
    right: bool
    wrong: tuple[str, ...]
    off: float
    before: float
    after: float
    words: tuple[str, str]


def run(mistake: Mistake, source: KnownRecording, seed: int, calibrated: bool = True) -> Judgement:
    """Make a mistake, check, and calibrate without and with what is proposed."""
    gyro, frames = mistake.spoil(source.gyro, source.frames, np.random.default_rng(seed))
    stated = source.scenario.replace(dict(mistake.stated(source.scenario)))
    checked = check(gyro, frames, stated)
    first = [each for each in checked.findings if mistake.kinds and each.kind == mistake.kinds[0]]
    wrong = tuple(sorted({each.kind for each in checked.findings} - set(mistake.kinds)))
    truth = mistake.true(source.truth)
    before = after = np.nan
    words = ('-', '-')
    if calibrated:
        before, said = _errors(gyro, frames, stated, truth)
        words = (said, '-')
        if any(each.parameters or each.driver for each in checked.findings):
            gyro, frames = mended(gyro, frames, checked.findings)
            after, said = _errors(gyro, frames, proposed(stated, checked.findings), truth)
            words = (words[0], said)
    # The finding has the whole bias, not what was added.
    value = tuple((truth.bias / DEG_PER_HOUR).tolist()) if any(mistake.bias) else mistake.value
    return Judgement(checked, bool(first), wrong, _off(value, first), before, after, words)


def mended(gyro: GyroSamples, frames: Frames, findings: Iterable[Finding]) -> Messages:
    """Return messages as they would be of drivers that do what the findings say.

    What a parameter is proposed for is left to that.
    """
    for finding in findings:
        if finding.parameters:
            continue
        todo = finding.driver
        rate, uv, sigma = gyro.rate, frames.uv_raster, frames.sigma
        rate = rate * todo.get('rates_times', 1.0) @ np.array(
            todo.get('rates_matrix', np.eye(3))).T
        uv = uv + np.array(todo.get('centroids_plus_px', (0.0, 0.0)))
        sigma = sigma * todo.get('sigma_times', 1.0)
        stamp = frames.stamp_ns
        middle = (stamp[0] + stamp[-1]) // 2
        moved = 1e9 * todo.get('frame_stamps_plus_s', 0.0) + (stamp - middle) * todo.get(
            'frame_stamps_drift', 0.0)
        later = 1e9 * todo.get('gyro_stamps_plus_s', 0.0) + (gyro.stamp_ns - middle) * todo.get(
            'gyro_stamps_drift', 0.0)
        gyro = GyroSamples(gyro.stamp_ns + np.rint(later).astype(np.int64), rate)
        frames = replace(frames, stamp_ns=stamp + np.rint(moved).astype(np.int64), uv_raster=uv,
                         sigma=sigma)
    return gyro, frames


def _errors(gyro: GyroSamples, frames: Frames, scenario: Scenario, truth: Nominal
            ) -> tuple[float, str]:
    """Return the largest error of a calibrated state over its sigma, and the verdict."""
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    belief = calibrator.belief
    if belief is None:
        return np.nan, 'no attitude'
    estimate = belief.estimate
    # The attitude, and what is estimated beyond the 16 states, do not count.
    true = replace(truth, C_gi=estimate.C_gi, augmentation=estimate.augmentation,
                   augmented=estimate.augmented)
    error = estimate.minus(true)[:N_STATES] / SCALE
    sigma = np.linalg.norm(belief.root[:N_STATES], axis=-1)
    return float(np.abs(error / sigma)[CALIBRATED].max()), word(calibrator)


def _off(truth: tuple[float, ...], found: list[Finding]) -> float:
    """Return how far the last numbers of the first finding are from the truth."""
    if not truth or not found or not found[0].value:
        return np.nan
    value = np.array(found[0].value[-len(truth):])
    sigma = np.array(found[0].sigma[-len(truth):] or np.abs(truth))
    return float(np.abs((value - truth) / sigma).max())
