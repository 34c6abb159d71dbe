# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a reproduced table or figure holds: rows, notes, values, and what is to be drawn.

`report` prints the rows and draws the panels; nothing here knows how.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from starcal_ros.core.arrays import Array


@dataclass(frozen=True)
class Curve:
    """Values over values.

    Attributes
    ----------
    x, y : (n,) array
        In the units of the panel's axes.
    label : str
        In the legend; '' for none.
    style : str
        ``line``, ``points``, ``marked`` (a line through points), ``bars``, ``limit`` (dashed, for
        a bound) or ``paper`` (what the paper has).
    spread : (n,) array, optional
        Half height of a band around y.
    """

    x: Array
    y: Array
    label: str = ''
    style: str = 'line'
    spread: Array | None = None


@dataclass(frozen=True)
class Field:
    """Values over the detector.

    Attributes
    ----------
    x, y : (columns,), (rows,) array
        Middle of the cells, in the units of the panel's axes.
    z : (rows, columns) array
        Value of each cell.
    vector : (rows, columns, 2) array, optional
        Drawn as arrows.
    """

    x: Array
    y: Array
    z: Array
    vector: Array | None = None


@dataclass(frozen=True)
class Panel:
    """One pair of axes of a figure.

    Attributes
    ----------
    title, x, y : str
        Caption and axes, with units.
    curves : tuple of Curve
    field : Field, optional
    log : str
        Axes that are logarithmic: '', 'x', 'y' or 'xy'.
    y_limits : (low, high), optional
        What of the y axis is shown; all of it otherwise.
    """

    title: str
    x: str
    y: str
    curves: tuple[Curve, ...] = ()
    field: Field | None = None
    log: str = ''
    y_limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Outcome:
    """A table or figure reproduced.

    Attributes
    ----------
    title : str
        Which one, and from how many runs.
    columns : tuple of str
        Head of the table; the first column groups the rows.
    rows : tuple of tuples
        Text and numbers.
    notes : tuple of str
        What the paper does not state, or what its numbers can not be by their own account.
    panels : tuple of Panel
        What is drawn; none for a table.
    values : mapping
        Numbers that others rely on, by name, for JSON.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]
    notes: tuple[str, ...]
    panels: tuple[Panel, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON, each row a dictionary."""
        return {'title': self.title, 'notes': list(self.notes),
                'rows': [dict(zip(self.columns, row)) for row in self.rows], **self.values}
