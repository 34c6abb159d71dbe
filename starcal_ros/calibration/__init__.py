# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Calibration methods, one a file: a recording goes in, estimates and their history come out."""
