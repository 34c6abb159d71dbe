# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The scenario as ROS parameters: declared from `starcal_ros.config`, read by every node alike."""

from __future__ import annotations

import math
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from starcal_ros import config
from starcal_ros.config import Scenario

_TYPES = {float: 'DOUBLE', int: 'INTEGER', bool: 'BOOL', str: 'STRING'}
_ROS_OWN = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


def declare(node: Node, *groups: str) -> Scenario:
    """Declare the parameters of some groups, read-only, and return the whole scenario.

    One file serves all nodes, so every parameter in it is checked, also those of other groups.

    Parameters
    ----------
    node : Node
    groups : str
        First parts of the names to declare, such as ``camera``.

    Raises
    ------
    ConfigError
        For an unknown parameter, a wrong type or an impossible value.
    """
    overrides: dict[str, Parameter] = node._parameter_overrides     # rclpy has no public way
    scenario = config.from_flat({name: parameter.value for name, parameter in overrides.items()
                                 if not name.startswith(_ROS_OWN)})
    values = scenario.flat()
    for name, parameter in config.parameters().items():
        if name.split('.')[0] not in groups:
            continue
        value = values.get(name)
        if isinstance(value, tuple):
            value = list(value)
        if value is None or value == []:        # rclpy can not tell the type from the value
            kind = _TYPES[parameter.element] + ('_ARRAY' if parameter.is_array else '')
            value = Parameter.Type[kind]
        node.declare_parameter(name, value, _descriptor(parameter), ignore_override=True)
    return scenario


def _descriptor(parameter: config.Parameter) -> ParameterDescriptor:
    spec = parameter.spec
    limits: dict[str, Any] = {}
    if not parameter.is_array and math.isfinite(spec.low) and math.isfinite(spec.high):
        if parameter.element is float:
            limits['floating_point_range'] = [
                FloatingPointRange(from_value=spec.low, to_value=spec.high, step=0.0)]
        else:
            limits['integer_range'] = [
                IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)]
    return ParameterDescriptor(
        description=spec.text + (f' [{spec.unit}]' if spec.unit else ''), read_only=True,
        additional_constraints=f'one of {", ".join(spec.choices)}' if spec.choices else '',
        **limits)
