# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One assumption that the data deny: what was seen, what it points at, what would fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from starcal_ros.config.scenario import Scenario


@dataclass(frozen=True)
class Finding:
    """One wrong assumption.

    Attributes
    ----------
    kind : str
        What kind it is, the same text for all of a kind.
    sentence : str
        For the user: what was seen, and what would fit.
    points_at : str
        A parameter, or the driver that is to be mended.
    value, sigma : tuple of float
        What fits best, and how well that is known; in `unit`.
    unit : str
    parameters : mapping
        What a parameter file would say instead; None takes a parameter out of it.
    driver : mapping
        What the driver must do to its numbers, where no parameter can.
    gain : float, optional
        Twice the logarithm of the likelihood ratio that this explanation is worth.
    rival : str
        The explanation that does nearly as well as any other, and what it is worth.
    """

    kind: str
    sentence: str
    points_at: str
    value: tuple[float, ...] = ()
    sigma: tuple[float, ...] = ()
    unit: str = ''
    parameters: Mapping[str, Any] = field(default_factory=dict)
    driver: Mapping[str, Any] = field(default_factory=dict)
    gain: float | None = None
    rival: str = ''

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {'kind': self.kind, 'sentence': self.sentence, 'points_at': self.points_at,
                'value': list(self.value), 'sigma': list(self.sigma), 'unit': self.unit,
                'parameters': dict(self.parameters), 'driver': dict(self.driver),
                'gain': self.gain, 'rival': self.rival}


def proposed(scenario: Scenario, findings: Iterable[Finding]) -> Scenario:
    """Return the scenario with what the findings propose for its parameters."""
    from starcal_ros.config.scenario import from_flat
    values = scenario.flat()
    for finding in findings:
        for key, value in finding.parameters.items():
            if value is None:
                values.pop(key, None)
            else:
                values[key] = value
    return from_flat(values)
