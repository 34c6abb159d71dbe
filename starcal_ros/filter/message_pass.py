# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One pass of the calibrator over the messages of a run, batch by batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from starcal_ros.core.ahead import ahead
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.frame_result import FrameResults
from starcal_ros.measurements.message_source import MessageSource

_TOLD = 100             # frames between two words of progress


def run(calibrator: Calibrator, source: MessageSource,
        on_progress: Callable[[float], None] = lambda part: None) -> Iterator[FrameResults]:
    """Give the messages of a run to a calibrator, and what it makes of the frames.

    Parameters
    ----------
    calibrator : Calibrator
        Fresh.
    source : MessageSource
        The run.
    on_progress : callable
        Called now and then with the part done, 0 to 1.
    """
    before = 0.0
    for batch in ahead(source.batches()):
        calibrator.add_gyro(batch.gyro)
        calibrator.add_frames(batch.frames)
        n, share = max(calibrator.waiting, 1), batch.done - before
        done = 0
        for results in calibrator.stretches():
            yield results
            told, done = done // _TOLD, done + len(results)
            if done // _TOLD > told:
                on_progress(before + share * min(done // _TOLD * _TOLD / n, 1.0))
        before = batch.done
        on_progress(before)
