# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors that the simulated sensors make and no estimator models, one a file."""
