# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera from still images of the sky: no gyro, and a clock only where there is air.

`pipeline` does all of it, from a folder of images, or a table of their stars, to the camera.
"""
