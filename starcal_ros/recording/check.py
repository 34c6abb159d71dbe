# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether a recording is what it says, file by file and against its metadata."""

from __future__ import annotations

from pathlib import Path
import sqlite3

from starcal_ros.files.documents import DocumentError, load_yaml
from starcal_ros.files.foreign import clean
from starcal_ros.recording.bag import open_bag
from starcal_ros.recording.bag_files import MCAP, METADATA, find
from starcal_ros.recording.mcap_check import Findings, check_file


def check(path: Path) -> dict[str, Findings]:
    """Check a recording; return what is found, by the name of the file.

    Raises
    ------
    RecordError
        If the path holds no recording.
    """
    found = find(path)
    results = {file.name: check_file(part) if found.storage == MCAP else _check_sqlite(part)
               for file, part in zip(found.files, found.parts)}
    if path.is_dir():
        count = sum(topic.count for topic in open_bag(path).topics())
        results[METADATA] = _check_metadata(path / METADATA, count)
    return results


def _check_sqlite(path: Path) -> Findings:
    """Ask sqlite itself; it has no checksums of its content."""
    try:
        with sqlite3.connect(f'{path.resolve().as_uri()}?mode=ro', uri=True) as database:
            rows = [str(row[0]) for row in database.execute('PRAGMA integrity_check')]
            count = int(database.execute('SELECT COUNT(*) FROM messages').fetchone()[0])
    except sqlite3.Error as error:
        return Findings(faults=[clean(str(error))])
    return Findings([clean(row) for row in rows if row != 'ok'], ['sqlite3 data'], 0, count)


def _check_metadata(path: Path, count: int) -> Findings:
    try:
        stated = load_yaml(path.read_text())['rosbag2_bagfile_information']['message_count']
    except FileNotFoundError:
        return Findings(faults=['is missing'])
    except (OSError, DocumentError, ValueError, LookupError, TypeError) as error:
        return Findings(faults=[clean(f'cannot be read: {" ".join(str(error).split())}')])
    return Findings([] if stated == count else [
        f'says {stated} messages, the files hold {count}'])
