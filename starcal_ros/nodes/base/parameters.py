# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The scenario as ROS parameters: declared from `config.scenario`, read by every node alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import (FloatingPointRange, IntegerRange, ParameterDescriptor,
                                SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from starcal_ros.config.parameter import ConfigError, Parameter as Declared
from starcal_ros.config.scenario import Scenario, from_flat, parameters

_TYPES = {float: 'DOUBLE', int: 'INTEGER', bool: 'BOOL', str: 'STRING'}


def declare(node: Node, *groups: str) -> Scenario:
    """Declare the parameters of some groups and return the whole scenario.

    All are read-only but those that are changeable; see `follow`.

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
    scenario = from_flat({name: given.value for name, given in overrides.items()})
    values = scenario.flat()
    for name, parameter in parameters().items():
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


def follow(node: Node, scenario: Scenario, on_change: Callable[[Scenario], None]) -> None:
    """Call back with the scenario that `ros2 param set` makes of it, if that is a valid one.

    Parameters that are set together are judged together; a refusal says what is allowed.
    """
    def changed(given: list[Parameter[Any]]) -> Scenario:
        return scenario.replace({parameter.name: parameter.value for parameter in given})

    def judge(given: list[Parameter[Any]]) -> SetParametersResult:
        try:
            changed(given)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def use(given: list[Parameter[Any]]) -> None:
        nonlocal scenario
        before, scenario = scenario, changed(given)
        if scenario != before:
            on_change(scenario)

    node.add_on_set_parameters_callback(judge)
    node.add_post_set_parameters_callback(use)


def _descriptor(parameter: Declared) -> ParameterDescriptor:
    spec, limits = parameter.spec, {}
    constraints = [f'one of {", ".join(spec.choices)}'] if spec.choices else []
    bounded = parameter.element in (int, float)
    if parameter.is_array:              # a range of ROS 2 is that of one number
        constraints += [f'{spec.length} values'] if spec.length else []
        constraints += [f'each {spec.low:g} to {spec.high:g}'] if bounded else []
    elif parameter.element is float:
        limits['floating_point_range'] = [
            FloatingPointRange(from_value=spec.low, to_value=spec.high, step=0.0)]
    elif parameter.element is int:
        limits['integer_range'] = [
            IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)]
    return ParameterDescriptor(
        description=spec.text + (f' [{spec.unit}]' if spec.unit else ''),
        read_only=not spec.changeable, additional_constraints=', '.join(constraints), **limits)
