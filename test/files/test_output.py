# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results that are there whole or not at all."""

import errno
import os
import resource
import stat
import sys

import pytest

from starcal_ros.files import output
from starcal_ros.files.output import OutputError, same, whole, write_text


@pytest.fixture
def file_limit(monkeypatch):
    """Let no file grow beyond 64 kB, as on a disk that is full."""
    monkeypatch.setattr(sys, 'dont_write_bytecode', True)       # a cache would not be whole
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_text_is_written_with_the_rights_of_a_new_file(tmp_path):
    write_text(tmp_path / 'a.json', 'σ')
    (tmp_path / 'plain').touch()
    assert (tmp_path / 'a.json').read_text(encoding='utf-8') == 'σ'
    assert (tmp_path / 'a.json').stat().st_mode == (tmp_path / 'plain').stat().st_mode


def test_a_full_disk_leaves_the_file_of_before_and_no_draft(tmp_path, file_limit):
    path = tmp_path / 'a.json'
    write_text(path, 'before')
    with pytest.raises(OutputError, match='a.json: cannot be written: File too large'):
        write_text(path, 'x' * (1 << 17))
    assert path.read_text() == 'before' and os.listdir(tmp_path) == ['a.json']


def test_a_full_disk_leaves_no_new_file(tmp_path, file_limit):
    with pytest.raises(OutputError, match='cannot be written'):
        write_text(tmp_path / 'a.json', 'x' * (1 << 17))
    assert os.listdir(tmp_path) == []


def test_what_is_said_last_counts_too(tmp_path, monkeypatch):
    """Some file systems tell that they are full when the data is brought to the disk."""
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    write_text(tmp_path / 'a.json', 'before')
    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OutputError, match='No space left on device'):
        write_text(tmp_path / 'a.json', 'after')
    assert (tmp_path / 'a.json').read_text() == 'before'
    assert os.listdir(tmp_path) == ['a.json']


@pytest.mark.parametrize('error', [KeyboardInterrupt, RuntimeError])
def test_work_that_is_broken_off_leaves_nothing(tmp_path, error):
    with pytest.raises(error):
        with whole(tmp_path / 'a') as draft:
            draft.write_text('half')
            raise error
    assert os.listdir(tmp_path) == []


def test_a_link_is_followed_and_rights_are_kept(tmp_path):
    target, link = tmp_path / 'target', tmp_path / 'link'
    target.write_text('before')
    target.chmod(0o600)
    link.symlink_to(target)
    write_text(link, 'after')
    assert link.is_symlink() and target.read_text() == 'after'
    assert stat.S_IMODE(target.stat().st_mode) == 0o600


def test_the_other_name_of_a_replaced_file_keeps_its_content(tmp_path):
    (tmp_path / 'a').write_text('before')
    os.link(tmp_path / 'a', tmp_path / 'b')
    write_text(tmp_path / 'a', 'after')
    assert (tmp_path / 'b').read_text() == 'before'


@pytest.mark.parametrize('links', [True, False])
def test_a_file_that_came_to_be_meanwhile_is_kept(tmp_path, monkeypatch, links):
    """Also where the file system knows no hard links."""
    if not links:
        def refuse(source, target):
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))
        monkeypatch.setattr(os, 'link', refuse)
    with pytest.raises(OutputError, match='exists; choose another name or overwrite it'):
        with whole(tmp_path / 'a', replace=False) as draft:
            draft.write_text('mine')
            (tmp_path / 'a').write_text('precious')
    assert (tmp_path / 'a').read_text() == 'precious' and os.listdir(tmp_path) == ['a']
    with whole(tmp_path / 'b', replace=False) as draft:
        draft.write_text('mine')
    assert (tmp_path / 'b').read_text() == 'mine'


@pytest.mark.parametrize('place, reason', [('nowhere/a', 'No such file'), ('.', 'directory')])
def test_a_place_that_is_none_is_named(tmp_path, place, reason):
    with pytest.raises(OutputError, match=f'cannot be written: .*{reason}'):
        write_text(tmp_path / place, 'text')


def test_a_device_is_written_straight():
    write_text('/dev/null', 'text')
    with pytest.raises(OutputError, match='/dev/full: cannot be written: No space left'):
        write_text('/dev/full', 'text')
    assert stat.S_ISCHR(os.stat('/dev/full').st_mode)


def test_an_undecodable_name_in_a_text_is_written_as_its_bytes(tmp_path):
    write_text(tmp_path / 'a', 'run\udcff.mcap')
    assert (tmp_path / 'a').read_text() == 'run\\udcff.mcap'


def test_one_file_is_known_by_any_name(tmp_path):
    (tmp_path / 'a').touch()
    os.link(tmp_path / 'a', tmp_path / 'hard')
    (tmp_path / 'soft').symlink_to('a')
    (tmp_path / 'other').touch()
    assert same(tmp_path / 'a', tmp_path / 'hard') and same(tmp_path / 'soft', tmp_path / 'a')
    assert same(tmp_path / 'none', tmp_path / '.' / 'none')
    assert not same(tmp_path / 'a', tmp_path / 'other')
    assert not output.is_stream(tmp_path / 'a') and output.is_stream('/dev/null')
