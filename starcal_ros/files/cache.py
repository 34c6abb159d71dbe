# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that take seconds to make and follow from their name alone, kept from run to run.

They are in ``$XDG_CACHE_HOME/starcal_ros``, else ``~/.cache/starcal_ros``, each beside its
SHA-256: one that is damaged, or that two processes wrote at once, counts as none. `MOST` are kept,
the newest. Where there is no place to keep them nothing is kept, and nothing is said: whoever asks
makes it again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import hashlib
import os
from pathlib import Path

from starcal_ros.files.output import OutputError, whole, write_text

MOST = 6
"""Files that are kept."""

_DIGEST = '.sha256'
_PART = 1 << 18         # bytes that are read at once: memory for a whole file takes as long as it


def folder() -> Path:
    """Return where files are kept; it need not exist."""
    base = os.environ.get('XDG_CACHE_HOME')
    return (Path(base) if base else Path.home() / '.cache') / 'starcal_ros'


def find(name: str) -> Path | None:
    """Return a file that is kept, as it was written; None where there is none."""
    with suppress(OSError, RuntimeError):               # no home is a RuntimeError
        path = folder() / name
        if path.with_name(name + _DIGEST).read_bytes() == _digest(path).encode():
            return path
    return None


def keep(name: str, write: Callable[[Path], None]) -> None:
    """Keep a file, where there is a place.

    Parameters
    ----------
    name : str
        All that its content depends on, as a name of a file.
    write : callable
        Writes it to a path.
    """
    with suppress(OSError, RuntimeError, OutputError):
        path = folder() / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as draft:
            write(draft)
            digest = _digest(draft)
        write_text(path.with_name(name + _DIGEST), digest)
        _forget_old(path.parent)


def _forget_old(kept: Path) -> None:
    files = sorted((path for path in kept.iterdir() if path.suffix == _DIGEST),
                   key=lambda path: path.stat().st_mtime)
    for path in files[:-MOST]:
        path.with_suffix('').unlink(missing_ok=True)
        path.unlink(missing_ok=True)


def _digest(path: Path) -> str:
    found = hashlib.sha256()
    with path.open('rb') as stream:
        while part := stream.read(_PART):
            found.update(part)
    return found.hexdigest()
