# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The extensions of the model that were tried on data that contradict it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from starcal_ros.files.foreign import literal

HEAD = ('extension', 'numbers', '2 log likelihood', 'less k ln n', 'beyond chance',
        'to add to the parameter file')
CRITERION = ('Tried on {stretch:.0f} s of the recording. Ranked by what each adds to twice the '
             'logarithm of the likelihood of the innovations, less k ln n: k numbers that it '
             'adds, n frames. Beyond chance is what a right model shows once in 100,000 times.')


def cells(tried: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return a row for each extension of RESULT.json."""
    return [[each['name'], str(each['numbers']), f'{each["gain"]:+.1f}', f'{each["score"]:+.1f}',
             'yes' if each['beyond_chance'] else 'no', '; '.join(each['lines'])]
            for each in tried]


def explanations_table(result: dict[str, Any]) -> Table:
    """Return the extensions of a RESULT.json as a table."""
    found = result['explanations']
    out = Table(title='What would explain the data',
                caption=CRITERION.format(stretch=found['stretch_s']) if found['tried'] else None)
    for name in HEAD:
        out.add_column(name, overflow='fold')
    for row in cells(found['tried']):
        out.add_row(*(literal(each) for each in row))
    return out
