# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files to be edited: each value under what it means, its unit and what is allowed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import textwrap
from typing import Any

from starcal_ros.config.parameter import Parameter, groups
from starcal_ros.config.scenario import Scenario, parameters
from starcal_ros.config.shipped import config_file

_WIDTH = 95
_INSTRUMENT = ('camera.', 'mounting.', 'gyro.', 'star_tracker.', 'observer.velocity',
               'estimator.initial_sigma.', 'estimator.tolerance.')


def new_file(scenario: Scenario, title: str, text: str = '') -> str:
    """Return a commented ROS 2 parameter file; `parameter_file.parse` gives the scenario back.

    It has all of the instrument and its sigmas, and of the rest what is not as by default.

    Parameters
    ----------
    scenario : Scenario
    title, text : str
        What the instrument is, and why its numbers are what they are.
    """
    default, values = Scenario().flat(), scenario.flat()
    keys = [key for key, value in values.items()
            if value != () and (key.startswith(_INSTRUMENT) or value != default.get(key))]
    head = [*_comment(f'{title[0].upper()}{title[1:]}.'), *_comment(text)]
    return '\n'.join([
        '# yaml-language-server: $schema=' + config_file('parameters.schema.json').as_uri(),
        *head, '#', *_comment('What is not here has its default: `starcal config list` has all '
                              'parameters, `starcal config describe NAME` tells of one, '
                              '`starcal config check FILE` what is wrong or odd in a file.'),
        '/**:', '  ros__parameters:', *_lines(keys, values)]) + '\n'


def literal(value: Any) -> str:
    """Return a value in YAML as ROS 2 reads it: texts in quotes, each float with a point."""
    if isinstance(value, tuple):
        return f'[{", ".join(literal(item) for item in value)}]'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    text = repr(value)
    # With a point YAML 1.1 takes it for a number, too.
    return text.replace('e', '.0e') if 'e' in text and '.' not in text else text


def explained(parameter: Parameter) -> str:
    """Return what a parameter means, its unit and what is allowed, as a sentence."""
    spec = parameter.spec
    unit = f' [{spec.unit}]' if spec.unit else ''
    allowed = f'; {parameter.allowed}' if parameter.allowed else ''
    return f'{spec.text}{unit}{allowed}'


def _lines(keys: Iterable[str], values: dict[str, Any]) -> Iterator[str]:
    about = dict(groups(Scenario()))
    open_groups: tuple[str, ...] = ()
    for key in keys:
        *path, name = key.split('.')
        for depth in range(len(path)):
            group = tuple(path[:depth + 1])
            if group != open_groups[:depth + 1]:
                indent = '  ' * (depth + 2)
                yield from _comment(about['.'.join(group)], indent)
                yield f'{indent}{path[depth]}:'
        open_groups = tuple(path)
        indent = '  ' * (len(path) + 2)
        yield from _comment(explained(parameters()[key]), indent)
        yield f'{indent}{name}: {literal(values[key])}'


def _comment(text: str, indent: str = '') -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=f'{indent}# ',
                         subsequent_indent=f'{indent}# ', break_on_hyphens=False)
