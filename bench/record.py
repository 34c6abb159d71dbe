# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time writing and reading of a two-hour recording: python bench/record.py.

720,000 gyro samples and 14,400 frames of 25 stars, against the message iterator of the `mcap`
library, which only hands out the bytes of each message.
"""

from __future__ import annotations

from pathlib import Path
import sys
import tempfile
from time import perf_counter

from mcap.reader import make_reader
import numpy as np

from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC, read, summary
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch

HOURS, GYRO_HZ, FRAME_HZ, STARS = 2, 100, 2, 25
START_NS = 1_782_993_600_000_000_000


def recording(rng: np.random.Generator) -> tuple[GyroSamples, Frames]:
    """Make samples and frames full of noise, which does not compress."""
    n, k = HOURS * 3600 * GYRO_HZ, HOURS * 3600 * FRAME_HZ
    gyro = GyroSamples(START_NS + np.arange(1, n + 1) * (10**9 // GYRO_HZ),
                       rng.normal(scale=1e-3, size=(n, 3)))
    stars = k * STARS
    frames = Frames(START_NS + np.arange(1, k + 1) * (10**9 // FRAME_HZ),
                    np.arange(k + 1) * STARS, rng.uniform(0, 2048, (stars, 2)),
                    np.full(stars, 0.03), rng.uniform(2, 6.5, stars),
                    rng.integers(1, 118218, stars))
    return gyro, frames


def main() -> int:
    """Print the times."""
    gyro, frames = recording(np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'run.mcap')
        began = perf_counter()
        with Writer(path) as writer:
            writer.write_batches(imu_batch(GYRO_TOPIC, gyro),
                                 centroids_batch(FRAMES_TOPIC, frames))
        written = perf_counter()
        summary(path)
        summed = perf_counter()
        read(path)
        done = perf_counter()
        with path.open('rb') as stream:
            count = sum(1 for _ in make_reader(stream).iter_messages())
        iterated = perf_counter()
        print(f'{count} messages, {path.stat().st_size / 1e6:.1f} MB')
        print(f'write    {written - began:6.2f} s')
        print(f'summary  {summed - written:6.2f} s')
        print(f'read     {done - summed:6.2f} s')
        ratio = (iterated - done) / (done - summed)
        print(f'mcap     {iterated - done:6.2f} s, {ratio:.1f} times as long')
    return 0


if __name__ == '__main__':
    sys.exit(main())
