# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Finish a recording whose recorder was killed, or that was damaged since.

What our readers make of such a file other readers refuse: without its end it has no summary. A
file is written anew from every chunk that is whole, byte for byte; topics and types are declared
before them, since the chunk that did may be lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path
import shlex
import shutil

import numpy as np

from starcal_ros.files.output import OutputError, draft_beside, same, whole, write_text
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording import bag_metadata
from starcal_ros.recording.bag_files import MCAP, METADATA, find
from starcal_ros.recording.bag_metadata import Offer, Part
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.mcap_chunk import MESSAGE_HEAD, RECORD, Index, scan
from starcal_ros.recording.mcap_reader import RECOVERED, McapFile
from starcal_ros.recording.mcap_writer import McapWriter
from starcal_ros.recording.writer import library

ORIGINAL = '.orig'
"""What is appended to the name of a file that was recovered in its place."""


class OutputExists(OutputError):
    """Something is in the way that may not be replaced; one line."""


class RecoveryError(ValueError):
    """Nothing can be recovered of a recording; one line."""


@dataclass(frozen=True)
class Recovered:
    """What has become of one file.

    Attributes
    ----------
    name : str
    sound : bool
        Whether there was nothing to recover.
    chunks, messages : int
        Held by it now.
    lost_chunks, lost_messages, lost_bytes : int
        Left out: chunks that are damaged, messages in them as far as the index of the file counts
        them, and bytes that make no sense, an unfinished chunk at the end among them.
    """

    name: str
    sound: bool
    chunks: int
    messages: int
    lost_chunks: int = 0
    lost_messages: int = 0
    lost_bytes: int = 0

    @property
    def lost(self) -> str:
        """What was lost, in words; '' for nothing."""
        words = [f'{self.lost_chunks} damaged chunks' if self.lost_chunks else '',
                 f'{self.lost_messages} messages in them' if self.lost_messages else '',
                 f'{self.lost_bytes} bytes that are no whole chunk' if self.lost_bytes else '']
        return ', '.join(filter(None, words))


def recover(path: Path, out: Path | None = None, overwrite: bool = False
            ) -> tuple[Recovered, ...]:
    """Finish a recording.

    Parameters
    ----------
    path : Path
        One .mcap file or a rosbag2 directory.
    out : Path, optional
        What to make; without it files are replaced, and what they were is kept under their names
        and ``.orig``. Sound files stay as they are.
    overwrite : bool
        Replace what is in the way.

    Returns
    -------
    files : tuple of Recovered

    Raises
    ------
    RecordError
        If there is no recording at the path, or one that is not of MCAP.
    RecoveryError
        If no message of it can be recovered.
    OutputExists
        If something is in the way.
    OutputError
        If something can not be written.
    """
    found = find(path)
    if found.storage != MCAP:
        raise RecordError(f'{path} is sqlite3, which mends itself when it is opened; for its '
                          f'metadata.yaml: ros2 bag reindex {shlex.quote(str(path))}')
    if found.parts != found.files:
        raise RecordError(f'{path}: files that are compressed as a whole are not recovered; '
                          f'unpack them: zstd -d {shlex.join(map(str, found.files))}')
    if not path.is_dir():
        return (_one(path, out, overwrite),)
    if out is not None:
        return _folder(found.files, out, overwrite)
    results = tuple(_one(file, None, overwrite) for file in found.files)
    if found.warnings or not all(each.sound for each in results):
        write_text(path / METADATA, _metadata(found.files))
    return results


def _folder(files: Sequence[Path], out: Path, overwrite: bool) -> tuple[Recovered, ...]:
    """Write a directory, whole or not at all."""
    if out.exists() and not (overwrite and _is_other_recording(out, files)):
        raise OutputExists(f'{out} exists; choose another name' + (
            ', it is read or no recording alone' if overwrite else ' or overwrite it'))
    draft = draft_beside(out)
    try:
        draft.mkdir()
        results = tuple(_one(file, draft / file.name, False) for file in files)
        write_text(draft / METADATA, _metadata([draft / file.name for file in files]))
        if out.exists():
            shutil.rmtree(out)
        draft.replace(out)
    except OSError as error:
        raise OutputError(f'{out}: cannot be written: {error.strerror or error}') from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return results


def _is_other_recording(out: Path, files: Sequence[Path]) -> bool:
    """Tell whether a directory holds files of a recording, none of those given, and no more."""
    return out.is_dir() and all(
        each.is_file() and (each.suffix == '.mcap' or each.name == METADATA)
        and not any(same(each, file) for file in files) for each in out.iterdir())


def _one(path: Path, out: Path | None, overwrite: bool) -> Recovered:
    """Finish one MCAP file, in its place or elsewhere."""
    source = McapFile(path)
    if source.finished and not (found := check_file(path)).faults:
        if out is not None:
            with whole(out, overwrite) as draft:
                shutil.copyfile(path, draft)
        return Recovered(path.name, True, found.chunks, found.messages)
    original = path.with_name(path.name + ORIGINAL)
    if out is None and original.exists() and not overwrite:
        raise OutputExists(f'{original} exists, and would be replaced by what {path.name} is now; '
                           'move it away or overwrite it')
    with whole(out or path, overwrite or out is None) as draft:
        result = _write(source, draft, (out or path).name)
        if not result.messages:
            raise RecoveryError(f'{path}: no message can be recovered')
        if out is None:
            original.unlink(missing_ok=True)
            try:
                os.link(path, original)
            except OSError:             # a file system without links
                shutil.copy2(path, original)
    return result


def _write(source: McapFile, target: Path, name: str) -> Recovered:
    """Write what is whole of a file that will have a name."""
    channels = [channel if channel.schema_id in source.schemas else replace(channel, schema_id=0)
                for channel in source.channels.values()]
    lost_chunks = lost_messages = 0
    with target.open('wb', buffering=0) as stream:
        writer = McapWriter(stream, source.header.profile if source.header else 'ros2', library())
        writer.declare(source.schemas.values(), channels)
        for attachment in source.attached:
            writer.add_attachment(attachment.name, attachment.media_type, attachment.data,
                                  attachment.log_time)
        for chunk in source.chunks:
            try:
                raw = chunk.decompress()
            except RecordError:
                lost_chunks += 1
                lost_messages += sum(map(len, chunk.index.values()))
                continue
            index, _ = scan(raw)
            strange = index.keys() - source.channels.keys()
            lost_messages += sum(len(index[channel]) for channel in strange)
            if chunk.offset and not strange:
                writer.add_chunk(raw, chunk.packed, chunk.compression, index)
            else:               # messages outside of chunks, or of topics that nobody declares
                _add_messages(writer, raw, {channel: entries for channel, entries in index.items()
                                            if channel not in strange})
        writer.finish_chunk()
        result = Recovered(source.path.name, False, writer.n_chunks, writer.counts.total(),
                           lost_chunks, lost_messages, source.lost_bytes)
        for record, values in source.metadata.items():
            if record not in (bag_metadata.RECORD, RECOVERED):
                writer.add_metadata(record, values)
        if result.lost:
            writer.add_metadata(RECOVERED, {'lost': result.lost})
        told = bag_metadata.information(
            [Part(name, writer.span_ns, result.messages)],
            _counts(source, writer.counts), {}, _distribution(source))
        writer.add_metadata(bag_metadata.RECORD, {bag_metadata.KEY: bag_metadata.dump(told)})
        writer.finish()
    return result


def _add_messages(writer: McapWriter, raw: bytes | memoryview, index: Index) -> None:
    """Write messages one by one, in the order of the file."""
    for place, channel in sorted((place, channel) for channel, entries in index.items()
                                 for place in entries[:, 1].tolist()):
        head, = np.frombuffer(raw, MESSAGE_HEAD, 1, place)
        start, end = place + MESSAGE_HEAD.itemsize, place + RECORD.size + int(head['length'])
        writer.add_message(channel, int(head['log_time']), int(head['publish_time']),
                           raw[start:end])


def _metadata(files: Sequence[Path]) -> str:
    """Return the text of the metadata.yaml of files."""
    parts: list[Part] = []
    counts: Counter[Offer] = Counter()
    distribution = ''
    for file in files:
        source = McapFile(file)
        distribution = distribution or _distribution(source)
        times = {channel: source.log_times(channel) for channel in source.channels}
        counts.update(_counts(source, {channel: len(own) for channel, own in times.items()}))
        every = np.concatenate([np.empty(0, np.int64), *times.values()])
        span = (int(every.min()), int(every.max())) if every.size else None
        parts.append(Part(file.name, span, every.size))
    return bag_metadata.dump_file(bag_metadata.information(parts, counts, {}, distribution))


def _counts(source: McapFile, counts: Mapping[int, int]) -> Counter[Offer]:
    """Return the number of messages of each topic, of those by the ids of a file."""
    found: Counter[Offer] = Counter()
    for channel in source.channels.values():
        schema = source.schemas.get(channel.schema_id)
        found[Offer(channel.topic, schema.name if schema else '', channel.message_encoding,
                    channel.metadata.get('offered_qos_profiles', ''),
                    channel.metadata.get('topic_type_hash', ''))] += counts.get(channel.id, 0)
    return found


def _distribution(source: McapFile) -> str:
    """Return the distribution of ROS of a file: rosbag2 writes it when it begins one."""
    return bag_metadata.distribution(source.metadata.get(bag_metadata.RECORD))
