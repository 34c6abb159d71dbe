# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes share: run loop, lossless flow, lifecycle, parameters, pacing."""
