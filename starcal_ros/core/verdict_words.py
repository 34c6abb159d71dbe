# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The words of a verdict, of a calibration of both or of the camera alone."""

CONVERGED, NOT_YET, INCONSISTENT, LOST = 'converged', 'not yet', 'inconsistent', 'lost'
