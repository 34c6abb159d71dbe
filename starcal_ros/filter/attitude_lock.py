# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the stars hold the attitude, and what is done where they do not.

Where most stars are rejected for many frames in a row the attitude is lost, and is sought afresh
in the next frame. Before that, stars whose own gates can not judge them judge each other
(`acquisition`): where the prediction is wide, and where a turn was not seen by the gyro.
"""

from __future__ import annotations

from starcal_ros.core.arrays import Array
from starcal_ros.filter.acquisition import WIDE, AcquisitionError, acquire, agreed, is_torn, turned
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import SIGMA_ACQUIRED, Filter, Update
from starcal_ros.filter.frame_result import Counts
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Stars

_NAMED = 20                 # losses of the attitude that are named, at most


class AttitudeLock:
    """The hold that the stars have on the attitude of one run.

    Parameters
    ----------
    patience : int
        Frames in a row, most of whose stars are rejected, after which the attitude is lost.
    counts : Counts
        Where to count that it was found.
    notices : Notices
        Where to say what happened.

    Attributes
    ----------
    lost : bool
        Whether the attitude was lost before this frame, and found in it.
    """

    def __init__(self, patience: int, counts: Counts, notices: Notices) -> None:
        self.patience, self._counts, self._notices = patience, counts, notices
        self.lost = False
        self.hold()

    def hold(self) -> None:
        """Know that the stars agree with the attitude."""
        self._rejected_in_a_row = self._torn_in_a_row = 0

    def doubt(self) -> None:
        """Have the attitude sought afresh in the next frame."""
        self._rejected_in_a_row, self._torn_in_a_row = self.patience, 0

    @property
    def holds(self) -> bool:
        """Whether most of the last frame was used."""
        return self._rejected_in_a_row == 0

    @property
    def broken(self) -> bool:
        """Whether the attitude is to be sought afresh."""
        return self._rejected_in_a_row >= self.patience

    def begin(self, filter_: Filter, belief: Belief | None, frame: Stars, reading: Array,
              stamp_ns: int) -> tuple[Belief, Stars] | None:
        """Return a belief that a frame may correct, its attitude found afresh where it is lost."""
        if belief is not None and not self.broken and not bool(
                (belief.tracker_sigma > SIGMA_ACQUIRED).any()):
            return belief, frame
        try:
            found = acquire(filter_, belief, frame, reading)
        except AcquisitionError as error:
            self._notices.once('acquire', f'no attitude from the frame at {stamp_ns} ns: {error}')
            return None if belief is None else (belief, frame)
        self._counts.acquisitions += 1
        self.lost = belief is not None and self.broken
        self._rejected_in_a_row = 0
        if belief is not None and self._counts.acquisitions <= _NAMED:
            self._notices.say(f'attitude lost, found again at {stamp_ns} ns')
        return found

    def update(self, filter_: Filter, belief: Belief, frame: Stars,
               interval: Preintegrated | None, stamp_ns: int) -> tuple[Belief, Stars, Update]:
        """Update, and judge the stars by each other where their own gates can not."""
        update = filter_.update(belief, frame, judged=True, gyro=interval)
        torn = update.spread <= WIDE and is_torn(frame, update)
        self._torn_in_a_row = self._torn_in_a_row + 1 if torn else 0
        if update.spread > WIDE:
            belief, frame = agreed(filter_, belief, frame)
            update = filter_.update(belief, frame, judged=True, gyro=interval)
            if not update.accepted.any():
                self._notices.once('agree', f'the stars of the frame at {stamp_ns} ns do not '
                                   'agree with each other: not used')
        # What goes on for long is noise, no turn: the gates are right then.
        elif 0 < self._torn_in_a_row <= self.patience and (
                stars := turned(filter_, belief, frame)) is not None:
            self._notices.once('turned', f'the stars of the frame at {stamp_ns} ns agree on '
                               'a turn that the gyro did not see')
            frame = stars
            update = filter_.update(belief, frame, gated=False, judged=True, gyro=interval)
        return belief, frame, update

    def account(self, used: int, rejected: int, stamp_ns: int) -> None:
        """Know how many stars of a frame were used."""
        self._rejected_in_a_row = self._rejected_in_a_row + 1 if rejected > used else 0
        if self._rejected_in_a_row == self.patience and self._counts.acquisitions < _NAMED:
            self._notices.say(f'most stars rejected in {self.patience} frames up to '
                              f'{stamp_ns} ns: the attitude is sought afresh')
