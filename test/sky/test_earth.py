# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Earth between the nodes is where ERFA has it."""

import erfa
import numpy as np

from starcal_ros.sky.earth import earth
from starcal_ros.sky.time_scales import tt_julian_date


def test_the_earth_between_the_nodes_is_where_epv00_has_it():
    """To 0.1 m and 0.1 mm/s, 1e-7 arcsec of aberration, any time of a century."""
    rng = np.random.default_rng(1)
    stamp_ns = rng.integers(0, 100 * 365 * 86400, 300) * 10**9 + rng.integers(0, 10**9, 300)
    sun, found = earth(stamp_ns)
    heliocentric, barycentric = erfa.epv00(*tt_julian_date(stamp_ns))
    for left, right in ((sun, heliocentric['p']), (found['p'], barycentric['p'])):
        assert np.abs(left - right).max() * erfa.DAU < 0.1
    assert np.abs(found['v'] - barycentric['v']).max() * erfa.DAU / erfa.DAYSEC < 1e-4
