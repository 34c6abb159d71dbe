# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Text from outside, made harmless: names of topics, files and attachments, texts of errors.

A terminal obeys what is in it, and `rich` takes words in brackets for styles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.text import Text


def clean(text: str, keep: str = '') -> str:
    r"""Return a text with all that has no form of its own written out, as in ``\\x1b``.

    These are control characters, those that change the direction of writing, and the bytes of
    names that are not UTF-8.

    Parameters
    ----------
    text : str
    keep : str
        Characters to leave as they are, such as the line feed.
    """
    if text.isprintable():
        return text
    return ''.join(c if c.isprintable() or c in keep else c.encode('unicode_escape').decode()
                   for c in text)


def literal(text: str, keep: str = '\n') -> Text:
    """Return a text for `rich`, which shows it as it stands; for `keep` see `clean`."""
    from rich.text import Text
    return Text(clean(text, keep))
