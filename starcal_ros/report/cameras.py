# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera that was calibrated alone, as a table."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table

from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.files.foreign import literal
from starcal_ros.report.states import LABELS, UNITS, Row, short

BETWEEN = 'sigma, images'
"""Head of the sigmas that the scatter between images tells."""
SCALED = 'sigma, scaled'
"""Head of the sigmas that stand beside those that are not to be believed."""

_SCATTER = 'sigma_between_images'
_LEFT = ('state', 'unit')


def camera(result: dict[str, Any], truth: dict[str, Any] | None, title: str) -> Table:
    """Return the camera of a recording, against a truth.json where there is one."""
    bad = result['verdict'] == 'inconsistent'
    columns = ('state', 'unit', 'truth', 'estimate', 'error', 'sigma', 'error/sigma')
    out = _table(title, (*(columns if truth else ('state', 'unit', 'estimate', 'sigma')),
                         *([SCALED] if bad else [])))
    out.caption = '{frames} frames, {stars} stars used'.format(**result['counts']) + _doubt(result)
    for label, unit, key in zip(LABELS[6:], UNITS[6:], INTRINSICS_KEYS):
        value, sigma = result['intrinsics'][key], result['intrinsics_sigma'][key]
        true = truth['intrinsics'][key] if truth else np.nan
        row = Row(label, unit, true, value, value - true, sigma)
        held = sigma == 0.0
        cells = [row.places(value), 'held' if held else short(sigma)]
        if truth:
            cells = [row.places(true), cells[0], short(row.error), cells[1],
                     '' if held else f'{row.error / sigma:+.2f}']
        out.add_row(label, unit, *cells, *(_scaled(result, key, sigma) if bad else ()))
    return out


def chain(steps: list[dict[str, Any]], truth: dict[str, Any] | None, title: str) -> Table:
    """Return the camera after each step: its error where the truth is known, and its sigma."""
    out = _table(title, ('state', 'unit', *(f'{step["step"]}' for step in steps)))
    out.caption = ('error ± sigma' if truth else 'estimate ± sigma') + ' after each step'
    for label, unit, key in zip(LABELS[6:], UNITS[6:], INTRINSICS_KEYS):
        cells = []
        for step in steps:
            value, sigma = step['intrinsics'][key], step['intrinsics_sigma'][key]
            shown = short(value - truth['intrinsics'][key]) if truth else Row(
                label, unit, np.nan, value, np.nan, sigma).places(value)
            cells.append(f'{shown} ± {short(sigma)}' if sigma else f'{shown} held')
        out.add_row(label, unit, *cells)
    out.add_row('frames', '', *(str(step['counts']['frames']) for step in steps))
    return out


def still_images(result: dict[str, Any], title: str) -> Table:
    """Return the camera of still images in OpenCV's model, with the residuals that it leaves."""
    out = _table(title, entry_columns(result))
    counts, heldout = result['counts'], result['heldout_rms_px']
    out.caption = (
        f'{counts["images"]} images, {counts["stars"]} stars used, {counts["rejected_stars"]} '
        f'rejected; residual of an axis {result["fit_rms_px"]:.4f} px'
        + ('' if heldout is None else f', {heldout:.4f} px on held-out images')
        + _own_f(result) + _doubt(result))
    for key in result['parameters']:
        out.add_row(*entry(result, key))
    return out


def _own_f(result: dict[str, Any]) -> str:
    """Say what the focal lengths of the images are, where each has its own."""
    own = [each['f_px'] for each in result.get('own_f_px', {}).values()]
    return (f'; f is the mean of the images, which have {min(own):.2f} to {max(own):.2f} px'
            if own else '')


def entry_columns(result: dict[str, Any]) -> tuple[str, ...]:
    """Return the heads of `entry`."""
    return ('parameter', 'unit', 'estimate', 'sigma',
            *([BETWEEN] if result.get(_SCATTER) else []),
            *([SCALED] if result['verdict'] == 'inconsistent' else []))


def entry(result: dict[str, Any], key: str) -> list[str]:
    """Return parameter, unit, estimate and sigma of the camera of still images, as text.

    Where the sigma is not to be believed it stands beside as well, scaled.
    """
    name, _, unit = key.partition('_')
    row = Row(name, unit, np.nan, result[key], np.nan, result['sigma'][key])
    return [name, unit, row.places(row.estimate), short(row.sigma) if row.sigma else 'held',
            *([short(result[_SCATTER][key])] if result.get(_SCATTER) else []),
            *(_scaled(result, key, row.sigma) if result['verdict'] == 'inconsistent' else ())]


def _doubt(result: dict[str, Any]) -> str:
    return '; the sigmas are not to be believed' if result['verdict'] == 'inconsistent' else ''


def verdict_lines(result: dict[str, Any]) -> list[str]:
    """Return the verdict on a camera, each test that fails, and the advice."""
    said = result['verdict']
    lines = [f'Verdict: {said}{_doubt(result).replace(";", ",")}']
    lines += ['{name} {value:.4g}, allowed {low:.4g} to {high:.4g}'.format(**each)
              + (f' ({each["fits"]})' if each.get('fits') else '')
              for each in result['consistency'] if not each['passed']]
    return [*lines, result['advice']] if result['advice'] else lines


def _scaled(result: dict[str, Any], key: str, sigma: float) -> tuple[str]:
    return (short(sigma * float(np.sqrt(result['variance_factor'][key]))) if sigma else 'held',)


def _table(title: str, columns: tuple[str, ...]) -> Table:
    out = Table(title=literal(title))
    for column in columns:
        out.add_column(column, justify='left' if column in (*_LEFT, 'parameter') else 'right',
                       overflow='fold')
    return out
