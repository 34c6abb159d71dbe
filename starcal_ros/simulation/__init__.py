# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The truth and the sensors that see it. No estimator may import this package."""
