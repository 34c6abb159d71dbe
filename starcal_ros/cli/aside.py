# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Work on another core, while the command goes on."""

from __future__ import annotations

from collections.abc import Callable
import multiprocessing
from multiprocessing.connection import Connection
import os
import signal
from typing import TypeVar

T = TypeVar('T')


def aside(work: Callable[[], T]) -> Callable[[], T]:
    """Begin some work in a copy of this process, and return what waits for its result.

    It is done here, when it is waited for, where there is one core alone, or where the copy was
    ended from outside, as where memory runs out.

    Parameters
    ----------
    work : callable
        Its result, or what it raises, goes through pickle; all else that it changes is lost.
    """
    if len(os.sched_getaffinity(0)) < 2:
        return work
    context = multiprocessing.get_context('fork')
    near, far = context.Pipe(duplex=False)
    copy = context.Process(target=_send, args=(work, far), daemon=True)
    copy.start()
    far.close()

    def result() -> T:
        try:
            found, error = near.recv()
        except EOFError:
            return work()
        finally:
            copy.join()
        if error is not None:
            raise error
        done: T = found
        return done
    return result


def _send(work: Callable[[], T], far: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)        # for the command to answer
    outcome: tuple[T | None, Exception | None]
    try:
        outcome = work(), None
    except Exception as error:
        outcome = None, error
    far.send(outcome)
