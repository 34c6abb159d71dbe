# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Calibration methods, one a file; its name is the value of ``--method``.

What two methods share stands one folder up.
"""
