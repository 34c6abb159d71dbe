# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of others and our own: written whole or not at all, read within limits.

`output` writes every result, `limits` says how much of a file is believed, `documents` reads YAML
and JSON within them, `foreign` makes text from outside harmless.
"""
