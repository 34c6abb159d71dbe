# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 parameter files as rcl reads them: sections, the nodes they are for, types of scalars.

A section is a path of names that ends in ``ros__parameters``; ``*`` stands for one name, ``**``
for any number of them. Those that match a node are for it, a later one over an earlier one. Types
are rcl's, not YAML 1.1's: ``y`` is true, ``1e-3`` a number, ``1:40.0`` and ``1_00.0`` are strings.

What rcl passes over without a word is an error here: a key that is given twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
import re
import sys
from typing import Any

import yaml

from starcal_ros.files.documents import BoundedLoader

PARAMETERS = 'ros__parameters'

_TRUE = {'Y', 'y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON'}
_FALSE = {'N', 'n', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF'}
_INTEGER = re.compile(r'[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)')
_FLOAT = re.compile(r'[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?')
_HEX_FLOAT = re.compile(
    r'[-+]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][-+]?[0-9]+)?')
_NO_NUMBER = re.compile(r'[-+]?(inf|infinity|nan)', re.IGNORECASE)
_DOTTED = re.compile(r'[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)')
_NAME = re.compile(r'[A-Za-z0-9_]+|\*\*?')
_STRING_TAG = 'tag:yaml.org,2002:str'


@dataclass(frozen=True)
class Section:
    """The parameters of one section, by dotted name; its own name begins with a slash."""

    name: str
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def node(self) -> str:
        """Return the last part of the name: a node, or a wildcard."""
        return self.name.rpartition('/')[2]

    @property
    def namespace(self) -> str | None:
        """Return the namespace, ``/`` for the root; None where a wildcard leaves it open."""
        return None if '*' in self.name else self.name.rpartition('/')[0] or '/'

    def matches(self, node: str) -> bool:
        """Tell whether the section is for a node, given with its namespace."""
        parts = {'**': r'(/\w+)*', '*': r'/\w+'}
        pattern = ''.join(parts.get(part, f'/{part}') for part in self.name.split('/')[1:])
        return re.fullmatch(pattern, node) is not None


def read(text: str) -> tuple[list[Section], list[str]]:
    """Return the sections of a parameter file, and the errors in it.

    Raises
    ------
    yaml.YAMLError
        Where the text is no YAML.
    """
    sections: list[Section] = []
    errors: list[str] = []
    loader = _Loader(text)
    try:
        while loader.check_node():
            sections += _sections(loader.get_node(), '', errors)
    finally:
        loader.dispose()
    names: set[str] = set()
    for section in sections:
        if section.name in names:
            errors.append(f'{section.name}: a section that is given twice')
        names.add(section.name)
    return sections, errors


def _sections(node: yaml.Node, name: str, errors: list[str]) -> Iterator[Section]:
    if not isinstance(node, yaml.MappingNode):
        errors.append(f'{_line(node)}: not a ROS 2 parameter file, needs "/**:" with '
                      f'"{PARAMETERS}:" below it')
        return
    for key, value in _pairs(node, '', errors):
        if key == PARAMETERS and name and isinstance(value, yaml.MappingNode):
            section = Section(name)
            for item, content in _values(value, '', errors):
                if item in section.values and content is not None:
                    errors.append(f'{item}: given twice in {name}')
                section.values[item] = content
            yield section
            continue
        parts = key.strip('/').split('/')
        if key != PARAMETERS and not all(_NAME.fullmatch(part) for part in parts):
            errors.append(f'{_line(value)}: {key!r} is no name of a node')
            continue
        yield from _sections(value, f'{name}/{"/".join(parts)}', errors)


def _values(node: yaml.MappingNode, prefix: str, errors: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield the parameters below a node, by dotted name."""
    for key, value in _pairs(node, prefix, errors):
        name = prefix + key
        if isinstance(value, yaml.MappingNode):
            if not value.value:
                yield name, None
            yield from _values(value, f'{name}.', errors)
        elif isinstance(value, yaml.ScalarNode):
            yield from _one(name, [value], errors)
        elif all(isinstance(item, yaml.ScalarNode) for item in value.value):
            if not value.value:
                yield name, []
            if items := [item for _, item in _one(name, value.value, errors)]:
                yield name, items
        else:
            errors.append(f'{name}: a list may hold nothing but values')


def _one(name: str, nodes: list[yaml.ScalarNode], errors: list[str]) -> Iterator[tuple[str, Any]]:
    for node in nodes:
        if not node.value and node.style not in ('"', "'"):
            errors.append(f'{name}: no value in {_line(node)}')
        else:
            yield name, scalar(node)


def _pairs(node: yaml.MappingNode, prefix: str, errors: list[str]
           ) -> Iterator[tuple[str, yaml.Node]]:
    """Yield the content of a mapping; its keys are names, whatever they look like."""
    lines: dict[str, str] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            errors.append(f'{_line(key)}: a list or a mapping can not be a name')
            continue
        if key.value in lines:
            errors.append(f'{prefix}{key.value}: given twice, in {lines[key.value]} and '
                          f'{_line(key)}')
        lines[key.value] = _line(key)
        yield key.value, value


def _line(node: yaml.Node) -> str:
    return f'line {node.start_mark.line + 1}'


def scalar(node: yaml.ScalarNode) -> bool | int | float | str:
    """Return the value of a scalar, of the type that rcl gives it."""
    text: str = node.value
    if node.style in ('"', "'") or node.tag == _STRING_TAG:
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        value = int(text, 16 if 'x' in text.lower() else 8 if text.lstrip('+-')[0] == '0' else 10)
        if -2**63 <= value < 2**63:
            return value
    if _DOTTED.fullmatch(text):
        return float(text.replace('.', ''))
    if _NO_NUMBER.fullmatch(text):
        return float(text)
    if _FLOAT.fullmatch(text):
        number, digits = float(text), re.split('[eE]', text)[0]
    elif _HEX_FLOAT.fullmatch(text):
        number, digits = _from_hex(text), re.split('[pP]', text)[0].lower().split('x')[1]
    else:
        return text
    # C's strtod, which rcl asks, refuses what is out of a double's range.
    is_zero = not re.search('[1-9a-fA-F]', digits)
    return number if is_zero or sys.float_info.min <= abs(number) < float('inf') else text


def _from_hex(text: str) -> float:
    try:
        return float.fromhex(text)
    except OverflowError:
        return float('inf')


class _Loader(BoundedLoader):
    """Nodes without types of their own, and without what rcl does not take."""

    def resolve(self, kind: type, value: str, implicit: Any) -> str:
        """Leave the type to `scalar`."""
        return ''

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse an alias."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.composer.ComposerError(
                None, None, f'ROS 2 takes no alias (*{event.anchor})', event.start_mark)
        return super().compose_node(parent, index)
