# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Work on another core: its result, what it raises, and its end."""

import os
import signal

import pytest

from starcal_ros.cli.aside import aside
from starcal_ros.messages.cdr import RecordError


@pytest.fixture(params=[1, 2])
def cores(request, monkeypatch):
    monkeypatch.setattr(os, 'sched_getaffinity', lambda pid: set(range(request.param)))
    return request.param


def test_the_result_comes_back(cores):
    assert aside(lambda: [1.0, 'two'])() == [1.0, 'two']


def test_it_is_done_elsewhere_where_there_is_another_core(cores):
    assert (aside(os.getpid)() == os.getpid()) == (cores == 1)


def test_what_is_raised_is_raised_where_it_is_waited_for(cores):
    def fails():
        raise RecordError('cut short')
    waiting = aside(fails)
    with pytest.raises(RecordError, match='cut short'):
        waiting()


def test_what_was_ended_from_outside_is_done_here():
    here = os.getpid()

    def work():
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return 'done'
    assert aside(work)() == 'done'
