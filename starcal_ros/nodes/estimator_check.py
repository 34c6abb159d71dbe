# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The checks of `checks.check` over the first minutes of a live run, beside the estimator.

They take seconds, and so run in a thread of their own; the estimator does not wait for them.
"""

from __future__ import annotations

from threading import Thread

from starcal_ros.checks.check import Checked, check
from starcal_ros.checks.finding import Finding
from starcal_ros.config.scenario import Scenario
from starcal_ros.measurements.samples import Frames, GyroSamples

AFTER_S = (120.0, 300.0)
"""Times of frames after which all that came is checked; then it is forgotten."""


class FirstMinutes:
    """Keeps the first messages, checks them in time, and tells each kind of finding once.

    Parameters
    ----------
    scenario : Scenario
        As stated.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._gyro: list[GyroSamples] = []
        self._frames: list[Frames] = []
        self._count = 0
        self._due = [round(seconds * scenario.star_tracker.rate_hz) for seconds in AFTER_S]
        self._thread: Thread | None = None
        self._result: Checked | None = None
        self._said: set[str] = set()
        self.checked: Checked | None = None

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take readings as they arrived."""
        if self._due:
            self._gyro.append(samples)

    def add_frames(self, frames: Frames) -> None:
        """Take frames as they arrived; check what came once there are enough."""
        if not self._due:
            return
        self._frames.append(frames)
        self._count += len(frames)
        if self._count >= self._due[0] and not self._busy:
            self._due.pop(0)
            messages = GyroSamples.concatenate(self._gyro), Frames.concatenate(self._frames)
            self._thread = Thread(target=self._check, args=messages, daemon=True)
            self._thread.start()
            if not self._due:
                self._gyro, self._frames = [], []

    def take(self) -> list[Finding]:
        """Return what was found since the last call and not been told before."""
        if self._busy or self._result is None:
            return []
        self.checked, self._result = self._result, None
        fresh = [each for each in self.checked.findings if each.kind not in self._said]
        self._said |= {each.kind for each in fresh}
        return fresh

    @property
    def _busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _check(self, gyro: GyroSamples, frames: Frames) -> None:
        self._result = check(gyro, frames, self._scenario)
