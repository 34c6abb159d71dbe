# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How much of a file is believed, so that a small one can not fill the memory.

Each limit of `LIMITS` is raised, or lowered, by an environment variable: it holds for commands and
nodes alike, and belongs to the machine rather than to a scenario.
"""

from __future__ import annotations

import os
from typing import NamedTuple


class LimitError(ValueError):
    """A file asks for more than is allowed, or a limit is none; the text says what is."""


class Limit(NamedTuple):
    """A limit.

    Attributes
    ----------
    variable : str
        Environment variable that replaces the default.
    default : float
        In `unit`.
    unit : str
        As a user writes it.
    scale : int
        What one unit is.
    """

    variable: str
    default: float
    unit: str
    scale: int

    @property
    def value(self) -> int:
        """How much is allowed; LimitError where the environment has no number."""
        given = os.environ.get(self.variable)
        try:
            number = self.default if given is None else float(given)
            if not 0.0 < number < 1e9:
                raise ValueError
        except ValueError:
            raise LimitError(f'{self.variable}: got {given!r}, needs a number of '
                             f'{self.unit} above 0') from None
        return int(number * self.scale)

    def check(self, amount: int, what: str) -> None:
        """Raise LimitError where something is larger than allowed."""
        if amount > self.value:
            raise LimitError(f'{what} of {amount / self.scale:.6g} {self.unit}, at most '
                             f'{self.value / self.scale:g} are read ({self.variable})')


CHUNK = Limit('STARCAL_MAX_CHUNK_MB', 256.0, 'MB', 10**6)
"""Unpacked size of a chunk of an MCAP file, or of a message that is compressed by itself."""
IMAGE = Limit('STARCAL_MAX_IMAGE_MPX', 64.0, 'megapixels', 10**6)
"""Pixels of an image, whether in a file or in a message."""
DOCUMENT = Limit('STARCAL_MAX_DOCUMENT_MB', 8.0, 'MB', 10**6)
"""Length of a YAML or JSON text."""
LIMITS = (CHUNK, IMAGE, DOCUMENT)

NESTING = 64
"""Levels of a YAML text; parameter files have five."""
NODES = 200_000
"""Values of a YAML text, those that an alias repeats counted each time."""
