# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command starcal, and a recording that it has made."""

from typing import NamedTuple

import pytest

from starcal_ros.cli import main


class Done(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str


@pytest.fixture
def starcal(capsys):
    """Return a function that runs the command; an exception that it lets out fails the test."""
    def run(*words):
        try:
            status = main([str(word) for word in words])
        except SystemExit as end:                   # argparse: usage, --help, --version
            status = end.code or 0
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return Done(status, out, err)
    return run


@pytest.fixture(scope='session')
def bag(tmp_path_factory):
    """Return a recording of 20 s that the command itself has made."""
    path = tmp_path_factory.mktemp('bag') / 'run.mcap'
    assert main(['simulate', '--out', str(path), '--duration', '20']) == 0
    return path
