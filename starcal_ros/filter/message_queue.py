# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples and frames that wait for each other, counted as they come.

A frame waits until a gyro sample reaches its stamp, so that estimates do not depend on the order
in which the two topics came. What waits in vain is bounded: the oldest is dropped.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Ints
from starcal_ros.core.units import NS
from starcal_ros.filter.frame_result import Counts
from starcal_ros.measurements.gyro_buffer import GyroBuffer
from starcal_ros.measurements.intake import FRAMES_KEPT, GYRO_KEPT_NS
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.preintegration import GAP
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS


class MessageQueue:
    """What has come in and waits.

    Parameters
    ----------
    gyro_period_ns, frame_period_ns : float
        Of either topic.
    counts : Counts
        Where to count.
    notices : Notices
        Where to say what happened.

    Attributes
    ----------
    gyro : GyroBuffer
        Samples, those since the last frame at least.
    """

    def __init__(self, gyro_period_ns: float, frame_period_ns: float, counts: Counts,
                 notices: Notices) -> None:
        self._period_ns, self._frame_period_ns = gyro_period_ns, frame_period_ns
        self._counts, self._notices = counts, notices
        self.gyro = GyroBuffer()
        self._frames = Frames.empty()
        self._newest_frame_ns = NEVER_NS

    def __len__(self) -> int:
        """Return the number of frames that wait."""
        return len(self._frames)

    @property
    def next_frame_ns(self) -> int | None:
        """Stamp of the oldest frame that waits for the gyro, None where none does."""
        return int(self._frames.stamp_ns[0]) if len(self._frames) else None

    def add(self, gyro: GyroSamples, frames: Frames) -> None:
        """Take samples and frames, each in the order of its stamps."""
        if len(gyro):
            self._count_gyro(gyro)
            self.gyro.add(gyro)
        if len(frames):
            self._count_frames(frames.stamp_ns)
            self._frames = Frames.concatenate((self._frames, frames))

    def _count_gyro(self, samples: GyroSamples) -> None:
        stamps, before = samples.stamp_ns, self.gyro.newest_ns
        self._counts.gyro += len(samples)
        steps = stamps - np.concatenate((
            [stamps[0] if before == NEVER_NS else before], stamps[:-1]))
        silent = steps > GAP * self._period_ns
        self._counts.gyro_gaps += int(silent.sum())
        self._counts.missing_gyro += int(np.rint(steps[silent] / self._period_ns - 1).sum())
        if silent.any():
            self._notices.once('gap', f'gyro silent for {steps[silent][0] * NS:.3f} s before '
                               f'{stamps[silent][0]} ns: bridged')

    def _count_frames(self, stamps_ns: Ints) -> None:
        before = stamps_ns[0] if self._newest_frame_ns == NEVER_NS else self._newest_frame_ns
        steps = np.rint(np.diff(stamps_ns, prepend=before) / self._frame_period_ns) - 1
        self._counts.missing_frames += int(np.maximum(steps, 0).sum())
        self._newest_frame_ns = int(stamps_ns[-1])

    def reached(self) -> Frames:
        """Return the frames that the gyro has reached, which wait no longer."""
        frames = self._frames
        if not len(frames):
            forgotten = self.gyro.keep_last(GYRO_KEPT_NS)
            if forgotten:
                self._notices.once('no frames', f'no frame for {GYRO_KEPT_NS * NS:.0f} s: the '
                                   'oldest gyro readings are dropped')
                self._counts.dropped_messages += forgotten
            return frames
        ready = int(np.searchsorted(frames.stamp_ns, self.gyro.newest_ns, side='right'))
        excess = max(0, len(frames) - ready - FRAMES_KEPT)
        if excess:
            self._notices.once('no gyro', f'{FRAMES_KEPT} frames wait for the gyro: the oldest '
                               'are dropped')
            self._counts.dropped_messages += excess
        self._frames = frames[ready + excess:]
        return frames[:ready]

    def drop(self) -> None:
        """Drop what waits."""
        self._counts.dropped_messages += len(self._frames)
        self._frames, self.gyro = Frames.empty(), GyroBuffer()
