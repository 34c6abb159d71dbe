# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From the pixels of an image to star centroids.

Which star a centroid shows is told in `identification`; images are simulated in `simulation`.
"""
