# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The scenario as ROS parameters: declared from `config.scenario`, read by every node alike.

A parameter without a value is not declared: it would empty rclpy's answer to who asks for all of
them, as `ros2 param dump` does. An empty list is a value. Times are declared with their UTC as a
word: `ros2 param load` takes a text that YAML knows as a time for one, and can not send it.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import (FloatingPointRange, IntegerRange, ParameterDescriptor,
                                SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from starcal_ros.config.parameter import ConfigError, Parameter as Declared
from starcal_ros.config.scenario import Scenario, from_flat, parameters, unknown
from starcal_ros.core import utc

_TYPES = {float: 'DOUBLE', int: 'INTEGER', bool: 'BOOL', str: 'STRING'}
_DOUBLES = (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)


class AnsweringNode(Node):
    """A node that says more of parameters that can not be set than rclpy does.

    To set a parameter to what it is succeeds, also where it is read-only, so that
    `ros2 param load` takes what `ros2 param dump` wrote.
    """

    def set_parameters_atomically(self, parameter_list: list[Parameter[Any]]
                                  ) -> SetParametersResult:
        """Set parameters together, those that are not what they are to be."""
        for name in (given.name for given in parameter_list):
            if not self.has_parameter(name):
                return SetParametersResult(successful=False, reason=(
                    f'{name}: this node has no value of it; give one where it is started'
                    if name in parameters() else unknown(name)))
        parameter_list = [self._as_declared(given) for given in parameter_list]
        changed = [given for given in parameter_list if not self._holds(given)]
        if not changed:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changed)

    def _as_declared(self, given: Parameter[Any]) -> Parameter[Any]:
        """Return numbers as numbers: `ros2 param` sends 1e-5, which has no point, as a text."""
        kind = self.get_parameter(given.name).type_
        if given.type_ == Parameter.Type.STRING and kind in _DOUBLES:
            try:
                values = [float(word) for word in given.value.strip('[] ').split(',')]
            except ValueError:
                return given
            if kind == Parameter.Type.DOUBLE_ARRAY:
                return Parameter(given.name, kind, values)
            if len(values) == 1:
                return Parameter(given.name, kind, values[0])
        return given

    def _holds(self, given: Parameter[Any]) -> bool:
        has, arrays = self.get_parameter(given.name), (list, array)
        if isinstance(has.value, arrays) and isinstance(given.value, arrays):
            # YAML does not tell the type of an empty list.
            return list(has.value) == list(given.value)
        return bool(has.type_ == given.type_ and has.value == given.value)


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
    scenario = from_flat({name: given.value for name, given in overrides.items()
                          if given.value is not None})      # as an empty list in a file is
    values = scenario.flat()
    for name, parameter in parameters().items():
        if name.split('.')[0] not in groups:
            continue
        value = values.get(name)
        if value == ():
            _declare_empty(node, name, parameter)
        elif value is not None:
            value = list(value) if isinstance(value, tuple) else value
            node.declare_parameter(name, utc.worded(value) if name.endswith('_utc') else value,
                                   _descriptor(parameter), ignore_override=True)
    return scenario


def _declare_empty(node: Node, name: str, parameter: Declared) -> None:
    """Declare an empty list, whose type rclpy can not tell from the value."""
    kind = Parameter.Type[_TYPES[parameter.element] + '_ARRAY']
    node.declare_parameter(name, kind, ignore_override=True)
    node.set_parameters([Parameter(name, kind, [])])
    descriptor = _descriptor(parameter)
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor)


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
