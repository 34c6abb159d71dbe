# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results that are there whole or not at all.

A result is written beside its place under another name, brought to the disk and renamed. A full
disk, a killed process or a lost power leaves what was there before, or nothing. What is no file of
its own, such as /dev/stdout or a pipe, is written straight.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import errno
import os
from pathlib import Path
import secrets
import shutil

_DESCRIPTORS = ('/dev/fd/', '/dev/stdout', '/dev/stderr', '/proc/')
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)


class OutputError(ValueError):
    """A file can not be written; one line that says which and why."""


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Tell whether a path is no file of its own: a device, a pipe, a descriptor."""
    path = Path(path)
    return (os.path.abspath(path).startswith(_DESCRIPTORS)
            or path.exists() and not path.is_file() and not path.is_dir())


def same(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Tell whether two paths are one file, by any name or link."""
    try:
        return os.path.samefile(one, other)
    except OSError:
        return os.path.realpath(one) == os.path.realpath(other)


def draft_beside(path: str | os.PathLike[str]) -> Path:
    """Return a name for a draft of a file, in the same folder."""
    return Path(os.path.realpath(path)).parent / f'.{secrets.token_hex(6)}.part'


@contextmanager
def whole(path: str | os.PathLike[str], replace: bool = True) -> Iterator[Path]:
    """Yield the path of a draft, which takes the place of a file when all went well.

    Parameters
    ----------
    path : path
        Of the file; a link is followed.
    replace : bool
        Take the place of a file that exists.

    Raises
    ------
    OutputError
        Where it can not be written, or exists and is not to be replaced.
    """
    try:
        if is_stream(path):
            yield Path(path)
            return
        target, draft = Path(os.path.realpath(path)), draft_beside(path)
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        try:
            yield draft
            _flush(draft)
            _give_place(draft, target, replace)
            _flush(target.parent)
        finally:
            draft.unlink(missing_ok=True)
    except FileExistsError:
        raise OutputError(f'{path} exists; choose another name or overwrite it') from None
    except OSError as error:
        raise OutputError(f'{path}: cannot be written: {error.strerror or error}') from None


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text, UTF-8, whole or not at all; OutputError where it can not be written."""
    with whole(path) as draft:
        draft.write_bytes(text.encode('utf-8', 'backslashreplace'))


def _give_place(draft: Path, target: Path, replace: bool) -> None:
    if replace:
        if target.exists():
            shutil.copymode(target, draft)
        draft.replace(target)
        return
    try:
        os.link(draft, target)          # unlike a renaming, fails where the target has come to be
    except FileExistsError:
        raise
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if target.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
        draft.replace(target)


def _flush(path: Path) -> None:
    """Bring a file, or which files a folder holds, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:     # of file systems that do not know it for folders
            raise
    finally:
        os.close(descriptor)
