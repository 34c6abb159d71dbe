# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The truth and the sensors that see it.

Nothing that estimates may import this wing: belief stands above it, and shares models with it,
never objects.
"""
