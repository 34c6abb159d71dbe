# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON of others, read within limits.

An alias of YAML repeats what is long in a few bytes, and again what repeats it: what it stands for
is counted each time. One inside of what it repeats has no end and is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
from typing import Any

import yaml

from starcal_ros.files.limits import DOCUMENT, NESTING, NODES, LimitError

_GARBLED = (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError)


class DocumentError(ValueError):
    """A text that is not what it should be; one line.

    Attributes
    ----------
    line : int or None
        Where, from 1 on.
    """

    def __init__(self, text: str, line: int | None = None) -> None:
        super().__init__(text)
        self.line = line


class BoundedLoader(yaml.SafeLoader):                   # type: ignore[misc]  # no hints
    """SafeLoader that counts levels and values, and refuses what has no end."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._nodes = 0
        self._open: list[str | None] = []
        self._sizes: dict[str, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a value within the limits."""
        event = self.peek_event()
        anchor, before = event.anchor, self._nodes
        if isinstance(event, yaml.AliasEvent):
            if anchor in self._open:
                raise DocumentError(f'the alias *{anchor} stands in what it repeats',
                                    event.start_mark.line + 1)
            self._nodes += self._sizes.get(anchor, 0)
        self._nodes += 1
        if self._nodes > NODES or len(self._open) >= NESTING:
            what = (f'{NESTING} levels' if len(self._open) >= NESTING else
                    f'{NODES} values, repeated ones counted')
            raise DocumentError(f'more than {what}', event.start_mark.line + 1)
        if isinstance(event, yaml.AliasEvent):
            return super().compose_node(parent, index)
        self._open.append(anchor)
        node = super().compose_node(parent, index)
        self._open.pop()
        if anchor is not None:
            self._sizes[anchor] = self._nodes - before
        return node


@contextmanager
def bounded_yaml(text: str) -> Iterator[None]:
    """Hold the length of a YAML text against its limit, and say what is wrong in one line.

    Raises
    ------
    DocumentError
        Where what is done inside finds no YAML, or something beyond the limits.
    """
    try:
        DOCUMENT.check(len(text), 'a text')
        yield
    except LimitError as error:
        raise DocumentError(str(error)) from None
    except DocumentError:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        raise DocumentError(f'not YAML: {getattr(error, "problem", None) or _line(error)}',
                            mark.line + 1 if mark else None) from None
    except _GARBLED as error:           # of the values: a date that is none, too long a number
        raise DocumentError(f'not YAML: {_line(error)}') from None


def load_yaml(text: str) -> Any:
    """Read a YAML text.

    Raises
    ------
    DocumentError
        Where it is no YAML, or beyond the limits.
    """
    with bounded_yaml(text):
        return yaml.load(text, Loader=BoundedLoader)


def load_json(text: str | bytes) -> Any:
    """Read a JSON text.

    Raises
    ------
    DocumentError
        Where it is no JSON, or beyond the limits.
    """
    try:
        DOCUMENT.check(len(text), 'a text')
        return json.loads(text)
    except LimitError as error:
        raise DocumentError(str(error)) from None
    except RecursionError:
        raise DocumentError('not JSON that can be read: nested too deep') from None
    except ValueError as error:
        raise DocumentError(f'not JSON: {_line(error)}') from None


def _line(error: BaseException) -> str:
    return ' '.join(f'{type(error).__name__} {error}'.split())
