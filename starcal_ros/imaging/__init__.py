# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From frames to centroids to catalogue numbers."""
