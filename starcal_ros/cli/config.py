# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal config``: parameter files, made, checked and explained."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from typing import Any

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import put, say, show, show_json
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError, groups
from starcal_ros.config.presets import PRESETS, scenario
from starcal_ros.config.scenario import Scenario, parameters, unknown
from starcal_ros.files.output import write_text

DESCRIPTION = ('Make a parameter file, check one, or tell what parameters there are. Nodes and '
               'commands read the same files.')
_FOUND, _WRONG = 4, 2
_ASKED = ('camera.width', 'camera.height', 'camera.pixel_pitch_mm', 'camera.focal_length_mm',
          'mounting.fixed_angles_deg', 'gyro.rate_hz', 'gyro.arw_deg_sqrt_h',
          'star_tracker.rate_hz', 'star_tracker.exposure_s', 'star_tracker.centroid_sigma_px',
          'star_tracker.limiting_magnitude')
"""What a user is asked for: what a data sheet says."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    actions = parser.add_subparsers(dest='action', required=True, metavar='ACTION')

    def action(name: str, text: str, detail: str, json_too: bool = True
               ) -> argparse.ArgumentParser:
        made = actions.add_parser(name, help=text, description=detail)
        made.set_defaults(act=globals()[f'_{name}'], parser=made)
        if json_too:
            made.add_argument('--json', action='store_true', help='print JSON')
        return made

    new = action('new', 'write a file to begin with', 'Write a parameter file for an instrument '
                 'of a class, each value under what it means. In a terminal and without PRESET '
                 'it asks for the class and for what a data sheet says. '
                 + ' '.join(f'{name}: {preset.title}.' for name, preset in PRESETS.items()))
    new.add_argument('preset', metavar='PRESET', nargs='?', choices=PRESETS,
                     type=arguments.one_of([*PRESETS]),
                     help='class of the instrument: %(choices)s')
    value = new.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                             help='another value of a parameter; may be given several times')
    arguments.completed_by(value, lambda: (f'{key}=' for key in parameters()))
    new.add_argument('--out', metavar='FILE.yaml', help='file to write; default: print it')
    outputs.add_overwrite(new)
    check = action('check', 'tell what is wrong or odd in a file', 'Tell all errors of a '
                   'parameter file at once, for every node of the suite, and what is odd though '
                   'it is allowed: most often a unit, or two values that do not go together. '
                   'Exit status 0: neither; 4: odd; 2: wrong.')
    check.add_argument('file', metavar='FILE', help='parameter file')
    check.add_argument('--namespace', metavar='NS', help='namespace of the nodes')
    describe = action('describe', 'tell of a parameter or a group', 'Tell what a parameter means, '
                      'its type, unit and default, and what is allowed; or all of a group; or, '
                      'without NAME, which groups there are.')
    name = describe.add_argument('name', metavar='NAME', nargs='?',
                                 help='as in camera.width, or camera')
    arguments.completed_by(name, lambda: (*parameters(), *dict(groups(Scenario()))))
    listing = action('list', 'list all parameters', 'List the parameters, all or those of a '
                     'group, with default, unit and what is allowed.')
    name = listing.add_argument('name', metavar='GROUP', nargs='?',
                                help='as in estimator.tolerance')
    arguments.completed_by(name, lambda: dict(groups(Scenario())))
    action('schema', 'print the JSON schema of a file', 'Print the JSON schema of a parameter '
           'file, with which an editor completes and checks it.', False)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    return int(options.act(options))


def _new(options: argparse.Namespace) -> int:
    from starcal_ros.config.new_file import new_file
    outputs.claim([options.out], [], options.overwrite)
    name = options.preset or _ask_preset()
    wanted = {}
    for text in options.set:
        key, _, value = text.partition('=')
        wanted[key] = parameter_file.value(key, value)
    made = scenario(name).replace(wanted)
    if not options.preset:
        made = _ask_values(made, [key for key in _ASKED if key not in wanted])
    text = new_file(made, PRESETS[name].title, PRESETS[name].text)
    odd = [*_odd(made)]
    if options.out:
        write_text(options.out, text)
    elif not options.json:
        put(text.removesuffix('\n'))
    for each in odd:
        say(f'warning: {each}')
    show_json({'file': options.out, 'preset': name, 'parameters': made.flat(), 'odd': odd})
    return 0


def _ask_preset() -> str:
    from rich.console import Console
    from rich.prompt import Prompt
    console = Console(stderr=True)
    if not console.is_terminal:
        raise ConfigError(f'PRESET is needed where nobody can be asked: {", ".join(PRESETS)}')
    for name, preset in PRESETS.items():
        say(f'{name:8} {preset.title}')
    return Prompt.ask('Class of the instrument', choices=[*PRESETS], console=console)


def _ask_values(made: Scenario, keys: list[str]) -> Scenario:
    from rich.console import Console
    from rich.prompt import Prompt

    from starcal_ros.config.new_file import literal
    console = Console(stderr=True)
    say('Enter keeps what is in parentheses.')
    for key in keys:
        known, parameter = made.flat().get(key), parameters()[key]
        if known is None:               # the mounting is given in another way
            continue
        unit = f' [{parameter.spec.unit}]' if parameter.spec.unit else ''
        while True:
            text = Prompt.ask(_plain(f'{parameter.spec.text}{unit}'), default=literal(known),
                              console=console)
            try:
                made = made.replace({key: parameter_file.value(key, text)})
                break
            except ConfigError as error:
                say(str(error))
    return made


def _check(options: argparse.Namespace) -> int:
    errors: dict[str, None] = {}
    odd: dict[str, None] = {}
    said: list[tuple[str, ...]] = []
    for node in parameter_file.NODES:
        try:
            reading = parameter_file.read_file(options.file, (node,), options.namespace)
        except parameter_file.ParameterFileError as error:
            errors |= dict.fromkeys(error.errors)
        else:
            odd |= dict.fromkeys(_odd(reading.scenario))
            said.append(reading.notices)
    # What a section for one node leaves out is said of the others alone.
    notices = [text for text in (said[0] if said else ()) if all(text in each for each in said)]
    if options.json:
        show_json({'file': options.file, 'errors': [*errors], 'odd': [*odd], 'notices': notices})
    else:
        for kind, texts in (('error', errors), ('odd', odd), ('note', notices)):
            for text in texts:
                show(f'{kind}: {text}')
        if not errors and not odd:
            show(f'{options.file}: nothing wrong, nothing odd')
    return _WRONG if errors else _FOUND if odd else 0


def _odd(made: Scenario) -> Iterator[str]:
    from starcal_ros.config.odd import odd
    return (f'{each.parameter}: {each.text}' for each in odd(made))


def _describe(options: argparse.Namespace) -> int:
    from starcal_ros.config.parameter_page import described
    about = dict(groups(Scenario()))
    if options.name is None and not options.json:
        for name, text in about.items():
            show(f'{name:24} {text}')
        return 0
    for key in _print_json(options) if options.json else _chosen(options.name):
        show('\n'.join(described(key, parameters()[key])))
    return 0


def _list(options: argparse.Namespace) -> int:
    from rich.table import Table

    from starcal_ros.config.parameter_page import default_text
    if options.json:
        _print_json(options)
        return 0
    table = Table()
    for column in ('name', 'default', 'allowed', 'unit', 'meaning'):
        table.add_column(column, overflow='fold')
    for key in _chosen(options.name):
        parameter = parameters()[key]
        table.add_row(*(_plain(text) for text in (
            key, default_text(parameter), parameter.allowed, parameter.spec.unit,
            parameter.spec.text)))
    show(table)
    return 0


def _schema(options: argparse.Namespace) -> int:
    from starcal_ros.config.schema import schema
    put(json.dumps(schema(), indent=1))
    return 0


def _chosen(name: str | None) -> list[str]:
    """Return the parameters of a name: itself, those of a group, or all."""
    found = [key for key in parameters() if name in (None, key) or key.startswith(f'{name}.')]
    if not found:
        raise ConfigError(unknown(str(name), dict(groups(Scenario()))))
    return found


def _print_json(options: argparse.Namespace) -> tuple[()]:
    from starcal_ros.config.parameter_page import as_dict
    show_json([as_dict(key, parameters()[key]) for key in _chosen(options.name)])
    return ()


def _plain(text: str) -> Any:
    from rich.text import Text
    return Text(text)
