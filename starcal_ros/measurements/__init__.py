# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the sensors deliver, in order, and what every calibration makes of it first.

Readings and frames as arrays, which stamps are believed, gyro readings composed between frames,
the directions of stars and spots, the noise of a gyro at rest. Nothing here calibrates.
"""
