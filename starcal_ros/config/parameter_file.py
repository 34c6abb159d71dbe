# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios as ROS 2 parameter files, read as rcl reads them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
import re
from typing import Any

import yaml

from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, from_flat


def _flatten(tree: Mapping[Any, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flatten(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


def parse(text: str, source: str) -> Scenario:
    """Read a ROS 2 parameter file from its text; `source` is named in errors."""
    try:
        document = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        where = getattr(error, 'problem_mark', None)
        line = f', line {where.line + 1}' if where else ''
        raise ConfigError(f'{source}{line}: not YAML: '
                          f'{getattr(error, "problem", error)}') from None
    try:
        tree = document['/**']['ros__parameters']
        values = dict(_flatten(tree))
    except (TypeError, KeyError, AttributeError):
        raise ConfigError(f'{source}: not a ROS 2 parameter file, needs "/**:" with '
                          '"ros__parameters:" below it') from None
    try:
        return from_flat(values)
    except ConfigError as error:
        raise ConfigError(f'{source}: {error}') from None


def load(path: str | Path) -> Scenario:
    """Read a scenario from a ROS 2 parameter file.

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
    return parse(text, str(path))


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


class _Loader(yaml.SafeLoader):                         # type: ignore[misc]  # no hints
    """With the floats of YAML 1.2, which rcl reads: 1e-3 has no point and no sign in YAML 1.1."""


_Loader.add_implicit_resolver('tag:yaml.org,2002:float', re.compile(
    r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$'), list('-+.0123456789'))


class _Quoted(str):
    """A string that is written in quotes: rcl reads a bare y, n, on or off as a bool."""


def _quoted(value: Any) -> Any:
    return _Quoted(value) if isinstance(value, str) else value


class _Dumper(yaml.SafeDumper):                         # type: ignore[misc]  # no hints
    pass


_Dumper.add_representer(_Quoted, lambda dumper, value: dumper.represent_scalar(
    'tag:yaml.org,2002:str', str(value), style="'"))
