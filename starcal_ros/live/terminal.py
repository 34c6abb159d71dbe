# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The running estimator in a terminal: verdict, states, rates, counts and a map of the stars.

What was heard (`heard.Seen`) in, something that rich can print out. The map is the
detector in characters, v downward. A star that was used is a dot where its innovation is inside
the ellipse of 68 %, and otherwise an arrow along its residual, measured minus predicted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from starcal_ros.files.foreign import clean
from starcal_ros.core.verdict_words import CONVERGED
from starcal_ros.live import facts
from starcal_ros.live.heard import Seen
from starcal_ros.report.states import short

_COLUMNS = 32                   # of the map
_ARROWS = '→↘↓↙←↖↑↗'             # by 45 deg of (du, dv)
_STYLES = ('bold', 'bold yellow', 'bold red', 'bold magenta')     # by the level of diagnostics


def render(seen: Seen) -> RenderableType:
    """Return the whole view, 80 columns wide."""
    parts: list[RenderableType] = [_verdict(seen), _inputs(seen)]
    body = Table.grid(padding=(0, 1))
    cells: list[RenderableType] = []
    if seen.state is not None:
        cells.append(_states(facts.states(seen), bool(facts.doubt(seen))))
    if seen.stars is not None and seen.size is not None:
        cells.append(Group(*_stars(seen.stars, seen.size)))
    body.add_row(*cells)
    parts.append(body)
    if seen.state is not None and (doubt := facts.doubt(seen)):
        parts.append(Text(doubt, style='bold red'))
    if counts := ', '.join(f'{name} {value}' for name, value in facts.counts(seen).items()):
        parts.append(Text(clean(counts), style='dim'))
    if (advice := facts.advice(seen)) and advice not in facts.verdict(seen):
        parts.append(Text(clean(f'advice: {advice}'), style='yellow'))
    if alike := facts.not_told_apart(seen):
        parts.append(Text(clean(f'not told apart: {alike}'), style='yellow'))
    return Group(*parts)


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
        elif stars['nis'][k] <= facts.USUAL:
            sign = '•', 'green'
        else:
            sign = _ARROWS[sector[k]], 'yellow' if stars['nis'][k] > facts.RARE else 'cyan'
        cells[row[k]][column[k]] = sign
    lines = (Text.assemble(*line) for line in cells)
    return Text('\n').join(lines)


def _verdict(seen: Seen) -> Text:
    if silence := facts.silence(seen):
        return Text(silence, style='bold magenta')
    style = 'bold green' if seen.message == CONVERGED else _STYLES[min(seen.level, 3)]
    return Text(clean(facts.verdict(seen)), style=style)


def _inputs(seen: Seen) -> Text:
    parts = [] if seen.inputs_message == 'receiving' else [seen.inputs_message]
    parts += [f'{"/".join(rate.topic.split("/")[-2:])} {rate.per_second:.1f} Hz'
              for rate in facts.rates(seen)]
    if stamp := facts.stamp_text(seen):
        parts.append(f'last frame {stamp} UTC')
    if (rms := facts.reprojection_px(seen)) is not None:
        parts.append('reprojection {:.4f} {:.4f} px'.format(*rms))
    return Text(clean(', '.join(filter(None, parts))))


def _states(states: Sequence[facts.StateFact], doubted: bool) -> Table:
    out = Table(box=None, padding=(0, 1, 0, 0), header_style='dim')
    for column, justify in (('', 'left'), ('estimate', 'right'), ('sigma', 'right'),
                            ('tolerance', 'right'), ('', 'left'), ('', 'left')):
        out.add_column(column, justify=justify, no_wrap=True)       # type: ignore[arg-type]
    for state in states:
        row, known = state.row, np.isfinite(state.tolerance)
        sign, style = (('', 'dim') if not known else ('?', 'red') if doubted else
                       ('✓', 'green') if state.within else ('…', 'yellow'))
        out.add_row(row.label, row.places(row.estimate), short(row.sigma),
                    short(state.tolerance) if known else '', row.unit, sign, style=style)
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
