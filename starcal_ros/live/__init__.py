# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A calibration while it goes on: one account of what is heard of it, and its views.

::

    running estimator (nodes) ─┐
    recording of one ──────────┼──► heard.Seen ──┬──► terminal   `starcal watch`
    RESULT.json ───────────────┘                 └──► picture ──► server   `starcal serve`
"""
