# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What happened that a user should know, collected until somebody asks."""

from __future__ import annotations

from collections import Counter


class Notices:
    """Sentences in the order in which they were first given, each kind as often as is useful."""

    def __init__(self) -> None:
        self._texts: list[str] = []
        self._said: set[object] = set()
        self._counts: Counter[str] = Counter()

    def say(self, text: str) -> None:
        """Give a sentence, whatever was said before."""
        self._texts.append(text)

    def once(self, kind: object, text: str) -> None:
        """Give a sentence if none of its kind has been given."""
        if kind not in self._said:
            self._said.add(kind)
            self._texts.append(text)

    def count(self, what: str, number: int) -> None:
        """Add to a number that is told in one sentence, '7 stars that do not fit: rejected'."""
        self._counts[what] += number

    def take(self) -> list[str]:
        """Return what was given since the last call."""
        texts = self._texts + [f'{n} {what}' for what, n in self._counts.items() if n]
        self._texts, self._counts = [], Counter()
        return texts
