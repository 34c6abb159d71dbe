# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification of the frames of a recording, as the node ``star_identifier`` does it live."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Ints
from starcal_ros.identification.frame_identifier import FrameIdentifier
from starcal_ros.measurements.message_source import MessageSource
from starcal_ros.measurements.samples import Frames

FOCAL_ERROR = 0.1
"""Part of the focal length by which the nominal one may be wrong, where no star is identified
within ``estimator.initial_sigma``."""

_GYRO_S = 600.0         # of readings that are given at once: the identifier keeps an hour of them
_FOCAL = 'estimator.initial_sigma.focal_length_mm'


class Numbered(NamedTuple):
    """Frames with the catalogue numbers of their stars.

    Attributes
    ----------
    frames : Frames
        All, in their order; 0 is a spot that is not identified.
    notices : tuple of str
        What a user should know.
    """

    frames: Frames
    notices: tuple[str, ...]


def identify(source: MessageSource, scenario: Scenario,
             on_progress: Callable[[float], None] = lambda part: None) -> Numbered:
    """Identify the stars of all frames of a run; numbers that they have are forgotten.

    Parameters
    ----------
    source : MessageSource
        Its gyro readings, where it has any, carry the attitude from frame to frame.
    scenario : Scenario
        Nominal camera and how wrong it may be, mounting, gyro, observer.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ImportError, ValueError
        As `FrameIdentifier`.
    """
    found = _identified(source, scenario, on_progress)
    focal_mm, sigma_mm = (scenario.camera.focal_length_mm,
                          scenario.estimator.initial_sigma.focal_length_mm)
    if found.frames.catalog_id.any() or not len(found.frames.catalog_id):
        return found
    stated = f'a focal length of {focal_mm:g} mm, to {2.0 * sigma_mm:.3g} mm'
    if sigma_mm < FOCAL_ERROR * focal_mm:
        sigma_mm = FOCAL_ERROR * focal_mm
        wider = _identified(source, scenario.replace({_FOCAL: sigma_mm}), on_progress)
        if wider.frames.catalog_id.any():
            return wider._replace(notices=(
                f'with {stated} (camera.focal_length_mm, {_FOCAL}) no star is identified; with '
                f'{2.0 * FOCAL_ERROR:.0%} they are', *wider.notices))
    half_mm = scenario.camera.width * scenario.camera.pixel_pitch_mm / 2.0
    low, high = np.degrees(2.0 * np.arctan(
        half_mm / (focal_mm + np.array([2.0, -2.0]) * min(sigma_mm, 0.45 * focal_mm))))
    return found._replace(notices=(
        *found.notices, f'no star is identified: {len(found.frames.catalog_id)} spots in '
        f'{len(found.frames)} frames match no stars of a field of {low:.3g} to {high:.3g} deg '
        'across the width (camera.focal_length_mm, camera.pixel_pitch_mm)'))


def _identified(source: MessageSource, scenario: Scenario,
                on_progress: Callable[[float], None]) -> Numbered:
    identifier = FrameIdentifier(scenario)
    frames: list[Frames] = []
    numbers: list[Ints] = []
    has_gyro, step = False, max(1, round(_GYRO_S * scenario.gyro.rate_hz))
    for batch in source.batches():
        has_gyro |= len(batch.gyro) > 0
        frames.append(batch.frames)
        identifier.add_frames(batch.frames)
        for begin in range(0, len(batch.gyro), step):
            identifier.add_gyro(batch.gyro[begin:begin + step])
            numbers += identifier.process(wait=True)
        if not has_gyro:
            numbers += identifier.process(wait=False)
        on_progress(batch.done)
    numbers += identifier.process(wait=False)
    every = Frames.concatenate(frames)
    notices = dict.fromkeys(identifier.take_notices())
    return Numbered(replace(every, catalog_id=np.concatenate(
        [np.empty(0, np.int64), *numbers])), tuple(notices))
