# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the stars are: the catalogue, apparent places, refraction by the air.

What an observer sees of them in a camera is not here, but in `measurements` and `simulation`.
"""
