# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The JSON schema of a parameter file, with which editors complete, explain and check it.

A file names it in a line ``# yaml-language-server: $schema=...``. It knows sections of any name
and depth, as ROS 2 does, and names that are joined by dots. What depends on several values, and
that a float needs a point, is beyond it: `starcal config check` tells that.
"""

from __future__ import annotations

from typing import Any

from starcal_ros.config.new_file import explained
from starcal_ros.config.parameter import Parameter, groups
from starcal_ros.config.rcl_yaml import PARAMETERS
from starcal_ros.config.scenario import ROS_OWN, Scenario, parameters

_TYPES = {float: 'number', int: 'integer', bool: 'boolean', str: 'string'}


def schema() -> dict[str, Any]:
    """Return the schema."""
    tree = _object('Parameters of the nodes of starcal_ros')
    for name, text in groups(Scenario()):
        *path, last = name.split('.')
        _at(tree, path)['properties'][last] = _object(text)
    for key, parameter in parameters().items():
        *path, last = key.split('.')
        _at(tree, path)['properties'][last] = _leaf(parameter)
        for depth in range(len(path)):
            dotted = '[.]'.join([*path[depth:], last])
            _at(tree, path[:depth])['patternProperties'][f'^{dotted}$'] = _leaf(parameter)
    for name in ROS_OWN:
        tree['patternProperties'][f'^{name.rstrip(".")}([.]|$)'] = {}
    section = {'type': 'object', 'properties': {PARAMETERS: {'$ref': '#/$defs/parameters'}},
               'additionalProperties': {'$ref': '#/$defs/section'}}
    return {'$schema': 'http://json-schema.org/draft-07/schema#',
            'title': 'Parameter file of starcal_ros', 'type': 'object',
            'additionalProperties': {'$ref': '#/$defs/section'},
            '$defs': {'section': section, 'parameters': tree}}


def _object(text: str) -> dict[str, Any]:
    return {'type': 'object', 'description': text, 'properties': {}, 'patternProperties': {},
            'additionalProperties': False}


def _at(tree: dict[str, Any], path: list[str]) -> dict[str, Any]:
    for name in path:
        tree = tree['properties'][name]
    return tree


def _leaf(parameter: Parameter) -> dict[str, Any]:
    spec, items = parameter.spec, dict[str, Any](type=_TYPES[parameter.element])
    if spec.choices:
        items['enum'] = list(spec.choices)
    elif parameter.element in (int, float):
        items |= {'minimum': spec.low, 'maximum': spec.high}
    leaf = items
    if parameter.is_array:
        leaf = {'type': 'array', 'items': items}
        if spec.length is not None:
            leaf |= {'minItems': spec.length, 'maxItems': spec.length}
    leaf['description'] = explained(parameter)
    if parameter.default not in (None, ()):
        leaf['default'] = (list(parameter.default) if parameter.is_array else parameter.default)
    return leaf
