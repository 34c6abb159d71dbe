# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A Monte Carlo as a table."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from starcal_ros.files.foreign import literal


def study(point: dict[str, Any], title: str) -> Table:
    """Return a Monte Carlo as a table: RMS, bound and their ratio for each state.

    `prior` is the part of a state's variance that the data has not replaced.
    """
    def interval(name: str) -> str:
        low, high = point[name]
        return f'{low:.4f} to {high:.4f}'

    heading = literal(f'{title}\n{point["runs"]} runs of {point["duration_s"]:g} s')
    out = Table(title=heading, caption=(
        f'NEES {point["nees_mean"]:.2f} of {point["nees_degrees"]} states '
        f'(95 %: {interval("nees_interval_95")}), '
        f'NIS {point["nis_mean"]:.4f} (95 %: {interval("nis_interval_95")}), '
        f'ratio 95 %: {interval("ratio_interval_95")}'
        + ''.join(f'; {word}: {count}' for word, count in point['verdicts'].items())
        + ''.join(f'; {name} fails in {count}' for name, count in point['failed_tests'].items())))
    for column in ('state', 'unit', 'RMS', 'bound', 'ratio', 'stated sigma', 'prior'):
        out.add_column(column, justify='left' if column in ('state', 'unit') else 'right',
                       overflow='fold')
    for name, state in point['states'].items():
        out.add_row(name, state['unit'], f'{state["rms"]:.3g}', f'{state["bound"]:.3g}',
                    f'{state["ratio"]:.3f}', f'{state["sigma"]:.3g}', f'{state["prior"]:.1%}')
    return out
