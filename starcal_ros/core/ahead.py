# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What comes next is made ready while what is there is worked on."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

T = TypeVar('T')


_END = object()


def ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield items, of which the next is made in a thread meanwhile.

    Worth it where both sides leave Python for compiled code or for the disk. One item is made
    ahead, no more. A generator runs in that thread from its first line to its last, also where
    not all is taken from it; what it raises is raised where its item would have come.
    """
    with ThreadPoolExecutor(1) as thread:
        try:
            coming = thread.submit(next, items, _END)
            while (item := coming.result()) is not _END:
                coming = thread.submit(next, items, _END)
                yield cast(T, item)
        finally:
            thread.submit(getattr(items, 'close', lambda: None)).result()
