# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parts of a recording that stand for all of it, at a cost that does not grow with its length.

A recording of more than `EXCERPT_S` is looked at in `PARTS` parts. Half of them are evenly spread,
the first at its beginning and the last at its end. The others are where the gyros' readings change
most, by samples of a second all over the recording: an instrument that seldom turns shows its axes
there alone.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.measurements.message_source import InMemory
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.recording.bag import Span
from starcal_ros.recording.recording_stream import RecordingStream

EXCERPT_S = 2400.0
"""What is looked at in all [s]."""

PARTS = 12
"""In how many parts."""

_SAMPLES = 300          # times, at which it is looked for motion
_SAMPLE_NS = 10**9


def excerpt(stream: RecordingStream) -> InMemory:
    """Return the messages of a recording, or those of some parts of a long one."""
    spans = [span for topic in (stream.gyro_topic, stream.frames_topic)
             if topic and (span := stream.span(topic))]
    if not spans:
        return InMemory(GyroSamples.empty(), Frames.empty())
    whole = Span(min(span.first_ns for span in spans), max(span.last_ns for span in spans))
    return _read(stream, parts(stream, whole))


def parts(stream: RecordingStream, whole: Span) -> list[Span] | None:
    """Return what is looked at of a recording, in its order; None for all of it."""
    part_ns = round(EXCERPT_S * 1e9 / PARTS)
    count = (whole.last_ns - whole.first_ns) // part_ns
    if count <= PARTS:
        return None
    begin_ns = whole.first_ns + np.linspace(
        0, whole.last_ns - whole.first_ns - part_ns, count).astype(np.int64)
    even = np.linspace(0, count - 1, PARTS // 2).round().astype(np.int64)
    motion = _motion(stream, whole, begin_ns)
    motion[even] = -1.0
    moving = np.argsort(-motion, kind='stable')[:PARTS - len(even)]
    return [Span(begin, begin + part_ns)
            for begin in begin_ns[np.sort(np.concatenate((even, moving)))].tolist()]


def _motion(stream: RecordingStream, whole: Span, begin_ns: Ints) -> Array:
    """Return how much the readings change in each part, of samples that are read."""
    at = np.linspace(whole.first_ns, whole.last_ns - _SAMPLE_NS, _SAMPLES).astype(np.int64)
    largest = np.full((len(begin_ns), 3), -np.inf)
    least = np.full((len(begin_ns), 3), np.inf)
    for log_time, gyro in stream.readings([Span(begin, begin + _SAMPLE_NS)
                                           for begin in at.tolist()]):
        part = np.searchsorted(begin_ns, log_time, side='right') - 1
        good = np.isfinite(gyro.rate).all(axis=-1) & (part >= 0)
        np.maximum.at(largest, part[good], gyro.rate[good])
        np.minimum.at(least, part[good], gyro.rate[good])
    return np.maximum(largest - least, 0.0).sum(axis=-1)


def _read(stream: RecordingStream, within: list[Span] | None) -> InMemory:
    gyro, frames = [], []
    for batch in stream.batches(within):
        gyro.append(batch.gyro)
        frames.append(batch.frames)
    return InMemory(GyroSamples.concatenate(gyro), Frames.concatenate(frames))
