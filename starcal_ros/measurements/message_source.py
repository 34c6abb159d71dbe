# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The messages of one run, which can be gone through again, and parts of them.

A recording of a week does not fit into memory: it is read in batches, pass by pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from starcal_ros.measurements.samples import Frames, GyroSamples

_BEFORE_NS = 10**8      # of gyro before the first frame of a part


class MessageBatch(NamedTuple):
    """Messages that were recorded at about the same time.

    Attributes
    ----------
    gyro, frames
        Each in the order of its recording.
    done : float
        How much of the run has been given with these, 0 to 1.
    """

    gyro: GyroSamples
    frames: Frames
    done: float


class MessageSource(Protocol):
    """The messages of a run."""

    def batches(self) -> Iterator[MessageBatch]:
        """Give all messages in the order of their recording; each call begins again."""


@dataclass(frozen=True)
class InMemory:
    """Messages that are there already: one batch.

    Attributes
    ----------
    gyro, frames
        In the order of their recording.
    """

    gyro: GyroSamples
    frames: Frames

    def batches(self) -> Iterator[MessageBatch]:
        """Give all messages."""
        yield MessageBatch(self.gyro, self.frames, 1.0)


class Extent(NamedTuple):
    """What a run has of frames: how many, and the stamps of the first and the last [ns]."""

    frames: int
    first_ns: int
    last_ns: int


def extent(source: MessageSource) -> Extent:
    """Return the extent of a run, in a pass over it."""
    count, first_ns, last_ns = 0, 0, 0
    for _, frames, _ in source.batches():
        if len(frames):
            first_ns = int(frames.stamp_ns[0]) if not count else first_ns
            last_ns = int(frames.stamp_ns[-1])
            count += len(frames)
    return Extent(count, first_ns, last_ns)


def beginning(source: MessageSource, seconds: float) -> InMemory:
    """Return the messages of the first seconds of frames."""
    gyro, frames = [], []
    until_ns: int | None = None
    for some_gyro, some_frames, _ in source.batches():
        gyro.append(some_gyro)
        if len(some_frames) and until_ns is None:
            until_ns = int(some_frames.stamp_ns[0]) + round(seconds * 1e9)
        frames.append(some_frames if until_ns is None else
                      some_frames.take(some_frames.stamp_ns < until_ns))
        if until_ns is not None and len(some_frames) and len(some_gyro) and min(
                int(some_frames.stamp_ns.min()), int(some_gyro.stamp_ns.min())) > until_ns:
            break
    readings = GyroSamples.concatenate(gyro)
    if until_ns is not None:
        readings = readings.take(readings.stamp_ns <= until_ns)
    return InMemory(readings, Frames.concatenate(frames))


def about(source: MessageSource, run: Extent, seconds: float, at_ns: int) -> InMemory:
    """Return the messages of some seconds about a stamp, as far as the run goes."""
    length = round(seconds * 1e9)
    begin = max(run.first_ns, min(at_ns - length // 2, run.last_ns - length))
    gyro, frames = [], []
    for some_gyro, some_frames, _ in source.batches():
        gyro.append(some_gyro.take(np.asarray((some_gyro.stamp_ns >= begin - _BEFORE_NS)
                                              & (some_gyro.stamp_ns <= begin + length))))
        frames.append(some_frames.take(np.asarray((some_frames.stamp_ns >= begin)
                                                  & (some_frames.stamp_ns <= begin + length))))
    return InMemory(GyroSamples.concatenate(gyro), Frames.concatenate(frames))
