# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""UTC as people write it."""

from datetime import datetime, timedelta, timezone


def unix_ns(text: str) -> int:
    """Return an ISO 8601 time, UTC unless it says otherwise, as ns since the Unix epoch.

    Raises
    ------
    ValueError
        Where it is not such a time.
    """
    when = datetime.fromisoformat(text.removesuffix('Z'))       # Python 3.10 knows no Z
    if when.tzinfo is None:
        when = when.replace(tzinfo=timezone.utc)
    return (when - datetime(1970, 1, 1, tzinfo=timezone.utc)) // timedelta(microseconds=1) * 1000
