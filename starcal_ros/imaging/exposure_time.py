# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""When an image was taken, as its file says: EXIF of pictures, header of FITS.

A time is aware (UTC) where the file makes it one, and naive where it leaves the zone or the time
of the day open. What can not be read counts as not said: no image is refused for its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from typing import Any

from PIL import Image

from starcal_ros.core.utc import parse

_EXIF, _GPS = 0x8769, 0x8825                        # directories of a picture's tags
_ORIGINAL, _ORIGINAL_OFFSET, _ORIGINAL_FRACTION = 36867, 36881, 37521
_GPS_TIME, _GPS_DATE = 7, 29
_DATE_LENGTH = len('2026-07-02')


def of_exif(exif: Image.Exif) -> datetime | None:
    """Return when a picture was taken: its own time with a zone, else that of GPS, else without.

    The camera's DateTime is not taken: programs set it when they change a file.
    """
    tags = exif.get_ifd(_EXIF)
    local = _exif_time(tags.get(_ORIGINAL), tags.get(_ORIGINAL_FRACTION))
    if local is not None:
        try:
            offset = datetime.strptime(str(tags.get(_ORIGINAL_OFFSET)).strip('\0 '), '%z')
            return local.replace(tzinfo=offset.tzinfo).astimezone(timezone.utc)
        except (ValueError, OverflowError):
            pass
    return _gps_time(exif.get_ifd(_GPS)) or local


def of_fits(header: Mapping[str, Any]) -> datetime | None:
    """Return the middle of the exposure of a FITS image.

    That is DATE-AVG, or DATE-OBS with TIME-OBS (where it has no time of its own) and half of
    EXPTIME. Time scales other than UTC (TIMESYS) are not read.
    """
    from astropy.io.fits import VerifyError  # of a damaged card

    def card(*keys: str, default: object = '') -> object:
        for key in keys:
            with suppress(VerifyError):
                if key in header:
                    return header[key]
        return default

    if str(card('TIMESYS', default='UTC')).strip().upper() not in ('UTC', 'UT', 'GMT', 'UT1'):
        return None
    middle = _iso_time(card('DATE-AVG'))
    if middle is not None:
        return middle
    text = str(card('DATE-OBS')).strip()
    if len(text) == _DATE_LENGTH and 'TIME-OBS' in header:
        text += f'T{str(card("TIME-OBS")).strip()}'
    begin = _iso_time(text)
    if begin is None or begin.tzinfo is None:
        return begin
    try:
        return begin + timedelta(seconds=float(str(card('EXPTIME', 'EXPOSURE', default=0))) / 2.0)
    except (ValueError, OverflowError):
        return begin


def _iso_time(value: object) -> datetime | None:
    """Read an ISO 8601 time in UTC with any number of decimals; a date alone stays naive."""
    text = str(value).strip()
    try:
        when = parse(text)
    except ValueError:
        return None
    return when if len(text) == _DATE_LENGTH else when.replace(tzinfo=timezone.utc)


def _exif_time(value: object, fraction: object) -> datetime | None:
    try:
        when = datetime.strptime(str(value).strip('\0 '), '%Y:%m:%d %H:%M:%S')
    except ValueError:
        return None
    try:
        return when + _seconds('' if fraction is None else str(fraction).strip('\0 '))
    except (ValueError, OverflowError):
        return when


def _gps_time(tags: Mapping[int, Any]) -> datetime | None:
    try:
        day = datetime.strptime(str(tags[_GPS_DATE]).strip('\0 '), '%Y:%m:%d')
        hours, minutes, seconds = (float(value) for value in tags[_GPS_TIME])
        return day.replace(tzinfo=timezone.utc) + timedelta(hours=hours, minutes=minutes,
                                                            seconds=seconds)
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError):
        return None


def _seconds(fraction: str) -> timedelta:
    return timedelta(seconds=float(f'0.{fraction}') if fraction else 0.0)
