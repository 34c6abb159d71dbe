# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The frames of which a calibrator need know nothing but what they gave: many in one call.

Most frames are like the one before: the attitude is known, no interval has to be composed afresh,
the linear model holds, the stars agree, nothing ends. The compiled function does these one after
the other and stops before the first that is not so, having changed nothing by it. Whether a frame
is done so follows from what is believed before it alone, never from how many come at once: live
and offline, each alone or in thousands, the same bits come out.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.compiled import ready
from starcal_ros.filter import arithmetic, hypotheses
from starcal_ros.filter.acquisition import MIN_STARS, MOST_TORN, TORN, WIDE
from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import LARGEST_CORRECTION, SIGMA_ACQUIRED, Filter
from starcal_ros.filter.frame_result import FrameResults
from starcal_ros.filter.allowances import WINDOW
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.stretch import Constants, Gained, Intervals, StretchStars, Values
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Frames, Stars


def can_do(filter_: Filter) -> bool:
    """Tell whether the compiled function knows a filter: T18's states, with feedback."""
    return arithmetic.COMPILED and filter_.feedback and not filter_.augmentation.size


class OrdinaryFrames:
    """Some frames, with what the gyro says of the time before each.

    Parameters
    ----------
    gyro : Preintegrated
        An interval a frame.
    frames : Frames
    stars : Stars
        Theirs, with the sigmas that they have.
    """

    def __init__(self, gyro: Preintegrated, frames: Frames, stars: Stars) -> None:
        assert gyro.bias is not None
        self._intervals = Intervals(ready(gyro.Delta), ready(gyro.J), ready(gyro.duration),
                                    ready(gyro.gap_turn), ready(gyro.reading), ready(gyro.share),
                                    ready(gyro.bias[0]))
        self._frames, self._first = frames, frames.first
        self._stars = Stars(*map(ready, stars))
        self._magnitude = ready(frames.magnitude)
        self._made_of: tuple[Filter, ModelTests] | None = None

    def advance(self, k: int, most: int, filter_: Filter, belief: Belief, tests: ModelTests
                ) -> tuple[Gained, bool]:
        """Process frames from the k-th on.

        Parameters
        ----------
        k : int
        most : int
            Frames, at most.
        filter_ : Filter
            One that `can_do` knows.
        belief : Belief
            Before them.
        tests : ModelTests
            Whose sums they are added to; to be told of what came out (`ModelTests.met`).

        Returns
        -------
        found : Gained
            Of as many frames as were ordinary.
        look : bool
            Whether `ModelTests.answer` is to look at the last of them.
        """
        if self._made_of is None or filter_ is not self._made_of[0] or (
                tests is not self._made_of[1]):
            self._made_of, self._constants = (filter_, tests), _constants(filter_, tests)
        now, stars = belief.nominal, self._stars
        # No more than to the end of a window, of which the first frame may tell nothing.
        until = min(k + most, k + WINDOW + 1, len(self._frames))
        first = self._first[k:until + 1]
        low, high = int(first[0]), int(first[-1])
        rows = tests.rows(self._frames.catalog_id[low:high])
        out = Gained.room(until - k, high - low)
        done, look = arithmetic.advance(
            Values(*(part[None].copy() for part in (
                now.C_gi, now.bias, now.C_sg, now.intrinsics, belief.root))),
            self._constants,
            self._intervals.part(k, until),
            StretchStars(ready(self._frames.stamp_ns[k:until]), first - low, stars.u_i[low:high],
                         stars.uv[low:high], stars.sigma[low:high], self._magnitude[low:high],
                         rows),
            tests.sums(), out, until - k)
        return out.of(done, int(first[done]) - low), look

    def results(self, k: int, found: Gained, belief: Belief, track: AttitudeTrack
                ) -> FrameResults:
        """Return what the frames from the k-th on gave.

        Parameters
        ----------
        k : int
        found : Gained
            From `advance`.
        belief : Belief
            Before them.
        track : AttitudeTrack
            Before the first of them; more than one is done where there is none.
        """
        frames, n = self._frames, len(found.nis)
        rows = slice(self._first[k], self._first[k + n])
        after = Belief(
            belief.nominal.moved(found.C_gi, found.bias, found.C_sg, found.intrinsics,
                                 self._intervals.reading[k:k + n]),
            np.broadcast_to(belief.error, (n, len(belief.error))), found.root)
        return FrameResults(
            frames.stamp_ns[k:k + n], after, np.diff(self._first[k:k + n + 1]),
            frames.uv_raster[rows], found.residual, found.chi2, found.accepted,
            frames.catalog_id[rows], frames.sigma[rows], found.nis, found.turn, True, track)


def _constants(filter_: Filter, tests: ModelTests) -> Constants:
    detector, curvature = filter_.detector, filter_.model.curvature
    return Constants(
        ready(filter_.density), ready(filter_.scale), ready(curvature.shift),
        ready(curvature.second), ready(curvature.largest),
        np.array([0.5 * detector.width, 0.5 * detector.height]),
        hypotheses.hourly().copy(), float(filter_.walk), float(filter_.gap_acceleration),
        float(filter_.model.trail_s), float(detector.pitch_mm), float(filter_.model.cos_field),
        float(filter_.gate), not filter_.taken_as_linear, LARGEST_CORRECTION, SIGMA_ACQUIRED,
        WIDE, MOST_TORN, TORN, MIN_STARS, float(WINDOW), tests.gated, ready(tests.sizes))
