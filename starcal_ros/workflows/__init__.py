# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whole calibrations made of the parts: the bootstrap, still images, and the live suite.

What one method does alone is in `calibration` and `filter`.
"""
