# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The frame_id of the first message of a topic, as its publisher has set it."""

from __future__ import annotations

from pathlib import Path

from starcal_ros.messages.cdr import frame_id
from starcal_ros.recording.bag import open_bag


def first_frame_id(path: str | Path, topic: str) -> str | None:
    """Return the frame_id in the header of the first message of a topic; None without one.

    Raises
    ------
    RecordError
        If the path holds no recording, or is damaged.
    """
    for _, _, messages, _ in open_bag(Path(path)).messages([topic]):
        begin, size = int(messages.start[0]), int(messages.size[0])
        return frame_id(messages.data[begin:begin + size].tobytes())
    return None
