# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mathematics on arrays: rotations, the camera, Kalman steps, the star's image, robust votes.

Nothing here knows a parameter, a file, a clock or any other wing; what needs a scenario stands
further down.
"""
