# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Human units in SI: multiply to come in, divide to go out."""

import math

DEG = math.pi / 180.0                   # rad
ARCSEC = DEG / 3600.0                   # rad
DEG_PER_HOUR = DEG / 3600.0             # rad/s
DEG_PER_SQRT_HOUR = DEG / 60.0          # rad/sqrt(s)
NS = 1e-9                               # s
