# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a terminal says of calibrations that are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from rich.table import Table

from starcal_ros.core.units import ARCSEC
from starcal_ros.files.foreign import literal
from starcal_ros.report.states import LABELS, SIGMA_UNITS
from starcal_ros.results.comparison import NAMES, Agreement, OverDetector, StateDifference, Trend

_FAR = 3.0          # sigmas from which a difference is marked


def differences(names: Sequence[str], states: Sequence[Sequence[StateDifference]]) -> Table:
    """Return the table of the differences from the first result, each with its sigma.

    Parameters
    ----------
    names : sequence of str
        Of all results.
    states : sequence
        Of each result but the first, its states.
    """
    out = Table(title=literal(f'Less {names[0]}'), caption='difference ± sigma (in sigmas)')
    for column in ('state', 'unit', *names[1:]):
        out.add_column(literal(column), justify='left' if column in ('state', 'unit') else 'right',
                       overflow='fold')
    for rows in zip(*states):
        place = NAMES.index(rows[0].name)
        out.add_row(LABELS[place], SIGMA_UNITS[place], *(_cell(row) for row in rows))
    return out


def verdict_lines(found: Mapping[str, Agreement], differ: Sequence[str]) -> Iterator[str]:
    """Yield what the chi-squares say, the last line in words."""
    for name, each in found.items():
        yield (f'{name}: chi-square {each.chi2:.4g} of {each.freedom} degrees of freedom, by '
               f'chance {percent(each.probability)}')
    yield f'They differ: {", ".join(differ)}' if differ else 'They agree'


def detector_line(name: str, found: OverDetector) -> str:
    """Return what two cameras differ by over the detector."""
    row, column = np.unravel_index(int(found.length.argmax()), found.length.shape)
    u, v = found.uv[row, column]
    net = '' if found.net is None or found.net_sigma is None else (
        f'; a star is elsewhere in the gyro axes by {_arcsec(found.net)} '
        f'({_arcsec(found.net_sigma)} by the sigmas)')
    return (f'{name}: {_rms(found.length):.2g} px RMS over the detector ('
            f'{_rms(np.sqrt(2.0) * found.sigma):.2g} by their sigmas), most '
            f'{found.length.max():.2g} px at {u:.0f}, {v:.0f} px from the centre; a turn of '
            f'{_arcsec(found.turn)} taken out{net}')


def trend_table(trends: Sequence[Trend], quantity: str = 'time', unit: str = 'day') -> Table:
    """Return the table of trends with a quantity."""
    out = Table(title=f'With {quantity}', caption='a straight line against none; by chance: how '
                'often a state that stays, or goes so, scatters more')
    for column in ('state', 'unit', f'a {unit}', 'sigma', 'in sigmas', 'stays, by chance',
                   'straight, by chance'):
        out.add_column(column, justify='left' if column in ('state', 'unit') else 'right')
    for each in trends:
        place = NAMES.index(each.name)
        ratio = each.slope / each.sigma
        out.add_row(LABELS[place], SIGMA_UNITS[place], f'{each.slope:.3g}', f'{each.sigma:.2g}',
                    f'{ratio:+.1f}', percent(each.constant.probability),
                    percent(each.line.probability), style='bold' if abs(ratio) > _FAR else '')
    return out


def _cell(row: StateDifference) -> str:
    if row.sigma == 0.0:
        return f'{row.difference:.3g} held'
    ratio = row.difference / row.sigma
    text = f'{row.difference:.3g} ± {row.sigma:.2g} ({ratio:+.1f})'
    return f'[bold]{text}[/bold]' if abs(ratio) > _FAR else text


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _arcsec(turn: np.ndarray) -> str:
    return f'{float(np.linalg.norm(turn)) / ARCSEC:.3g} arcsec'


def percent(probability: float) -> str:
    """Return a probability in percent, to two digits, those of a whole hundred too."""
    if probability < 1e-12:
        return 'never'
    value = 100.0 * probability
    return f'{value:.0f} %' if value >= 9.95 else f'{value:.2g} %'
