# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What of the user's assumptions the data deny, read from them before any filter runs.

`check.check` runs all: the stamps and the readings by themselves, the stars of single frames, and
how the camera turned from frame to frame beside what the gyros read. Each `finding.Finding` is one
sentence. What the motion does not show is not found: nothing is guessed.
"""
