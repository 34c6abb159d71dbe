# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors that the simulated sensors make and no estimator models, one a file, found by name.

What a file has::

    GROUP     group below ``truth`` that its parameters join: gyro, star_tracker, or a new one
    Config    frozen dataclass of its parameters, `Annotated[type, Spec(...)]`, by default off
    ON        {label: {parameter: value}}, settings with which it is on: columns of the budget
    ORDER     its place among all; optional, without it the source is behind those that have one
    NOTE      a sentence below the error budget; optional
    check     function of the scenario that raises ConfigError where values do not go together;
              optional

and one or more hooks, functions of the scenario that return what a sensor does with ::

    bias      stamps (n,)                 change of the gyro bias (n, 3), in g [rad/s]
    mounting  stamps (n,)                 rotation vector from the mean (n, 3), in s [rad]
    rate      stamps (n,), rates (n, 3)   rates that the gyros sense, in g [rad/s]
    readings  GyroSamples                 readings, bias and noise in them
    images    ImagedStars                  where the stars fall, and what shapes their noise
    frames    Frames                      frames, noise in them

(on the left what it takes, on the right what it returns), or None where the source is off. The
hook `frames` gets the catalogue of the stars as well. The sensors call them in the order of
`sources`, the last four once for each batch, one batch after the other; a run has to be the same
to the bit however it is cut into batches. Of all these, rendered images show `mounting` alone.

Every scenario is made of these files: what is slow to import (erfa, scipy) is imported in the
functions that need it.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

from starcal_ros.config.scenario import Scenario
from starcal_ros.config.truth import sources


def switched_on(hook: str, scenario: Scenario, *more: Any) -> list[Callable[..., Any]]:
    """Return what a hook of each source gives for a scenario, in order, but those that are off."""
    given = [getattr(source, hook)(scenario, *more) for source in sources()
             if hasattr(source, hook)]
    return [effect for effect in given if effect is not None]


def examples(source: ModuleType) -> dict[str, dict[str, Any]]:
    """Return the settings with which a source is on, by their label, as a scenario takes them."""
    return {label: {f'truth.{source.GROUP}.{name}': value for name, value in values.items()}
            for label, values in source.ON.items()}
