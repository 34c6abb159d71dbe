# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which star is which: catalogue numbers for centroids, lost in space or tracked.

Centroids come from `imaging`. A camera is guessed here as far as identification needs it, and
calibrated elsewhere.
"""
