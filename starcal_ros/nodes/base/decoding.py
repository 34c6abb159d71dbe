# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages as arrays, whatever is among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from starcal_ros.messages.cdr import Messages, RecordError

T = TypeVar('T')


def decoded(batch: list[bytes], decode: Callable[[Messages], T],
            on_dropped: Callable[[str], None]) -> Iterator[T]:
    """Yield messages as arrays, all at once, or singly around one that is no message.

    Parameters
    ----------
    batch : list of bytes
        Messages.
    decode : callable
        Makes arrays of them.
    on_dropped : callable
        Called with what is wrong with a message that can not be decoded.
    """
    try:
        yield decode(Messages.join(batch))
    except RecordError as error:
        if len(batch) == 1:
            on_dropped(f'message dropped: {error}')
        else:
            for message in batch:
                yield from decoded([message], decode, on_dropped)
