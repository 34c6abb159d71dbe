# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The page of all parameters in the documentation, and what is told of one in a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from starcal_ros.config.new_file import literal
from starcal_ros.config.parameter import Parameter, groups
from starcal_ros.config.presets import PRESETS
from starcal_ros.config.scenario import Scenario, parameters

_HEAD = """# Parameters

<!-- Written by scripts/make_parameters.py from starcal_ros/config: change that, not this page. -->

A scenario is one ROS 2 parameter file, which nodes (`--params-file`) and commands (`--config`)
read alike. What it leaves out has its default.

* `starcal config new PRESET` writes a file to begin with, `--out FILE`:
{presets}
* `starcal config check FILE` tells all errors at once, and what is odd though it is allowed.
* `starcal config describe NAME` tells of a parameter or a group, `starcal config list` lists all.
* An editor completes and checks a file by its schema, `config/parameters.schema.json`. Where the
  YAML language server runs, this line in the file does it, with the path of the schema:
  `# yaml-language-server: $schema=parameters.schema.json`.

Numbers are of two types, as in ROS 2: a `float` has a point or an exponent (`100.0`, `1e-5`), an
`int` has none. Names may be nested or joined by dots. A running node takes a new value of what is
marked **live** (`ros2 param set`).

"""

_TABLE = '| name | type | default | allowed | meaning |\n|---|---|---|---|---|\n'


def page() -> str:
    """Return the page in Markdown."""
    presets = '\n'.join(f'  * `{name}`: {preset.title}' for name, preset in PRESETS.items())
    lines = [_HEAD.format(presets=presets)]
    about = {'': 'Of the managed nodes', **dict(groups(Scenario()))}
    for group, text in about.items():
        rows = [_row(key, parameter) for key, parameter in parameters().items()
                if key.rpartition('.')[0] == group]
        if rows:
            title = f'`{group}`' if group else 'Without a group'
            lines.append(f'## {title}\n\n{text}.\n\n{_TABLE}' + '\n'.join(rows) + '\n')
    return '\n'.join(lines)


def as_dict(key: str, parameter: Parameter) -> dict[str, Any]:
    """Return what is known of a parameter, for JSON."""
    spec = parameter.spec
    bounded = parameter.element in (int, float)
    return {'name': key, 'text': spec.text, 'type': parameter.type_name, 'unit': spec.unit,
            'default': parameter.default, 'may_be_left_out': parameter.optional,
            'low': spec.low if bounded else None, 'high': spec.high if bounded else None,
            'length': spec.length, 'choices': list(spec.choices), 'live': spec.changeable}


def described(key: str, parameter: Parameter) -> Iterator[str]:
    """Yield lines that tell of one parameter, for a terminal."""
    spec, unit = parameter.spec, f' {parameter.spec.unit}' if parameter.spec.unit else ''
    yield key
    yield f'  {spec.text}'
    yield f'  type     {parameter.type_name}{"; may be left out" if parameter.optional else ""}'
    yield f'  default  {default_text(parameter)}'
    if parameter.allowed:
        yield f'  allowed  {parameter.allowed}{unit}'
    elif unit:
        yield f'  unit    {unit}'
    yield ('  running  a node takes a new value: ros2 param set NODE ' + key
           if spec.changeable else '  running  read when a node starts')


def default_text(parameter: Parameter) -> str:
    """Return the default as a parameter file has it."""
    if parameter.default is None:
        return 'left out'
    return literal(parameter.default)


def _row(key: str, parameter: Parameter) -> str:
    spec = parameter.spec
    unit = f' [{spec.unit}]' if spec.unit else ''
    live = ' **live**' if spec.changeable else ''
    allowed = ', '.join(f'`{choice}`' for choice in spec.choices) or parameter.allowed
    cells = (f'`{key}`', parameter.type_name, f'`{default_text(parameter)}`', allowed,
             f'{spec.text}{unit}{live}')
    return '| ' + ' | '.join(cell.replace('|', '\\|') for cell in cells) + ' |'
