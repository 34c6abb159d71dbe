# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which files a recording has, and of what kind, whatever became of its metadata.

rosbag2 writes metadata.yaml when a recording ends: after a power cut there is none, and after a
reindex it may lack the storage. The files themselves tell both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path, PurePath
import re
import shlex
import tempfile
from typing import Any

import zstandard

from starcal_ros.files.foreign import clean
from starcal_ros.messages.cdr import RecordError

MCAP, SQLITE = 'mcap', 'sqlite3'
METADATA = 'metadata.yaml'
CONVERT = 'rosbags-convert --src {} --dst {}'

_HEAD = 16          # bytes
_SUFFIXES = {'.mcap': MCAP, '.db3': SQLITE}
_PACKED = '.zstd'
_MODES = ('', 'none', 'storage', 'file', 'message')
_MAGIC = {
    b'\x28\xb5\x2f\xfd': ('zstd', 'zstd -d'), b'\x04\x22\x4d\x18': ('lz4', 'lz4 -d'),
    b'\x1f\x8b': ('gzip', 'gunzip -k'), b'BZh': ('bzip2', 'bunzip2 -k'),
    b'\xfd7zXZ\0': ('xz', 'unxz -k'), b'PK\x03\x04': ('zip', 'unzip')}
"""What a file begins with that is compressed as a whole, and what unpacks it."""


@dataclass(frozen=True)
class BagFiles:
    """The files of a recording.

    Attributes
    ----------
    files : list of Path
        As they lie there, in the order of recording.
    parts : list of Path
        What to read: the same, or what they were unpacked to.
    storage : str
        MCAP or SQLITE.
    by_message : bool
        Whether messages are compressed one by one.
    warnings : tuple of str
        What a user should know.
    scratch : object
        Keeps what was unpacked for as long as it lives.
    """

    files: list[Path]
    parts: list[Path]
    storage: str
    by_message: bool = False
    warnings: tuple[str, ...] = ()
    scratch: object = None


def find(path: Path) -> BagFiles:
    """Find the files of a recording.

    Raises
    ------
    RecordError
        If there is nothing at the path, or nothing that can be read as a recording.
    """
    if path.is_dir():
        return _unpacked(_of_folder(path))
    if not os.path.exists(path):
        raise RecordError(f'{path} does not exist; a recording is one .mcap file or a rosbag2 '
                          'directory')
    if not path.is_file():
        raise RecordError(f'{path} is no file; a recording is one .mcap file or a rosbag2 '
                          'directory')
    _refuse_others(path)
    return BagFiles([path], [path], SQLITE if path.suffix == '.db3' else MCAP)


def _of_folder(path: Path) -> BagFiles:
    from starcal_ros.files.documents import load_yaml
    metadata = path / METADATA
    try:
        text = metadata.read_text() if metadata.exists() else ''
        if not text.strip('\0 \r\n'):        # a power cut may leave zeros
            return _without_metadata(path)
        info = load_yaml(text)['rosbag2_bagfile_information']
        files = [path / PurePath(name).name for name in info['relative_file_paths']]
        storage = str(info['storage_identifier'] or '')
        mode = str(info.get('compression_mode') or '').lower()
    except RecordError:
        raise
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise RecordError(f'{metadata} cannot be read as the metadata of a rosbag2 directory: '
                          f'{type(error).__name__} {" ".join(str(error).split())}') from error
    missing = [file.name for file in files if not os.path.exists(file)]   # a name may be too long
    if missing or not files:
        raise RecordError(f'{metadata} names files that are missing: {", ".join(missing)}'
                          if files else f'{metadata} names no files')
    if not storage:
        storage = _storage(files, path)
    if storage not in _SUFFIXES.values() or mode not in _MODES:
        raise RecordError(f'{path} cannot be read: storage {storage!r} with compression {mode!r}; '
                          'mcap and sqlite3 are read, compressed by storage, file or message')
    return BagFiles(files, files, storage, mode == 'message')


def _without_metadata(path: Path) -> BagFiles:
    """Take the files of a folder for those of one recording, where their names say so."""
    files = [file for file in path.iterdir() if file.is_file() and _kind(file)]
    empty = sorted(file.name for file in files if _is_empty(file))
    files = [file for file in files if file.name not in empty]
    names = ', '.join(sorted(file.name for file in files))
    if not files:
        for file in path.iterdir():
            if file.is_file() and file.suffix == '.bag':
                _refuse_others(file)
        raise RecordError(f'{path} has no metadata.yaml, so it is no rosbag2 directory; a '
                          'recording is one .mcap file or a rosbag2 directory')
    numbered = [re.fullmatch(r'(.*?)(?:_(\d+))?', _stem(file)) for file in files]
    bases = {(match[1], _kind(file)) for match, file in zip(numbered, files) if match}
    order = [int(match[2] or -1) if match else -1 for match in numbered]
    if len(bases) > 1 or len(set(order)) < len(order):
        raise RecordError(f'{path} has no metadata.yaml, and its files are not those of one '
                          f'recording by their names; they can be read one by one: {names}')
    files = [file for _, file in sorted(zip(order, files))]
    return BagFiles(files, files, _storage(files, path), warnings=(clean(
        f'{path.name} has no metadata.yaml: its files are read in the order of their numbers: '
        f'{", ".join(file.name for file in files)}; starcal recover {shlex.quote(str(path))} '
        'writes one'), *(clean(f'{name} is empty, as after a power cut') for name in empty)))


def _is_empty(file: Path) -> bool:
    """Tell whether nothing of a file came to the disk: no byte, or zeros."""
    with file.open('rb') as stream:
        return not stream.read(_HEAD).strip(b'\0')


def _storage(files: Sequence[Path], path: Path) -> str:
    kinds = {_kind(file) for file in files}
    if len(kinds) > 1 or None in kinds:
        raise RecordError(f'{path} does not say its storage, and its files are not all .mcap or '
                          'all .db3')
    return str(kinds.pop())


def _kind(file: Path) -> str | None:
    return _SUFFIXES.get(Path(file.name.removesuffix(_PACKED)).suffix)


def _stem(file: Path) -> str:
    return Path(file.name.removesuffix(_PACKED)).stem


def _unpacked(bag: BagFiles) -> BagFiles:
    """Unpack files that are compressed as a whole, into the folder for temporary files."""
    if not any(file.suffix == _PACKED for file in bag.files):
        return bag
    scratch = tempfile.TemporaryDirectory(prefix='starcal_')
    parts = []
    for file in bag.files:
        part = Path(scratch.name, file.name.removesuffix(_PACKED))
        try:
            with file.open('rb') as packed, part.open('wb') as raw:
                zstandard.ZstdDecompressor().copy_stream(packed, raw)
        except (OSError, zstandard.ZstdError) as error:
            raise RecordError(f'{file} cannot be unpacked: {error}') from None
        parts.append(part)
    return replace(bag, parts=parts, scratch=scratch)


def _refuse_others(path: Path) -> None:
    """Name what is known, but is no recording of ROS 2, with what makes one of it."""
    try:
        with path.open('rb') as stream:
            start = stream.read(9)
    except OSError as error:
        raise RecordError(f'{path} cannot be read: {error.strerror}') from None
    word = shlex.quote(str(path))
    if start == b'#ROSBAG V':
        convert = CONVERT.format(word, shlex.quote(str(path.with_suffix(''))))
        raise RecordError(f'{path} is a bag of ROS 1, which is not read; convert it: {convert}')
    for magic, (name, command) in _MAGIC.items():
        if start.startswith(magic):
            raise RecordError(f'{path} is compressed as a whole ({name}); unpack it: '
                              f'{command} {word}')


def refuse_ros1(topics: Sequence[Any], path: Path) -> None:
    """Name a recording whose messages are those of ROS 1.

    Raises
    ------
    RecordError
        Where no topic has messages of ROS 2 and some have those of ROS 1.
    """
    encodings = {topic.encoding for topic in topics}
    if 'ros1' in encodings and 'cdr' not in encodings:
        raise RecordError(f'{path} is an MCAP file with messages of ROS 1, which are not read; '
                          'convert the bag that it was made from: '
                          + CONVERT.format('RUN.bag', 'RUN'))
