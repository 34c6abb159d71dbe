# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The running estimator in a terminal: verdict, states, rates, counts and a map of the stars.

Messages in, as plain arrays and texts (`Seen`), something that rich can print out. The map is the
detector in characters, v downward. A star that was used is a dot where its innovation is inside
the ellipse of 68 %, and otherwise an arrow along its residual, measured minus predicted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG, DEG_PER_HOUR
from starcal_ros.files.foreign import clean
from starcal_ros.filter.frame_result import Counts
from starcal_ros.filter.states import N_STATES, STATE_NAMES, UNIT
from starcal_ros.messages.conventions import STATE_LAYOUT
from starcal_ros.report.states import LABELS, UNITS, Row, short

STATE_SIZE = sum(size for _, size in STATE_LAYOUT)
"""Length of the data of ``starcal/state``."""
STAR_FIELDS = ('u', 'v', 'du', 'dv', 'nis', 'accepted')
"""What the map needs of ``starcal/residuals``."""

_LABELS = ('φ_x', 'φ_y', 'φ_z', *LABELS)
_UNITS = (*UNITS[3:6], *UNITS)
_SHOWN_UNIT = np.array([*(DEG,) * 3, *(DEG_PER_HOUR,) * 3, *(DEG,) * 3, *(1.0,) * 7])
_COUNTS = {*(count.name for count in fields(Counts)), 'waiting_frames'}
_COLUMNS = 32                   # of the map
_ARROWS = '→↘↓↙←↖↑↗'             # by 45 deg of (du, dv)
_USUAL, _RARE = 2.30, 9.21      # chi-square of two degrees of freedom: 68 %, 99 %
_STYLES = ('bold', 'bold yellow', 'bold red', 'bold magenta')     # by the level of diagnostics
_SILENT_S = 3.0                 # silence after which an estimator is taken to be gone


@dataclass
class Seen:
    """What has been heard of an estimator; nothing yet, to begin with.

    Attributes
    ----------
    state : (273,) array, optional
        Data of ``starcal/state``.
    stars : structured (n,) array, optional
        ``starcal/residuals``, with STAR_FIELDS.
    size : (int, int), optional
        Width and height of the detector [px].
    level : int
        Of the diagnostics: 0 OK, 1 warning, 2 error, 3 stale.
    message : str
        The verdict.
    values : mapping
        The other diagnostics of the calibration, by their keys.
    inputs_message : str
        What the diagnostics say of the inputs.
    inputs : mapping
        Their diagnostics, by their keys.
    silent_s : float
        Time since the last diagnostics.
    """

    state: Array | None = None
    stars: NDArray[np.void] | None = None
    size: tuple[int, int] | None = None
    level: int = 3
    message: str = ''
    values: Mapping[str, str] = field(default_factory=dict)
    inputs_message: str = ''
    inputs: Mapping[str, str] = field(default_factory=dict)
    silent_s: float = np.inf


def render(seen: Seen) -> RenderableType:
    """Return the whole view, 80 columns wide."""
    parts: list[RenderableType] = [_verdict(seen), _inputs(seen)]
    body = Table.grid(padding=(0, 1))
    cells: list[RenderableType] = []
    if seen.state is not None:
        cells.append(_states(seen.state, seen.values))
    if seen.stars is not None and seen.size is not None:
        cells.append(Group(*_stars(seen.stars, seen.size)))
    body.add_row(*cells)
    parts.append(body)
    counts = [f'{key.replace("_", " ")} {value}' for key, value in seen.values.items()
              if key in _COUNTS]
    if counts:
        parts.append(Text(clean(', '.join(counts)), style='dim'))
    advice = seen.values.get('advice', 'none')
    if advice != 'none' and advice not in seen.message:
        parts.append(Text(clean(f'advice: {advice}'), style='yellow'))
    if seen.values.get('not_told_apart', 'none') != 'none':
        parts.append(Text(clean(f'not told apart: {seen.values["not_told_apart"]}'),
                          style='yellow'))
    return Group(*parts)


def tolerances(values: Mapping[str, str]) -> list[float]:
    """Return the tolerance of each state out of the diagnostics, NaN where there is none."""
    return [float(values.get(f'tolerance_{name}', 'nan')) for name in STATE_NAMES]


def star_map(stars: NDArray[np.void], size: tuple[int, int], columns: int = _COLUMNS) -> Text:
    """Return the detector in characters, which are twice as high as wide."""
    width, height = size
    rows = max(1, round(0.5 * columns * height / width))
    column = np.clip((stars['u'] + 0.5) * columns // width, 0, columns - 1).astype(int)
    row = np.clip((stars['v'] + 0.5) * rows // height, 0, rows - 1).astype(int)
    sector = np.rint(np.arctan2(stars['dv'], stars['du']) / (np.pi / 4.0)).astype(int) % 8
    cells = [[(' ', '')] * columns for _ in range(rows)]
    for k in np.argsort(~stars['accepted'].astype(bool), kind='stable'):    # the rejected on top
        if not stars['accepted'][k]:
            sign = '×', 'bold red'
        elif stars['nis'][k] <= _USUAL:
            sign = '•', 'green'
        else:
            sign = _ARROWS[sector[k]], 'yellow' if stars['nis'][k] > _RARE else 'cyan'
        cells[row[k]][column[k]] = sign
    lines = (Text.assemble(*line) for line in cells)
    return Text('\n').join(lines)


def _verdict(seen: Seen) -> Text:
    if seen.silent_s > _SILENT_S:
        since = f'for {seen.silent_s:.0f} s' if np.isfinite(seen.silent_s) else 'so far'
        return Text(f'no estimator is heard {since}', style='bold magenta')
    style = 'bold green' if seen.message == 'converged' else _STYLES[min(seen.level, 3)]
    return Text(clean(seen.message), style=style)


def _inputs(seen: Seen) -> Text:
    parts = [] if seen.inputs_message == 'receiving' else [seen.inputs_message]
    for key, value in seen.inputs.items():
        topic, _, what = key.rpartition(' ')
        if what == 'messages_per_second':
            parts.append(f'{"/".join(topic.split("/")[-2:])} {value} Hz')
    if seen.state is not None:
        stamp = np.datetime64(round(seen.state[0] * 1e3), 'ms')
        parts.append(f'last frame {stamp} UTC')
    rms = [float(seen.values.get(f'reprojection_rms_{axis}_px', 'nan')) for axis in 'uv']
    if np.isfinite(rms).all():
        parts.append('reprojection {:.4f} {:.4f} px'.format(*rms))
    return Text(clean(', '.join(filter(None, parts))))


def _states(state: Array, values: Mapping[str, str]) -> Table:
    estimate = state[1:1 + N_STATES] / _SHOWN_UNIT
    covariance = state[1 + N_STATES:].reshape(N_STATES, N_STATES)
    sigma = np.sqrt(np.diag(covariance)) / UNIT
    out = Table(box=None, padding=(0, 1, 0, 0), header_style='dim')
    for column, justify in (('', 'left'), ('estimate', 'right'), ('sigma', 'right'),
                            ('tolerance', 'right'), ('', 'left'), ('', 'left')):
        out.add_column(column, justify=justify, no_wrap=True)       # type: ignore[arg-type]
    for k, tolerance in enumerate(tolerances(values)):
        row = Row(_LABELS[k], _UNITS[k], np.nan, float(estimate[k]), np.nan, float(sigma[k]))
        known = np.isfinite(tolerance)
        within = known and row.sigma <= tolerance
        style = 'dim' if not known else 'green' if within else 'yellow'
        out.add_row(row.label, row.places(row.estimate), short(row.sigma),
                    short(tolerance) if known else '', row.unit,
                    '' if not known else '✓' if within else '…', style=style)
    return out


def _stars(stars: NDArray[np.void], size: tuple[int, int]) -> Iterator[RenderableType]:
    used = stars[stars['accepted'].astype(bool)]
    yield Panel.fit(star_map(stars, size), padding=0, border_style='dim')
    caption = f'{len(used)} of {len(stars)} stars used'
    if len(used):
        du, dv = (np.sqrt(np.mean(used[name]**2)) for name in ('du', 'dv'))
        caption += f', {short(du)} {short(dv)} px'
    yield Text(caption)
    yield Text('• inside 68 %  → beyond  × rejected', style='dim')
