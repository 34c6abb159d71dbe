# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One scenario: every parameter, typed and validated, and the models that are made of it.

No equation of an estimator stands here, and no parameter stands anywhere else.
"""
