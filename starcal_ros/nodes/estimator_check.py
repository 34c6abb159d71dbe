# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The checks of `checks.check` over the first minutes of a live run, beside the estimator.

They take seconds, and so run in a thread of their own; the estimator does not wait for them.
"""

from __future__ import annotations

from collections import deque
from threading import Thread

from starcal_ros.checks.check import Checked, check
from starcal_ros.checks.finding import Finding
from starcal_ros.config.scenario import Scenario
from starcal_ros.measurements.samples import Frames, GyroSamples

AFTER_S = (120.0, 300.0)
"""Times of frames after which all that came is checked; then it is forgotten."""
KEPT_S = 1200.0
"""Time of readings that is kept while the frames do not come."""
SETTLED_S = 10.0
"""Time of frames after which a clock that was set back before a check would have been noticed."""


class FirstMinutes:
    """Keeps the first messages, checks them in time, and tells each kind of finding once.

    Messages of both sides of a clock that was set back, as by a recording that is played again,
    are not checked together: no driver is to blame for that.

    Parameters
    ----------
    scenario : Scenario
        As stated.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._gyro: deque[GyroSamples] = deque()
        self._frames: deque[Frames] = deque()
        self._readings = self._count = 0        # how many are kept
        self._most = round(KEPT_S * scenario.gyro.rate_hz)
        self._due = [round(seconds * scenario.star_tracker.rate_hz) for seconds in AFTER_S]
        self._settled = round(SETTLED_S * scenario.star_tracker.rate_hz)
        self._since = 0                         # frames since the last check began
        self._restarts = 0
        self._thread: Thread | None = None
        self._result: list[Checked] = []        # of the last check: one, once it is done
        self._said: set[str] = set()
        self.checked: Checked | None = None

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take readings as they arrived."""
        if self._due:
            self._gyro.append(samples)
            self._readings += len(samples)
            self._forget()

    def add_frames(self, frames: Frames) -> None:
        """Take frames as they arrived; check what came once there are enough."""
        self._since += len(frames)
        if not self._due:
            return
        self._frames.append(frames)
        self._count += len(frames)
        if self._count >= self._due[0] and not self._busy:
            self._due.pop(0)
            self._since = 0
            self._result = []
            messages = (GyroSamples.concatenate([*self._gyro]),
                        Frames.concatenate([*self._frames]))
            self._thread = Thread(
                target=self._check, args=(*messages, self._result), daemon=True)
            self._thread.start()
            if not self._due:
                self._clear()

    def restarted(self, restarts: int) -> None:
        """Forget what came before the clock was set back, that so many times by now."""
        if restarts > self._restarts:
            self._restarts = restarts
            if self._since < self._settled:     # the last check may have had some of both sides
                self._thread, self._result = None, []
            self._clear()

    def _clear(self) -> None:
        self._gyro.clear()
        self._frames.clear()
        self._readings = self._count = 0

    def _forget(self) -> None:
        """Forget the oldest readings where there are too many, and the frames of their time."""
        if self._readings <= self._most:
            return
        while self._readings > self._most and len(self._gyro) > 1:
            self._readings -= len(self._gyro.popleft())
        while self._frames and self._frames[0].stamp_ns[-1] < self._gyro[0].stamp_ns[0]:
            self._count -= len(self._frames.popleft())

    def take(self) -> list[Finding]:
        """Return what was found since the last call and not been told before."""
        if self._busy or not self._result or self._since < self._settled:
            return []
        self.checked = self._result.pop()
        fresh = [each for each in self.checked.findings if each.kind not in self._said]
        self._said |= {each.kind for each in fresh}
        return fresh

    @property
    def _busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _check(self, gyro: GyroSamples, frames: Frames, result: list[Checked]) -> None:
        result.append(check(gyro, frames, self._scenario))
