# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What viewers draw of a recording, as a recording beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import sys

from starcal_ros.files.output import whole
from starcal_ros.live.display import DRAWN
from starcal_ros.live.recorded import moments
from starcal_ros.messages.drawings import Drawings
from starcal_ros.recording.qos import LATCHED
from starcal_ros.recording.writer import TYPES, Writer, serialize


def draw(path: Path, out: Path, namespace: str | None = None, overwrite: bool = False,
         on_progress: Callable[[float], None] = lambda part: None) -> int:
    """Write the topics of `display.DRAWN` of a recording, and return of how many frames.

    They are those that the node `display` publishes, recorded when the states of their frames
    were: both recordings opened together are one.

    Parameters
    ----------
    path : Path
        A recording with the results of an estimator.
    out : Path
        The .mcap file to make.
    namespace : str, optional
        Of the estimator, where there are several.
    overwrite : bool
        Replace a file that exists.
    on_progress : callable, optional
        Called with the part done, 0 to 1.

    Raises
    ------
    RecordError, OutputError
        Where the recording can not be read or has no results, or the file can not be written.
    """
    drawings, frames = Drawings(TYPES), 0
    with whole(out, overwrite) as draft, Writer(draft, overwrite=True) as writer:
        for moment in moments(path, namespace, on_progress, most=sys.maxsize):
            frames += 1
            for topic, make in DRAWN.items():
                writer.write(moment.prefix + topic.recorded, topic.type_name,
                             serialize(topic.type_name, make(drawings, moment.seen)),
                             moment.log_ns, qos=LATCHED)
    return frames
