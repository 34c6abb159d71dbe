# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""UTC as people write it."""

from datetime import datetime, timedelta, timezone
import re

_DECIMALS = re.compile(r'\.(\d+)')


def parse(text: str) -> datetime:
    """Return an ISO 8601 time with any number of decimals; aware where it states a zone but UTC.

    That is a Z, or the word, as `worded` writes it.

    Raises
    ------
    ValueError
        Where it is not such a time.
    """
    # Python 3.10 knows no Z, and 3 or 6 decimals only.
    return datetime.fromisoformat(_DECIMALS.sub(lambda part: f'.{part[1]:0<6.6}',
                                                text.removesuffix('Z').removesuffix(' UTC')))


def worded(text: str) -> str:
    """Return an ISO 8601 time, UTC unless it says otherwise, as one that says UTC by the word.

    YAML takes any other spelling for a time where it stands bare.

    Raises
    ------
    ValueError
        Where it is not such a time.
    """
    when = parse(text)
    if when.tzinfo is not None:
        when = when.astimezone(timezone.utc).replace(tzinfo=None)
    return f'{when.isoformat()} UTC'


def unix_ns(text: str) -> int:
    """Return an ISO 8601 time, UTC unless it says otherwise, as ns since the Unix epoch.

    Raises
    ------
    ValueError
        Where it is not such a time.
    """
    when = parse(text)
    if when.tzinfo is None:
        when = when.replace(tzinfo=timezone.utc)
    return (when - datetime(1970, 1, 1, tzinfo=timezone.utc)) // timedelta(microseconds=1) * 1000


def utc_text(stamp_ns: int) -> str:
    """Return a stamp, ns since the Unix epoch, as an ISO 8601 time to the second."""
    when = datetime(1970, 1, 1) + timedelta(seconds=stamp_ns // 10**9)
    return when.isoformat(timespec='seconds')
