# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is kept comes back as it was written, or counts as none."""

import os

import pytest

from starcal_ros.files import cache


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Keep nothing outside of the test."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))


def test_a_file_that_is_kept_is_found():
    assert cache.find('sky') is None
    cache.keep('sky', lambda draft: draft.write_bytes(b'stars'))
    assert cache.find('sky').read_bytes() == b'stars'


def test_without_the_variable_it_is_in_the_home(tmp_path, monkeypatch):
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setenv('HOME', str(tmp_path))
    assert cache.folder() == tmp_path / '.cache' / 'starcal_ros'


@pytest.mark.parametrize('spoil', [
    lambda path: path.write_bytes(b'stare'), lambda path: path.unlink(),
    lambda path: path.with_name('sky.sha256').unlink(),
    lambda path: path.with_name('sky.sha256').write_bytes(b'\xff')])
def test_a_file_that_is_not_as_it_was_written_counts_as_none(spoil):
    cache.keep('sky', lambda draft: draft.write_bytes(b'stars'))
    spoil(cache.folder() / 'sky')
    assert cache.find('sky') is None


def test_the_newest_are_kept():
    for k in range(cache.MOST + 2):
        cache.keep(f'sky{k}', lambda draft: draft.write_bytes(b'stars'))
        for path in cache.folder().iterdir():
            if path.name.startswith(f'sky{k}'):
                os.utime(path, (k, k))
    cache.keep('last', lambda draft: draft.write_bytes(b'stars'))
    assert [cache.find(f'sky{k}') is not None for k in range(cache.MOST + 2)] == [
        *(False,) * 3, *(True,) * (cache.MOST - 1)]
    assert len([*cache.folder().iterdir()]) == 2 * cache.MOST


def test_without_a_place_nothing_is_kept(tmp_path, monkeypatch):
    (tmp_path / 'file').write_bytes(b'')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'file'))
    cache.keep('sky', lambda draft: draft.write_bytes(b'stars'))
    assert cache.find('sky') is None
