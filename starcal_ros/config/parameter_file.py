# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios as ROS 2 parameter files, read as the nodes would that the reader stands for.

The sections of a file are for nodes (`rcl_yaml`). A command stands for one node, or for several
that share one scenario, in one namespace: that of the file where it names the node in one only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import difflib
from pathlib import Path
from typing import Any

import yaml

from starcal_ros.config import rcl_yaml
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.rcl_yaml import Section
from starcal_ros.config.scenario import Scenario, from_flat, parameters, unknown
from starcal_ros.files.documents import DocumentError, bounded_yaml

NODES = ('star_tracker_sim', 'gyro_sim', 'estimator', 'intrinsics_estimator',
         'centroid_extractor', 'star_identifier', 'recorder', 'player')
"""The nodes of the suite that have parameters."""


class ParameterFileError(ConfigError):
    """What is wrong with a parameter file; `errors` has each thing by itself."""

    def __init__(self, source: str, *errors: str) -> None:
        super().__init__(f'{source}: {errors[0]}' if len(errors) == 1 else '\n  '.join(
            [f'{source}: {len(errors)} errors:', *errors]))
        self.errors = errors


@dataclass(frozen=True)
class Reading:
    """A scenario, and what a user should know of the file that it was read from."""

    scenario: Scenario
    notices: tuple[str, ...]


def read(text: str, source: str, nodes: Sequence[str] = ('estimator',),
         namespace: str | None = None) -> Reading:
    """Read a ROS 2 parameter file from its text.

    Parameters
    ----------
    text : str
    source : str
        Is named in errors.
    nodes : sequence of str
        Whose parameters are wanted; all must have the same.
    namespace : str, optional
        Of these nodes; without it that of the only section which names one of them, or the root.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    try:
        with bounded_yaml(text):
            sections, errors = rcl_yaml.read(text)
    except DocumentError as error:
        line = f', line {error.line}' if error.line else ''
        raise ConfigError(f'{source}{line}: {error}') from None
    if not sections:
        raise ConfigError(f'{source}: not a ROS 2 parameter file, needs "/**:" with '
                          f'"{rcl_yaml.PARAMETERS}:" below it')
    if namespace is None:
        namespace = _namespace(sections, nodes, source)
    errors += _empty(sections)
    prefix = '/' + namespace.strip('/') + '/' if namespace.strip('/') else '/'
    names = [prefix + node for node in nodes]
    values = _joined(sections, names, errors)
    try:
        scenario = from_flat(values)
    except ConfigError as error:
        errors += error.errors
    if errors:
        raise ParameterFileError(source, *errors)
    return Reading(scenario, tuple(_notices(sections, names, scenario, source)))


def read_file(path: str | Path, nodes: Sequence[str] = ('estimator',),
              namespace: str | None = None) -> Reading:
    """Read a ROS 2 parameter file, as `read` does.

    Raises
    ------
    ConfigError
        Where the file cannot be read or holds anything that is not allowed.
    """
    try:
        text = Path(path).read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else 'not a text file'
        raise ConfigError(f'{path}: cannot be read: {reason}') from None
    return read(text, str(path), nodes, namespace)


def value(key: str, text: str) -> Any:
    """Return the value of a parameter from a text, as it stands in a file; a float needs no point.

    Raises
    ------
    ConfigError
        Where there is no such parameter, or it can not have this value.
    """
    if key not in parameters():
        raise ConfigError(unknown(key))
    parameter = parameters()[key]
    try:
        with bounded_yaml(text):
            sections, errors = rcl_yaml.read(f'/**: {{{rcl_yaml.PARAMETERS}: {{{key}: {text}}}}}')
    except DocumentError as error:
        raise ConfigError(f'{key}: got {text!r}: {error}') from None
    if errors or not sections or sections[0].values.get(key, []) == []:
        raise ConfigError(f'{key}: got {text!r}, needs a {parameter.type_name}')
    found = sections[0].values[key]
    if parameter.element is float:
        found = ([_as_float(item) for item in found] if isinstance(found, list)
                 else _as_float(found))
    found = parameter.convert(key, found)
    parameter.check(key, found)
    return found


def _as_float(value: Any) -> Any:
    return float(value) if type(value) is int else value


def parse(text: str, source: str) -> Scenario:
    """Return the scenario of the estimator from the text of a file, as `read` does."""
    return read(text, source).scenario


def load(path: str | Path) -> Scenario:
    """Return the scenario of the estimator from a file, as `read_file` does."""
    return read_file(path).scenario


def _empty(sections: Sequence[Section]) -> list[str]:
    """Leave out empty lists, and return the errors of those that would say something.

    `ros2 param dump` writes them. A node takes one for nothing, which is its default here.
    """
    errors = []
    for section in sections:
        for key in [key for key, value in section.values.items() if value == []]:
            del section.values[key]
            known = parameters().get(key)
            said = any(each.values.get(key) for each in sections)
            if known is None or known.default != () or said:
                errors.append(f'{key}: an empty list has no type in ROS 2, leave it out')
    return errors


def _namespace(sections: Sequence[Section], nodes: Sequence[str], source: str) -> str:
    found = sorted({section.namespace for section in sections
                    if section.node in nodes and section.namespace is not None})
    if len(found) > 1:
        raise ConfigError(f'{source}: has sections for {" or ".join(nodes)} in the namespaces '
                          f'{", ".join(found)}; --namespace tells which is meant')
    return found[0] if found else '/'


def _joined(sections: Sequence[Section], names: Sequence[str], errors: list[str]
            ) -> dict[str, Any]:
    """Return what the nodes are told, by dotted name; they must be told the same."""
    told: dict[str, dict[str, Any]] = {name: {} for name in names}
    for section in sections:
        for name in names:
            if section.matches(name):
                told[name].update(section.values)
    joined: dict[str, Any] = {}
    by: dict[str, str] = {}
    for name, values in told.items():
        for key, value in values.items():
            if repr(joined.setdefault(key, value)) != repr(value):
                errors.append(f'{key}: is {joined[key]} for {by[key]} and {value} for {name}, '
                              'which must agree here')
            by.setdefault(key, name)
    return joined


def _notices(sections: Sequence[Section], names: Sequence[str], scenario: Scenario, source: str
             ) -> Iterator[str]:
    if names[0].count('/') > 1:
        yield f'{source} is read for {" and ".join(names)}'
    nodes = {name.rpartition('/')[2] for name in names}
    for section in sections:
        if any(map(section.matches, names)) or section.node in NODES and section.node not in nodes:
            continue
        near = difflib.get_close_matches(section.node, NODES, n=1, cutoff=0.8)
        if section.node in nodes or '*' in section.node:
            yield (f'{source}: the section {section.name} is not for {" and ".join(names)}; '
                   '--namespace names another namespace')
        elif near:
            yield f'{source}: the section {section.name} is not read; did you mean {near[0]}?'
    mounting = scenario.mounting
    if mounting.fixed_angles_deg is None and mounting.quaternion_xyzw is None:
        yield (f'{source} leaves out the mounting: the axes of the gyro are taken for those of '
               'the star tracker (mounting.fixed_angles_deg: [0.0, 0.0, 0.0])')


def dump(scenario: Scenario) -> str:
    """Return the scenario as a ROS 2 parameter file; `parse` gives it back."""
    tree: dict[str, Any] = {}
    for key, value in scenario.flat().items():
        if isinstance(value, tuple) and not value:
            continue                # an empty list has no type, rclpy would refuse it
        *path, name = key.split('.')
        branch = tree
        for part in path:
            branch = branch.setdefault(part, {})
        branch[name] = [_quoted(item) for item in value] if isinstance(value, tuple) else (
            _quoted(value))
    return yaml.dump({'/**': {'ros__parameters': tree}}, Dumper=_Dumper, sort_keys=False)


class _Quoted(str):
    """A string that is written in quotes: rcl reads a bare y, n, on or off as a bool."""


def _quoted(value: Any) -> Any:
    return _Quoted(value) if isinstance(value, str) else value


class _Dumper(yaml.SafeDumper):                         # type: ignore[misc]  # no hints
    pass


_Dumper.add_representer(_Quoted, lambda dumper, value: dumper.represent_scalar(
    'tag:yaml.org,2002:str', str(value), style="'"))
