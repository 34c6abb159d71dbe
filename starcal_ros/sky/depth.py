# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How deep a catalogue has to be for the stars of a field, and how deep the installed one is."""

from __future__ import annotations

import numpy as np

from starcal_ros.sky import catalog

WANTED = 40
"""Stars of the catalogue in a field that make it easy to recognise."""
LEAST = 6
"""Stars of the catalogue in a field below which it is seldom recognised."""

_SKY_DEG2 = 41253.0
_BRIGHT, _STARS, _GROWTH = 8.0, 41_000.0, 0.44  # stars of the sky to V 8, and decades a magnitude
_ALL = 20.0             # magnitude that no star of the catalogue reaches


def deepest() -> catalog.Catalog:
    """Return the deepest catalogue that is installed."""
    try:
        return catalog.load(_ALL)
    except ValueError:
        return catalog.load()


def limit_for(area_deg2: float) -> float:
    """Return the magnitude to which a field has WANTED stars, or as many as there are.

    Not less than the shipped catalogue.
    """
    wanted = int(WANTED * _SKY_DEG2 / area_deg2)
    if wanted <= len(catalog.load()):
        return catalog.SHIPPED_LIMIT
    magnitude = deepest().magnitude
    if wanted >= len(magnitude):
        return max(catalog.SHIPPED_LIMIT, float(magnitude.max()))
    return max(catalog.SHIPPED_LIMIT, float(np.partition(magnitude, wanted)[wanted]))


def stars_in(area_deg2: float) -> float:
    """Return how many stars of the deepest catalogue a field holds on average."""
    return len(deepest()) * area_deg2 / _SKY_DEG2


def needed(area_deg2: float) -> float:
    """Return about the magnitude to which a catalogue must go for WANTED stars in a field."""
    return float(_BRIGHT + np.log10(WANTED * _SKY_DEG2 / area_deg2 / _STARS) / _GROWTH)
