# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The frame_id of the first message of a topic, as its publisher has set it."""

from __future__ import annotations

from pathlib import Path

from starcal_ros.messages.cdr import ENCAPSULATION, HEADER, by_byte_order, gather
from starcal_ros.recording.bag import open_bag


def first_frame_id(path: str | Path, topic: str) -> str | None:
    """Return the frame_id in the header of the first message of a topic; None without one.

    Raises
    ------
    RecordError
        If the path holds no recording, or the message is not plain CDR.
    """
    for _, _, messages, _ in open_bag(Path(path)).messages([topic]):
        for rows, order in by_byte_order(messages):
            if rows[0]:
                continue
            begin = int(messages.start[0]) + ENCAPSULATION
            header = gather(messages.data, messages.start[:1] + ENCAPSULATION,
                            HEADER.newbyteorder(order))
            begin += HEADER.itemsize
            text = messages.data[begin:begin + int(header['frame_id_length'][0])]
            return text.tobytes().rstrip(b'\0').decode(errors='replace')
    return None
