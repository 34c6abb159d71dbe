# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a pure function gave last, given again: for runs that differ in their noise alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from typing import Any, TypeVar

import numpy as np

Function = TypeVar('Function', bound=Callable[..., Any])


def remembered(function: Function) -> Function:
    """Return a function that works out its answer only where it is not the one it gave last.

    Its arguments are arrays, dataclasses of such, and what can be compared; they are compared by
    value. The answer is an array or a tuple of arrays, which can not be written to.
    """
    last: list[tuple[Any, Any]] = []

    @wraps(function)
    def answer(*given: Any) -> Any:
        asked = tuple(map(_value, given))
        if last and last[0][0] == asked:
            return last[0][1]
        found = function(*given)
        for part in found if isinstance(found, tuple) else (found,):
            part.flags.writeable = False
        last[:] = [(asked, found)]
        return found
    return answer                   # type: ignore[return-value]


def _value(given: Any) -> Any:
    """Return what an argument is compared by."""
    if isinstance(given, np.ndarray):
        return given.shape, given.dtype.str, given.tobytes()
    if is_dataclass(given):
        return type(given), *(_value(getattr(given, each.name)) for each in fields(given))
    return given
