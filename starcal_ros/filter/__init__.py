# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The error-state filter of T18, and the calibrator that runs it on messages as they come.

Its states, belief, equations, options and verdict. Cameras without an attitude are calibrated in
`calibration`; where messages come from and go to is the matter of `nodes`, `cli` and `workflows`.
"""
