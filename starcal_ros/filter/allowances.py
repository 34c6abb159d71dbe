# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the model let pass beyond chance, and how much they ask for."""

WINDOW = 120
"""Frames of a window: a minute at 2 Hz."""
SCATTER = 1.5
"""Factor by which variances may be off where only the stars of one place or of one magnitude are
looked at; elsewhere it is MARGIN."""
DISPLACED = 0.2
"""Displacement of one star, in its sigmas, that is of no account."""
REJECTED = 0.6
"""Share of stars that the gate may reject: half may be wrong."""
LOSSES, LOSSES_FRAMES = 3, 7200
"""Losses of the attitude that may happen, and frames after which one more may: an hour at 2 Hz."""
HARM = 0.5
"""Shift of a state, in its sigmas, that is of no account."""
LEAST_OF_STAR, LEAST_OF_BIN = 20, 500
"""Frames of a star, and stars of a place or a magnitude, before they are looked at."""
