# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How good the estimates are: the bound, consistency, Monte Carlo. Sees the truth.

What is compared with a paper is in `reproduction`.
"""
