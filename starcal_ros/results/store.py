# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Saved calibrations: numbered folders that are there whole or not at all.

::

    calibrations/
        0001/   0002/   0003.undone/    a folder a calibration; the number is never used again
        latest -> 0002                  the newest that was not undone

A folder is written under another name, flushed to the disk and then renamed: a process that is
killed, or a machine that loses its power, leaves the ones before untouched.
"""

from __future__ import annotations

from collections.abc import Mapping
import errno
import os
from pathlib import Path
import re
import tempfile

LATEST = 'latest'
_UNDONE = '.undone'
_TAKEN = (errno.EEXIST, errno.ENOTEMPTY)


class StoreError(OSError):
    """A calibration can not be saved or undone; the message says why."""


class CalibrationStore:
    """The calibrations in one directory.

    Parameters
    ----------
    directory : Path
        Made when something is saved.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def folders(self) -> list[Path]:
        """Return the calibrations that were not undone, the newest first."""
        return [self._folder(number) for number in sorted(self._numbers(r'(\d{4,})'),
                                                          reverse=True)]

    def save(self, files: Mapping[str, str]) -> Path:
        """Save files, by name and text, in a new folder, and return it.

        Raises
        ------
        StoreError
            Where they can not be written.
        """
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            draft = Path(tempfile.mkdtemp(prefix='.', dir=self.directory))
            draft.chmod(0o755)
            for name, text in files.items():
                with open(draft / name, 'x', encoding='utf-8') as stream:
                    stream.write(text)
                    stream.flush()
                    os.fsync(stream.fileno())
            _flush(draft)
            folder = self._number(draft)
            self._point_at_latest()
        except OSError as error:
            raise StoreError(f'{self.directory}: cannot be written: {error.strerror}') from None
        return folder

    def undo(self) -> Path:
        """Set the newest calibration aside and return its folder under its new name.

        Raises
        ------
        StoreError
            Where there is none, or it can not be renamed.
        """
        folders = self.folders()
        if not folders:
            raise StoreError(f'{self.directory}: no saved calibration')
        aside = folders[0].with_name(folders[0].name + _UNDONE)
        try:
            folders[0].rename(aside)
            self._point_at_latest()
        except OSError as error:
            raise StoreError(f'{folders[0]}: cannot be undone: {error.strerror}') from None
        return aside

    def _folder(self, number: int) -> Path:
        return self.directory / f'{number:04d}'

    def _numbers(self, pattern: str) -> list[int]:
        try:
            names = [path.name for path in self.directory.iterdir()]
        except OSError:
            return []
        return [int(match[1]) for name in names if (match := re.fullmatch(pattern, name))]

    def _number(self, draft: Path) -> Path:
        """Give a draft the next number; another process may be about to take the same one."""
        while True:
            used = self._numbers(rf'(\d{{4,}})(?:{re.escape(_UNDONE)})?')
            folder = self._folder(max(used, default=0) + 1)
            try:
                draft.rename(folder)
            except OSError as error:
                if error.errno not in _TAKEN:
                    raise
            else:
                return folder

    def _point_at_latest(self) -> None:
        link, folders = self.directory / LATEST, self.folders()
        if folders:
            draft = self.directory / f'.{LATEST}.{os.getpid()}'
            draft.unlink(missing_ok=True)
            draft.symlink_to(folders[0].name)
            draft.replace(link)
        else:
            link.unlink(missing_ok=True)
        _flush(self.directory)


def _flush(directory: Path) -> None:
    """Bring to the disk which files a directory holds."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
