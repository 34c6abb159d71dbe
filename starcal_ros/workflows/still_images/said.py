# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is said of many images: once, with the names of the first few."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_NAMED = 5              # that a message names, at most


def listed(texts: Sequence[str], between: str = ', ') -> str:
    """Return the first few of some texts, and how many more there are."""
    more = len(texts) - _NAMED
    return between.join(texts[:_NAMED]) + (f'{between}and {more} more' if more > 0 else '')


def by_text(said: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return names, listed, and what is said of them, of pairs of a name and a text."""
    names: dict[str, list[str]] = {}
    for name, text in said:
        names.setdefault(text, []).append(name)
    return [(listed(those), text) for text, those in names.items()]
