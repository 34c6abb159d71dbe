# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The tables and figures of the papers, and the simulations that they are made from.

How an estimator is judged is in `evaluation`; how a table or figure looks, in `report`.
"""
