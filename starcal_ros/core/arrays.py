# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arrays of numpy that the package speaks of, by short names for its hints."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Ints: TypeAlias = NDArray[np.int64]
