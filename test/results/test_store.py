# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Numbered folders: whole or not there, undone, never the same number twice."""

import os
import subprocess
import sys

import pytest

from starcal_ros.results.store import CalibrationStore, StoreError

FILES = {'result.json': '{}\n', 'imu.yaml': 'rate: 1.0\n'}

# Saves and is killed while it writes the second file; argv: directory.
KILLED = """
import os
import signal
import sys
from pathlib import Path
from starcal_ros.results.store import CalibrationStore


class Files(dict):
    def items(self):
        yield 'result.json', 'x' * 100
        os.kill(os.getpid(), signal.SIGKILL)


CalibrationStore(Path(sys.argv[1])).save(Files())
"""


@pytest.fixture
def archive(tmp_path):
    return CalibrationStore(tmp_path / 'saved')


def content(folder):
    """Return the files of a folder by name."""
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_folders_are_numbered_and_the_newest_comes_first(archive):
    assert archive.folders() == []
    saved = [archive.save(FILES) for _ in range(3)]
    assert [folder.name for folder in saved] == ['0001', '0002', '0003']
    assert archive.folders() == saved[::-1]
    assert all(content(folder) == FILES for folder in saved)


def test_latest_leads_to_the_newest(archive):
    archive.save({'a': '1'})
    archive.save({'a': '2'})
    assert content(archive.directory / 'latest') == {'a': '2'}
    archive.undo()
    assert content(archive.directory / 'latest') == {'a': '1'}
    archive.undo()
    assert not os.path.lexists(archive.directory / 'latest')


def test_what_is_undone_is_set_aside_and_its_number_is_not_used_again(archive):
    for _ in range(2):
        archive.save(FILES)
    aside = archive.undo()
    assert aside.name == '0002.undone' and content(aside) == FILES
    assert [folder.name for folder in archive.folders()] == ['0001']
    assert archive.save(FILES).name == '0003'


def test_nothing_to_undo_is_said(archive):
    with pytest.raises(StoreError, match='no saved calibration'):
        archive.undo()


def test_process_that_is_killed_while_it_saves_leaves_what_was_there(archive):
    archive.save(FILES)
    subprocess.run([sys.executable, '-c', KILLED, str(archive.directory)], check=False)
    assert [content(folder) for folder in archive.folders()] == [FILES]
    assert content(archive.directory / 'latest') == FILES
    assert archive.save(FILES).name == '0002'


def test_two_that_save_into_one_directory_get_different_numbers(archive, monkeypatch):
    """The other one was faster by a hair."""
    archive.save(FILES)
    found = archive._numbers
    seen = iter([[], found(r'(\d{4,})')])
    monkeypatch.setattr(archive, '_numbers', lambda pattern: next(seen, None) or found(pattern))
    assert archive.save({'a': '1'}).name == '0002'
    assert content(archive.directory / '0001') == FILES


def test_directory_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(StoreError, match='file.*cannot be written'):
        CalibrationStore(tmp_path / 'file' / 'saved').save(FILES)


def test_other_files_are_left_alone(archive):
    archive.save(FILES)
    for name in ('notes.txt', '12', '0009.old'):
        (archive.directory / name).write_text('')
    assert archive.save(FILES).name == '0002'
