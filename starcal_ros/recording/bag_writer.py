# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recording while it is made: one file, or a directory of files that are split as rosbag2 does.

It looks after its place on the disk: a file that has been removed, a disk that is full or soon
will be. What is on the disk can be read, whatever happens.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
import os
from pathlib import Path
import time

import numpy as np

from starcal_ros.files.output import OutputError, write_text
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording import bag_metadata, losses
from starcal_ros.recording.bag_files import METADATA
from starcal_ros.recording.bag_metadata import Offer, Part
from starcal_ros.recording.losses import Loss
from starcal_ros.recording.writer import Batch, Writer

RESERVE_BYTES = 1 << 20         # with less on the disk it ends, and the summary has its place
_INDEX_BYTES = 600              # of a chunk, in the summary
# What is written together ends a chunk in any case. Its topics may be minutes apart, where nodes
# run faster than real time: a chunk for each second of each would be many, and so their index.
_CHUNK_S = 3600
_LOW_S, _LOW_BYTES = 600.0, 100 << 20
_SUFFIX = '.mcap'


class BagWriter:
    """Write a recording.

    Parameters
    ----------
    path : Path
        The file; where it is split, the directory, whose name does not end in ``.mcap``.
    max_bytes : int
        Begin another file when one has that length; 0 is never.
    max_ns : int
        Begin another file after so much log time; 0 is never.

    Attributes
    ----------
    path : Path
        Of the recording.
    losses : dict of Loss
        What topics lack, by name, to be set from outside; written with the messages.

    Raises
    ------
    RecordError
        If something exists there, or can not be made.
    """

    def __init__(self, path: Path, max_bytes: int = 0, max_ns: int = 0) -> None:
        self._max_bytes, self._max_ns = max_bytes, max_ns
        self._is_split = bool(max_bytes or max_ns)
        self.path = path.with_suffix('') if self._is_split and path.suffix == _SUFFIX else path
        self._parts: list[Part] = []
        self._counts: Counter[Offer] = Counter()
        self._attached: list[tuple[str, bytes, str]] = []
        self._start_ns: int | None = None           # of this file
        self.losses: dict[str, Loss] = {}
        self._before: dict[str, Loss] = {}          # in earlier files
        self._noted: dict[str, str] = {}
        self._told_low = False
        self._began = time.monotonic()
        self._n_bytes = 0
        if self._is_split:
            try:
                self.path.mkdir(parents=True)
            except FileExistsError:
                raise RecordError(f'{self.path} exists; choose another name') from None
            except OSError as error:
                raise RecordError(f'{self.path} cannot be made: {error.strerror}') from None
        self._writer = self._next()

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Attach a file, in each file of the recording."""
        self._attached.append((name, data, media_type))
        with self._in_words():
            self._writer.attach(name, data, media_type)

    def write(self, batches: Sequence[Batch]) -> None:
        """Write the messages of some topics together, so that they are in the file.

        Raises
        ------
        RecordError
            Where that fails; the recording ends there.
        """
        with self._in_words():
            self._look_after()
            while batches := [batch for batch in batches if len(batch.log_time_ns)]:
                low = min(int(np.min(batch.log_time_ns)) for batch in batches)
                if self._is_full(low):
                    self._end_part()
                    self._writer = self._next()
                if self._start_ns is None:
                    self._start_ns = low
                now, batches = self._divide(batches)
                self._writer.write_batches(*now)
                self._writer.flush()
            self._note_losses()

    def low(self) -> str:
        """Return what to say of a disk that is filling up, once; '' otherwise."""
        free = self._free()
        passed_s = max(time.monotonic() - self._began, 1.0)
        per_s = (self._n_bytes + self._writer.n_bytes) / passed_s
        if self._told_low or free > _LOW_BYTES and free > per_s * _LOW_S:
            return ''
        self._told_low = True
        return (f'{self.path.absolute().parent} has {free / 1e6:.1f} MB left, at '
                f'{per_s / 1e6:.3f} MB a second enough for '
                f'{free / max(per_s, 1.0) / 60.0:.1f} minutes')

    def close(self) -> None:
        """Finish what is there.

        Raises
        ------
        RecordError
            Where that fails; all that was written before can be read.
        """
        with self._in_words():
            self._look_after(0)
            self._note_losses()
            self._end_part()
            if self._is_split:
                write_text(self.path / METADATA, bag_metadata.dump_file(bag_metadata.information(
                    self._parts, self._counts, self._custom(self.losses))))

    def _is_full(self, low_ns: int) -> bool:
        if self._start_ns is None:
            return False
        return (0 < self._max_bytes <= self._writer.n_bytes
                or 0 < self._max_ns <= low_ns - self._start_ns)

    def _divide(self, batches: Sequence[Batch]) -> tuple[list[Batch], list[Batch]]:
        """Return what belongs into this file by its log times, and the rest."""
        if not self._max_ns or self._start_ns is None:
            return [*batches], []
        end_ns, parts = self._start_ns + self._max_ns, []
        for inside in (True, False):
            which = [np.flatnonzero((batch.log_time_ns < end_ns) == inside) for batch in batches]
            parts.append([replace(
                batch, log_time_ns=batch.log_time_ns[rows],
                messages=batch.messages[rows] if isinstance(batch.messages, np.ndarray)
                else [batch.messages[row] for row in rows.tolist()])
                for batch, rows in zip(batches, which)])
        return parts[0], parts[1]

    def _next(self) -> Writer:
        """Begin a file."""
        self._start_ns, self._noted = None, {}
        self._before = dict(self.losses)
        name = f'{self.path.name}_{len(self._parts)}{_SUFFIX}'
        writer = Writer(self.path / name if self._is_split else self.path, chunk_s=_CHUNK_S)
        for attached in self._attached:
            writer.attach(*attached)
        return writer

    def _end_part(self) -> None:
        self._writer.custom = self._custom(self._since())
        self._writer.close()
        self._parts.append(self._writer.part)
        self._counts.update(self._writer.offers)
        self._n_bytes += self._writer.n_bytes

    def _since(self) -> dict[str, Loss]:
        """Return what topics lack in this file."""
        return {topic: loss.since(self._before.get(topic, Loss()))
                for topic, loss in self.losses.items()}

    def _note_losses(self) -> None:
        """Write what has come to be lacking: a recorder may be killed."""
        noted = losses.dump(self._since())
        if noted != self._noted:
            self._writer.note(losses.LOSSES, noted)
            self._noted = noted

    @staticmethod
    def _custom(lacking: Mapping[str, Loss]) -> dict[str, str]:
        noted = losses.dump(dict(lacking))
        return {f'{losses.LOSSES}:{topic}': text for topic, text in noted.items()}

    def _look_after(self, reserve: int = RESERVE_BYTES) -> None:
        """Raise RecordError where the file is gone, or the disk has no room for its end."""
        if self._writer.is_removed:
            raise RecordError(f'{self._writer.path} was removed while it was written: what had '
                              'been recorded to it is lost')
        needed = reserve and reserve + _INDEX_BYTES * self._writer.n_chunks
        if self._free() < needed:
            raise RecordError(f'the disk of {self.path} is full: {self._free() / 1e6:.1f} MB are '
                              'left, the recording ends here')

    def _free(self) -> int:
        space = os.fstatvfs(self._writer.fileno())
        return space.f_bavail * space.f_frsize

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        """Turn what the system says into a RecordError."""
        try:
            yield
        except OSError as error:
            raise RecordError(f'{self.path} cannot be written any further: {error.strerror}; what '
                              'is in it can be read, starcal recover finishes it') from None
        except OutputError as error:
            raise RecordError(str(error)) from None

    def give_up(self) -> None:
        """Finish the file as far as that is possible, after an error."""
        with suppress(RecordError):
            self.close()
