# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a Monte Carlo: one page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import plotly.graph_objects as go

import starcal_ros
from starcal_ros.report.calibration import duration, made
from starcal_ros.report.chart import BLUE, GREY, PALE, RED, Chart, chart
from starcal_ros.report.markup import Page, PageSection, charts, items, key, section, table

_HEAD = ('state', 'unit', 'RMS', 'bound', 'ratio', 'stated sigma', 'prior')


def montecarlo_page(summary: dict[str, Any], title: str, command: str = '') -> Page:
    """Return the report of a Monte Carlo.

    Parameters
    ----------
    summary : dict
        As `evaluation.montecarlo.finish` gives it.
    title : str
        What was run.
    command : str
        That was given.
    """
    points = summary.get('points', [summary])
    swept = summary.get('sweep', '')
    facts = [('Runs', f'{points[0]["runs"]} of {duration(points[0]["duration_s"])}'
              + (f' at each of {len(points)} values of {swept}' if swept else '')),
             *made(command, starcal_ros.__version__)]
    sections = [_point(f'point-{k}', f'{swept} = {point[swept]}' if swept else 'States', point)
                for k, point in enumerate(points)]
    return Page(f'Monte Carlo of {title}', tuple(facts), (
        _verdict(points, swept), *([_sweep(points, swept)] if swept else []), *sections))


def _verdict(points: Sequence[dict[str, Any]], swept: str) -> PageSection:
    said, fine = [], True
    for point in points:
        where = f'{swept} = {point[swept]}: ' if swept else ''
        for name, of in (('NEES', f' of {point["nees_degrees"]} states'), ('NIS', '')):
            mean, (low, high) = point[f'{name.lower()}_mean'], point[
                f'{name.lower()}_interval_95']
            inside = low <= mean <= high
            fine &= inside
            said.append(f'{where}{name} {mean:.4g}{of}, a true filter has {low:.4g} to {high:.4g} '
                        f'in 95 % of all such studies{"" if inside else ": outside"}.')
        said += [f'{where}{word}: {count} runs.' for word, count in point['verdicts'].items()]
        said += [f'{where}{name} fails in {count} runs.'
                 for name, count in point['failed_tests'].items()]
    word, kind = ('The errors are as large as the covariance says.', 'yes') if fine else (
        'The errors are not as large as the covariance says, or chance has it so: one interval in '
        'twenty is missed by chance.', 'no')
    return section('verdict', 'Verdict', f'<p class="verdict {kind}">{word}</p>', items(said))


def _point(name: str, title: str, point: dict[str, Any]) -> PageSection:
    states, (low, high) = point['states'], point['ratio_interval_95']
    body = [[state, each['unit'], f'{each["rms"]:.3g}', f'{each["bound"]:.3g}',
             f'{each["ratio"]:.3f}', f'{each["sigma"]:.3g}', f'{each["prior"]:.1%}']
            for state, each in states.items()]
    return section(
        name, title, table(_HEAD, body),
        key([('curve', 'RMS over the Cramér-Rao bound'), ('band', '95 % of an efficient filter')]),
        charts([_ratios(list(states), [each['ratio'] for each in states.values()], low, high)]))


def _ratios(names: list[str], ratios: list[float], low: float, high: float) -> Chart:
    x = list(range(len(names)))
    ends, edge = [-0.5, len(names) - 0.5], {
        'mode': 'lines', 'line': {'width': 0}, 'fillcolor': PALE, 'hoverinfo': 'skip'}
    colors = [BLUE if low <= ratio <= high else RED for ratio in ratios]
    return chart(
        'RMS over bound', [
            go.Scatter(x=ends, y=[low, low], **edge),
            go.Scatter(x=ends, y=[high, high], fill='tonexty', **edge),
            go.Scatter(x=x, y=ratios, mode='markers', customdata=names,
                       marker={'color': colors, 'size': 8},
                       hovertemplate='%{customdata}: %{y:.3f}<extra></extra>')],
        '', '', wide=True, height=300, xaxis_tickvals=x, xaxis_ticktext=names)


def _sweep(points: Sequence[dict[str, Any]], swept: str) -> PageSection:
    """Return how RMS and bound of each state go with what was swept."""
    values = [point[swept] for point in points]
    numbers = all(isinstance(value, (int, float)) for value in values)
    x = values if numbers else list(range(len(values)))
    ticks: dict[str, Any] = {} if numbers else {
        'xaxis_tickvals': x, 'xaxis_ticktext': list(map(str, values))}
    drawn = [chart(
        f'{name} [{each["unit"]}]', [
            go.Scatter(x=x, y=[point['states'][name]['bound'] for point in points], mode='lines',
                       line={'color': GREY, 'width': 1, 'dash': 'dash'}),
            go.Scatter(x=x, y=[point['states'][name]['rms'] for point in points],
                       mode='lines+markers', line={'color': BLUE, 'width': 1},
                       marker={'color': BLUE, 'size': 5})],
        swept, '', yaxis_rangemode='tozero', **ticks)
        for name, each in points[0]['states'].items()]
    return section('sweep', f'Over {swept}', key([('curve', 'RMS'), ('dashed', 'bound')]),
                   charts(drawn))
