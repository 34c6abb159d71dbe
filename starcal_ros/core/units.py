# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion factors: one human unit in SI."""

import math

DEG = math.pi / 180.0                   # rad
ARCSEC = DEG / 3600.0                   # rad
DEG_PER_HOUR = DEG / 3600.0             # rad/s
SQRT_HOUR = 60.0                        # sqrt(s)
DEG_PER_SQRT_HOUR = DEG / SQRT_HOUR     # rad/sqrt(s)
NS = 1e-9                               # s
