# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What was wrong while a node ran: counted by kind, and said once a kind."""

from __future__ import annotations

from collections import Counter
import re
import traceback
from typing import Any

_NUMBER = re.compile(r'-?\d+(\.\d*)?(e[-+]?\d+)?|nan|inf|0x[0-9a-f]+', re.IGNORECASE)


class Faults:
    """Faults of one node.

    Parameters
    ----------
    logger
        Of the node.

    Attributes
    ----------
    counts : Counter
        Faults by kind.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.counts: Counter[str] = Counter()

    def add(self, kind: str, text: str) -> None:
        """Count a fault, and say it if it is the first of its kind."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            self._logger.error(f'{text}; more of this kind are counted only')

    def alike(self, text: str) -> None:
        """Count a fault of which only the numbers differ from others of its kind."""
        self.add(_NUMBER.sub('#', text), text)

    def defect(self, where: str, error: Exception) -> None:
        """Count an error of the program itself, which did not end the node."""
        place = traceback.extract_tb(error.__traceback__)[-1]
        self.add(f'error in {where}', f'error in {where}, the node goes on: '
                 f'{type(error).__name__}: {error} (line {place.lineno} of {place.filename})')

    def sum_up(self) -> None:
        """Say how often each kind came that came more than once."""
        for kind, number in self.counts.items():
            if number > 1:
                self._logger.error(f'{number} times: {kind}')
