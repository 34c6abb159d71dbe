# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a calibration gives and where it is kept: RESULT.json, exports, saved calibrations.

What a person reads of it is made in `report`.
"""
