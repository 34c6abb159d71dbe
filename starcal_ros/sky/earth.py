# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the Earth is: ``epv00`` of ERFA on a grid of times, cubics in between.

A cubic meets place and velocity of two nodes, ten minutes apart, and keeps the Earth to 0.1 m and
0.1 mm/s. The grid does not depend on the stamps: a frame alone gets what it gets among thousands.
"""

from __future__ import annotations

from functools import lru_cache

import erfa
import numpy as np
from numpy.typing import ArrayLike

from starcal_ros.core.arrays import Array
from starcal_ros.sky.time_scales import DAY_NS, JD_1970, tt_ns

_NODE_NS = 600_000_000_000


def earth(stamp_ns: ArrayLike) -> tuple[Array, Array]:
    """Return where the Earth is and how it moves.

    Parameters
    ----------
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch [ns].

    Returns
    -------
    from_sun : (n, 3) array
        BCRS [au].
    barycentric : (n,) array of erfa.dt_pv
        Place and velocity [au, au/d].
    """
    node, rest_ns = np.divmod(tt_ns(stamp_ns), _NODE_NS)
    step = _NODE_NS / DAY_NS
    nodes, row = np.unique(node, return_inverse=True)
    states = np.array([(_earth_at(each), _earth_at(each + 1)) for each in nodes.tolist()])
    states = states.reshape(-1, 2, 2, 2, 3)[row]
    (p_0, v_0), (p_1, v_1) = (np.moveaxis(states[:, k], 1, 0) for k in range(2))
    s = (rest_ns / _NODE_NS)[:, None, None]
    place = (p_0 + s * s * (3.0 - 2.0 * s) * (p_1 - p_0)
             + s * (1.0 - s) * step * ((1.0 - s) * v_0 - s * v_1))
    velocity = (6.0 * s * (1.0 - s) * (p_1 - p_0) / step
                + (1.0 - s) * (1.0 - 3.0 * s) * v_0 + s * (3.0 * s - 2.0) * v_1)
    barycentric = np.empty(len(node), erfa.dt_pv)
    barycentric['p'], barycentric['v'] = place[:, 1], velocity[:, 1]
    return place[:, 0], barycentric


@lru_cache(maxsize=1024)
def _earth_at(node: int) -> Array:
    """Return place and velocity of the Earth at a node, (2, 2, 3) [au, au/d].

    The second axis: from the Sun, from the barycentre.
    """
    day, rest_ns = divmod(node * _NODE_NS, DAY_NS)
    states = erfa.epv00(JD_1970 + day, rest_ns / DAY_NS)
    return np.array([[state[name] for state in states] for name in ('p', 'v')])
