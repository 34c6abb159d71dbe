# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a recording lacks: counted while it is made, written into it, told to who reads it.

A topic of a steady rate shows what is missing in its stamps, whoever lost it: the sensor, the
network or a recorder that was held up. What the middleware says of itself is counted apart; it
may be some of the same. A recorder that was held up long says so as well: what its publishers lost
after their last message that it got, no stamp tells.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import json
from typing import NamedTuple

import numpy as np

LOSSES = 'starcal_losses'
"""The record of an MCAP file, and the entry of ``custom_data`` in metadata.yaml."""

RECORDER = 'recorder'
"""Stands for a topic where the recorder itself is meant."""

_RECENT, _ENOUGH = 100, 10      # intervals that tell the period, and the fewest that do
_STEADY = 0.2                   # how far half of the intervals may be off, of the period
_GAP = 1.5                      # periods


class Loss(NamedTuple):
    """What a topic lacks: messages by its stamps, the longest gap [s], by the middleware.

    Under the name `RECORDER`: how long the recorder itself did nothing [s], all in all.
    """

    missing_by_stamps: int = 0
    longest_gap_s: float = 0.0
    lost_by_middleware: int = 0
    held_up_s: float = 0.0

    def since(self, before: Loss) -> Loss:
        """Return what has been added; the longest gap is that of all time."""
        return Loss(self.missing_by_stamps - before.missing_by_stamps, self.longest_gap_s,
                    self.lost_by_middleware - before.lost_by_middleware,
                    self.held_up_s - before.held_up_s)

    def __bool__(self) -> bool:
        """Tell whether anything is lacking."""
        return bool(self.missing_by_stamps or self.lost_by_middleware or self.held_up_s)

    def __str__(self) -> str:
        """Return it in words."""
        words = []
        if self.missing_by_stamps:
            words.append(f'{self.missing_by_stamps} messages are missing by their stamps, the '
                         f'longest gap is {self.longest_gap_s:.2f} s')
        if self.lost_by_middleware:
            words.append(f'{self.lost_by_middleware} messages were lost by the middleware')
        if self.held_up_s:
            words.append(f'held up for {self.held_up_s:.1f} s, what came meanwhile may be missing')
        return '; '.join(words)


class StampGaps:
    """Counts the gaps in the stamps of a topic.

    Parameters
    ----------
    longest_s : float
        Longer ones are another run, not a gap.

    Attributes
    ----------
    missing : int
        Messages that a steady rate would have had in them.
    longest_s : float
        The longest gap [s].
    """

    def __init__(self, longest_s: float) -> None:
        self._limit_ns = longest_s * 1e9
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_RECENT)
        self.missing, self.longest_s = 0, 0.0

    def add(self, stamps_ns: Sequence[int]) -> None:
        """Go on with stamps, in the order of their arrival; what goes back does not count."""
        last_ns = stamps_ns[0] if self._last_ns is None else self._last_ns
        newest = np.maximum.accumulate(np.array([last_ns, *stamps_ns], np.int64))
        self._last_ns = int(newest[-1])
        steps = np.diff(newest)
        steps = steps[(steps > 0) & (steps < self._limit_ns)]
        self._recent.extend(steps.tolist())
        if len(self._recent) < _ENOUGH or not steps.size:
            return
        # A live recorder comes here for each topic with a few stamps, mostly without a gap.
        if steps.max() <= _GAP * min(self._recent):
            return
        recent = np.array(self._recent)
        period = np.median(recent)
        if np.median(np.abs(recent - period)) > _STEADY * period:
            return
        gaps = steps[steps > _GAP * period]
        if gaps.size:
            self.missing += int((np.rint(gaps / period) - 1).sum())
            self.longest_s = max(self.longest_s, float(gaps.max()) * 1e-9)


def dump(losses: dict[str, Loss]) -> dict[str, str]:
    """Return the losses of some topics as the texts of a record, by topic, JSON."""
    return {topic: json.dumps({name: round(value, 3) for name, value in loss._asdict().items()
                               if value}) for topic, loss in losses.items() if loss}


def texts(record: dict[str, str]) -> list[str]:
    """Return what a record says, in words, whatever is in it."""
    if not record:      # of most files, which need no yaml then
        return []
    from starcal_ros.files.documents import load_json
    found = []
    for topic, text in record.items():
        try:
            found.append(f'{topic}: {Loss(**load_json(text))}')
        except (TypeError, ValueError):
            found.append(f'{topic}: messages are missing: {text}')
    return found
