# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a parameter is: its type, unit, range and text, and the errors of a wrong value.

A group of parameters is a dataclass whose fields are ``Annotated[type, Spec(...)]`` and whose
docstring says what it is for; `declared` lists the parameters, `groups` the groups. A field of
type ``T | None`` may be left out.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from dataclasses import dataclass
import math
import types
import typing
from typing import Any, Union


class ConfigError(ValueError):
    """Parameters are unknown, of the wrong type or impossible; the message names them.

    Parameters
    ----------
    errors : str
        Each is a line of the message.
    """

    def __init__(self, *errors: str) -> None:
        super().__init__('\n'.join(errors))
        self.errors = errors


@dataclass(frozen=True)
class Spec:
    """What a parameter means, what is allowed, and whether a running node takes a new value."""

    text: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    length: int | None = None
    choices: tuple[str, ...] = ()
    changeable: bool = False


@dataclass(frozen=True)
class Parameter:
    """One declared parameter: its Python type, default and meaning."""

    kind: type
    optional: bool
    default: Any
    spec: Spec

    @property
    def is_array(self) -> bool:
        """Tell whether the value is a tuple."""
        return typing.get_origin(self.kind) is tuple

    @property
    def element(self) -> type:
        """Type of the value, of an array that of its elements."""
        element: type = typing.get_args(self.kind)[0] if self.is_array else self.kind
        return element

    @property
    def type_name(self) -> str:
        """The type in words, as in ``float`` or ``list of 3 float``."""
        name = self.element.__name__
        many = f'{self.spec.length} ' if self.spec.length else ''
        return f'list of {many}{name}' if self.is_array else name

    @property
    def allowed(self) -> str:
        """What is allowed, in words; '' for anything of the type."""
        spec = self.spec
        if spec.choices:
            return ', '.join(spec.choices)
        if self.element is int:
            return f'{int(spec.low)} to {int(spec.high)}'
        if self.element is float:
            return f'{spec.low:.15g} to {spec.high:.15g}'
        return ''

    def convert(self, key: str, value: Any) -> Any:
        """Return the value in its own type, lists as tuples; raise ConfigError otherwise."""
        if type(value).__module__ == 'numpy':       # which config need not import
            value = value.tolist()
        if self.is_array and isinstance(value, (list, tuple)):
            return tuple(self._scalar(key, item) for item in value)
        if self.is_array:
            raise ConfigError(f'{key}: got {value!r}, needs a list of {self.element.__name__}')
        return self._scalar(key, value)

    def _scalar(self, key: str, value: Any) -> Any:
        if type(value).__module__ == 'numpy':
            value = value.tolist()
        if type(value) is not self.element:
            hint = f'; write {value}.0' if self.element is float and type(value) is int else ''
            raise ConfigError(f'{key}: got {value!r} ({type(value).__name__}), '
                              f'needs a {self.element.__name__}{hint}')
        return value

    def check(self, key: str, value: Any) -> None:
        """Raise ConfigError where the value is outside what the Spec allows."""
        if value is None:
            return
        items = value if self.is_array else (value,)
        spec = self.spec
        if spec.length is not None and len(items) != spec.length:
            raise ConfigError(f'{key}: got {len(items)} values, needs {spec.length}')
        for item in items:
            if spec.choices and item not in spec.choices:
                raise ConfigError(
                    f'{key}: got {item!r}, allowed are {", ".join(map(repr, spec.choices))}')
            if self.element in (int, float) and not spec.low <= item <= spec.high:
                raise ConfigError(f'{key}: got {item}, allowed is '
                                  f'{spec.low:g} to {spec.high:g} {spec.unit}'.rstrip())


def declared(group: type, prefix: str = '', default: Any = None
             ) -> Iterator[tuple[str, Parameter]]:
    """Yield the parameters of a group, and of groups in it, by dotted name.

    Parameters
    ----------
    group : type
        A dataclass.
    prefix : str
        Put before each name.
    default : object, optional
        An instance that holds the defaults; those of the fields where it is not given.
    """
    hints = typing.get_type_hints(group, include_extras=True)
    for item in dataclasses.fields(group):
        key = prefix + item.name
        value = _default(item) if default is None else getattr(default, item.name)
        if dataclasses.is_dataclass(value):
            yield from declared(type(value), key + '.', value)
            continue
        base, spec = typing.get_args(hints[item.name])
        optional = typing.get_origin(base) in (Union, types.UnionType)
        if optional:
            base = next(arg for arg in typing.get_args(base) if arg is not types.NoneType)
        yield key, Parameter(base, optional, value, spec)


def groups(default: Any, prefix: str = '') -> Iterator[tuple[str, str]]:
    """Yield the groups of parameters in an instance, by dotted name, and what they are for."""
    for item in dataclasses.fields(default):
        value = getattr(default, item.name)
        if dataclasses.is_dataclass(value):
            text = (type(value).__doc__ or '').partition('\n')[0]
            yield prefix + item.name, text.rstrip('.').replace('``', '`')
            yield from groups(value, f'{prefix}{item.name}.')


def _default(item: dataclasses.Field[Any]) -> Any:
    factory = item.default_factory
    return item.default if factory is dataclasses.MISSING else factory()
