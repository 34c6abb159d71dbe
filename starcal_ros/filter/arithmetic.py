# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of frames and between them: compiled where numba is installed, else by numpy.

The first import compiles, `python -m starcal_ros.filter.arithmetic` at installation. Its functions
take one leading axis, the runs; `LeadingAxes` leads there and back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.compiled import say_uncompiled

try:
    from starcal_ros.filter.kernel import (COMPILED, advance, bends, carry, compose, correct,
                                           fit, judge, propagate, tally)
    from starcal_ros.filter.track_kernel import integrate, spread
except Exception as error:
    say_uncompiled('the filter', error)
    from starcal_ros.filter.reference import (COMPILED, advance, bends, carry, compose, correct,
                                              fit, judge, propagate, tally)
    from starcal_ros.filter.track_reference import integrate, spread

__all__ = ['COMPILED', 'LeadingAxes', 'advance', 'bends', 'carry', 'compose', 'correct', 'fit',
           'integrate', 'judge', 'propagate', 'spread', 'tally']


class LeadingAxes:
    """Takes arrays of a batch to arrays with one leading axis, the runs, and back.

    Parameters
    ----------
    batch : tuple of int
        Leading axes.
    """

    def __init__(self, batch: tuple[int, ...]) -> None:
        self._batch = batch

    def __call__(self, part: NDArray[Any], axes: int) -> NDArray[Any]:
        """Return an array with its last axes behind the runs.

        Of the same memory, but for what is the same for all runs.
        """
        own = part.shape[part.ndim - axes:]
        if part.shape != self._batch + own:
            part = np.broadcast_to(part, self._batch + own)
        if not self._batch:
            return part[None]
        return part if len(self._batch) == 1 else part.reshape((-1, *own))

    def back(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return an array of runs with the leading axes of the batch."""
        if not self._batch:
            return part[0]
        return part if len(self._batch) == 1 else part.reshape(self._batch + part.shape[1:])
