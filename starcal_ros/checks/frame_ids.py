# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Frame names of the messages that say one thing and are used as another."""

from __future__ import annotations

from collections.abc import Iterator

from starcal_ros.checks.finding import Finding
from starcal_ros.files.foreign import clean
from starcal_ros.messages.conventions import GYRO_FRAME, INERTIAL_FRAME, OPTICAL_FRAME


def of_frame_ids(gyro: str | None, frames: str | None) -> Iterator[Finding]:
    """Yield frames that cannot be meant; another name for the right one is the user's own.

    Parameters
    ----------
    gyro, frames : str or None
        As the messages have them; None where there is no message.
    """
    if gyro is None or frames is None:
        return
    wrong = [(what, name, right) for what, name, right, never in (
        ('gyro readings', gyro, GYRO_FRAME, (OPTICAL_FRAME, INERTIAL_FRAME)),
        ('centroids', frames, OPTICAL_FRAME, (GYRO_FRAME, INERTIAL_FRAME))) if name in never]
    for what, name, right in wrong:
        yield Finding('frame_id', f"the {what} are in the frame '{clean(name)}', where "
                      f"'{right}' is asked for: what the frame is, its name does not change; the "
                      'transforms of others will be wrong', 'driver (frame_id)')
    if not wrong and gyro and gyro == frames:
        yield Finding('frame_id', 'gyro readings and centroids are both in the frame '
                      f"'{clean(gyro)}': the mounting is the transform between two frames, such "
                      f"as '{GYRO_FRAME}' and '{OPTICAL_FRAME}'", 'driver (frame_id)')
