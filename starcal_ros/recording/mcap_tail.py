# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How far an MCAP file has come that somebody else is still writing."""

from __future__ import annotations

from pathlib import Path
import struct

from mcap.opcode import Opcode

from starcal_ros.recording.mcap_chunk import RECORD
from starcal_ros.recording.mcap_reader import MAGIC

_TIMES = struct.Struct('<QQ')       # of the first and the last message, at the head of a chunk


class McapTail:
    """Follows the chunks of a file, each of which is looked at once.

    Parameters
    ----------
    path : Path
        The file, which may be yet to come.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._position, self._newest_ns = len(MAGIC), 0

    def newest_ns(self) -> int:
        """Return the latest log time in the chunks that are complete; 0 while there is none."""
        if not self._path.is_file():
            return 0
        with self._path.open('rb') as stream:
            size = stream.seek(0, 2)
            while self._position + RECORD.size + _TIMES.size <= size:
                stream.seek(self._position)
                opcode, length = RECORD.unpack(stream.read(RECORD.size))
                if self._position + RECORD.size + length > size:
                    break
                if opcode == Opcode.CHUNK:
                    _, last_ns = _TIMES.unpack(stream.read(_TIMES.size))
                    self._newest_ns = max(self._newest_ns, last_ns)
                self._position += RECORD.size + length
        return self._newest_ns
