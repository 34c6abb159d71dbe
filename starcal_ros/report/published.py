# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A reproduced table for the terminal."""

from __future__ import annotations

from rich.table import Table

from starcal_ros.evaluation.published import BESIDE, Outcome


def published(outcome: Outcome) -> Table:
    """Return an outcome as a table, its notes below."""
    out = Table(title=outcome.title, caption='\n'.join(outcome.notes), caption_justify='left')
    for name, value in zip(outcome.columns, outcome.rows[0]):
        out.add_column(name, justify='left' if isinstance(value, str) else 'right', no_wrap=True)
    digits = '.3g' if outcome.columns == BESIDE else '.2f'
    group = outcome.rows[0][0]
    for row in outcome.rows:
        if row[0] != group and outcome.columns == BESIDE:
            out.add_section()
        group = row[0]
        out.add_row(*(cell if isinstance(cell, str) else f'{cell:{digits}}' for cell in row))
    return out
