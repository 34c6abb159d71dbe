# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the innovations are as large, and as free of pattern, as the covariance promises.

Model
-----
The innovation z of the stars that a frame uses, divided by their sigmas, has the covariance
``S = I + M M'`` (`core.kalman`), and A = d z / d theta, (2n, 3), is what a turn of the camera does
to it. The turn that fits it best takes its share out of the normalised innovation squared ::

    N = A' S^-1 A = L L',   e = L^-1 A' S^-1 z                                         (C.1)
    z' S^-1 z = e' e + rest,   e ~ N(0, I), 3 degrees of freedom;   rest: 2 n - 3

Gyro, attitude, bias and stamps act on e alone, centroids and camera on the rest: among some fifty
degrees of freedom an angular random walk that is three times too large hides, in its own three it
shows within minutes. Where the model is right the e of all frames are independent, so that their
squares, their mean, their correlation from frame to frame and that with the rate of the camera
have known distributions ::

    sum e'e ~ chi2(3 N),   sum e / sqrt(N) ~ N(0, I),   sum e_k . e_k-1 / sqrt(3 N) ~ N(0, 1)
    tau = sum w' A'S^-1 z / sum w' N w,   1 / sigma^2 = sum w' N w                     (C.2)

with w the rate of the camera, in s: tau is the time by which the frames disagree with the gyro, so
far as the states have not taken it up. Likewise each coordinate of a star, its innovation divided
by its own standard deviation, adds up to N(0, n) over n frames; the worst star is looked at.

All are two-sided. A statistic fails where chance gives its value, or one further out, less than
`ALARM` of the time. Runs are also cut into windows of `WINDOW` frames; of these the worst counts,
against `ALARM` for all of them together. Nobody knows a noise to per cents, and a calibration is
not biased by that, so the squares may be larger or smaller than stated by `MARGIN` beyond chance;
no margin is given to what biases it: mean, correlation, displaced stars.
"""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.statistic import ALARM, MARGIN, Statistic, chi2_beyond, normal_beyond
from starcal_ros.filter import arithmetic
from starcal_ros.filter.allowances import (DISPLACED, LEAST_OF_BIN, LEAST_OF_STAR, LOSSES,
                                           LOSSES_FRAMES, REJECTED, SCATTER, WINDOW)
from starcal_ros.filter.frame_innovation import (ALONG, CELLS, FRAMES, FREEDOM, LAG, MAGNITUDES,
                                                 PAIRS, RATE, REST, SUMS, TURN, E, FrameInnovation)

NOISE_TESTS = ('NIS of the turns', 'NIS of the rest', 'worst window of the turns',
               'worst window of the rest', 'correlation of turns from frame to frame')
"""What a noise that is not as stated fails, and need be nothing else."""


class InnovationTests:
    """The statistics of one run, at a constant cost a frame.

    Parameters
    ----------
    gated : float
        Mean of the squared residual of a star that passed the gate, over that of any star.
    """

    def __init__(self, gated: float) -> None:
        self._gated = gated
        self._run, self._window = np.zeros(SUMS), np.zeros(SUMS)
        # Of all windows the worst, in sigmas, turn and rest; and their number.
        self._worst = np.zeros(3)
        self._last = np.zeros(3)                            # e of the frame before,
        self._follows = np.zeros(1, np.bool_)               # where there was one
        self._stars = _Stars()
        self._bins = {'cell': _Bins.empty(CELLS * CELLS),
                      'magnitude': _Bins.empty(len(MAGNITUDES) + 1)}
        self._seen = np.zeros(3, np.int64)      # stars used and rejected, losses of the attitude

    @property
    def frames(self) -> int:
        """Number of frames taken."""
        return int(self._run[FRAMES])

    def add(self, frame: FrameInnovation) -> bool:
        """Take what a frame says; return whether it was the last of a window."""
        stars = self._stars
        arithmetic.tally(frame, self._run, self._window, self._last, bool(self._follows[0]),
                         stars.rows(frame.catalog_id), stars.frames, stars.sums,
                         *self._bins['cell'], *self._bins['magnitude'])
        self._follows[0] = True
        return self.end_window()

    def rows(self, catalog_id: Ints) -> Ints:
        """Return where some stars stand in `sums`."""
        return self._stars.rows(catalog_id)

    def sums(self) -> tuple[Any, ...]:
        """Return what `tally` adds to, for frames that are added in one go, and what it asks.

        The sums of the run and of the window, e of the frame before and whether there was one,
        frames and sums of each star, number and squares of each cell and each magnitude; the worst
        windows, and the stars used and rejected, which are counted there, too.
        """
        return (self._run, self._window, self._last, self._follows, self._stars.frames,
                self._stars.sums, *self._bins['cell'], *self._bins['magnitude'], self._worst,
                self._seen)

    def end_window(self) -> bool:
        """End the window where it is full; return whether it was."""
        if self._window[FRAMES] < WINDOW:
            return False
        self._worst[-1] += 1.0
        deviations = _beyond(
            self._window[[TURN, REST]] / (1.0, self._gated),
            np.array([3.0 * self._window[FRAMES], self._window[FREEDOM]]))
        for kind, deviation in enumerate(deviations.tolist()):
            if abs(deviation) > abs(self._worst[kind]):
                self._worst[kind] = deviation
        self._window[:] = 0.0
        return True

    def pass_over(self) -> None:
        """Know of a frame that tells nothing: the next one has no neighbour."""
        self._follows[0] = False

    def account(self, used: int, rejected: int, lost: bool) -> None:
        """Count the stars of a frame, and whether the attitude was lost before it."""
        self._seen += used, rejected, lost

    def statistics(self) -> tuple[Statistic, ...]:
        """Return all tests, of one frame at least."""
        turn, rest, lag, along, rate = self._run[[TURN, REST, LAG, ALONG, RATE]].tolist()
        n, freedom, pairs = self._run[[FRAMES, FREEDOM, PAIRS]].astype(int).tolist()
        far = normal_beyond(ALARM / 2.0)
        found: list[tuple[str, float, float, float, int]] = [
            ('NIS of the turns', turn / (3 * n), *_band(far, 3 * n), n),
            ('NIS of the rest', rest / (freedom * self._gated), *_band(far, freedom), n),
            ('mean of the turns', float(np.linalg.norm(self._run[E])) / np.sqrt(n), 0.0,
             float(np.sqrt(chi2_beyond(ALARM, 3))), n),
            ('correlation of turns from frame to frame', lag / np.sqrt(3.0 * pairs or 1.0),
             -far, far, n),
            ('turns along the rate', along / np.sqrt(rate or 1.0), -far, far, n)]
        windows = int(self._worst[-1])
        if windows:
            far = normal_beyond(ALARM / 2.0 / windows)
            found += [(f'worst window of the {what}', worst, -far, far, windows)
                      for what, worst in zip(('turns', 'rest'), self._worst.tolist())]
        worst, count = self._stars.worst()
        if count:
            far = normal_beyond(ALARM / 4.0 / count)
            found.append(('displacement of the worst star', worst, -far, far, count))
        used, rejected, losses = self._seen.tolist()
        found += [('share of rejected stars', rejected / max(used + rejected, 1), 0.0, REJECTED,
                   used + rejected),
                  ('losses of the attitude', losses, 0.0, LOSSES + n / LOSSES_FRAMES, n)]
        return (*(Statistic(name, float(value), float(low), float(high), samples)
                  for name, value, low, high, samples in found), *self._scatter())

    def _scatter(self) -> Iterator[Statistic]:
        """Yield the bins whose squares are furthest from those of all."""
        for name, bins in self._bins.items():
            which = np.flatnonzero(bins.number >= LEAST_OF_BIN)
            if len(which):
                freedom = np.asarray(2.0 * bins.number[which], np.float64)
                ratio = bins.squares[which] / (freedom * self._gated)
                deviation = _beyond(freedom * ratio, freedom, SCATTER)
                worst = int(np.argmax(np.abs(deviation)))
                far = normal_beyond(ALARM / 2.0 / len(which))
                yield Statistic(
                    f'scatter in the worst {name}', float(deviation[worst]), -far, far,
                    int(bins.number[which[worst]]),
                    fits=f'{ratio[worst]:.2f} times the stated variance '
                    + (cell_name(which[worst]) if name == 'cell' else
                       f'at magnitude {_magnitude_name(which[worst])}'))

    @property
    def variance_factors(self) -> tuple[float, float]:
        """How much larger than stated the variances of turn and rest are, of a frame at least."""
        run = self._run
        return (float(run[TURN] / (3.0 * run[FRAMES])),
                float(run[REST] / (run[FREEDOM] * self._gated)))


class _Stars:
    """The innovations of each star: how often it was used, and the sums of its coordinates."""

    def __init__(self) -> None:
        # Sorted, and behind all of them a number that no star has; its row is that of none.
        self._known, self._row = np.array([np.iinfo(np.int64).max]), np.zeros(1, np.int64)
        self.frames, self.sums = np.zeros(64), np.zeros((64, 2))

    def rows(self, catalog_id: Ints) -> Ints:
        """Return where some stars stand, room made for new ones."""
        place = np.searchsorted(self._known, catalog_id)
        if (self._known[place] != catalog_id).any():
            self._make_room(np.setdiff1d(catalog_id, self._known))
            place = np.searchsorted(self._known, catalog_id)
        return self._row[place]

    def _make_room(self, fresh: Ints) -> None:
        numbers = np.concatenate((self._known, fresh))
        rows = np.concatenate((self._row, np.arange(len(self._row), len(numbers))))
        order = np.argsort(numbers)
        self._known, self._row = numbers[order], rows[order]
        if len(rows) > len(self.frames):
            more = len(rows)                                # room for twice as many
            self.frames = np.append(self.frames, np.zeros(more))
            self.sums = np.append(self.sums, np.zeros((more, 2)), axis=0)

    def worst(self) -> tuple[float, int]:
        """Return the sum that is furthest off, as a normal deviate, and of how many stars."""
        often = np.flatnonzero(self.frames >= LEAST_OF_STAR)
        if not len(often):
            return 0.0, 0
        root = np.sqrt(self.frames[often])[:, None]
        sums = self.sums[often]
        beyond = np.maximum(np.abs(sums) / root - DISPLACED * root, 0.0).ravel()
        worst = int(beyond.argmax())
        return math.copysign(beyond[worst], sums.flat[worst]), len(often)


class _Bins(NamedTuple):
    """Number of the stars of some kinds, and sums of their squares."""

    number: Ints
    squares: Array

    @classmethod
    def empty(cls, n: int) -> _Bins:
        return cls(np.zeros(n, np.int64), np.zeros(n))


def cell_name(cell: int) -> str:
    """Say where a cell of the detector is."""
    return f'in cell {cell // CELLS + 1}, {cell % CELLS + 1} of the detector'


def _magnitude_name(kind: int) -> str:
    low, high = ('', *(f'{m:g}' for m in MAGNITUDES)), (*(f'{m:g}' for m in MAGNITUDES), '')
    return f'{low[kind]} to {high[kind]}'


def _beyond(value: Array, freedom: Array, margin: float = MARGIN) -> Array:
    """Return the deviates of chi-square numbers from their margin, 0 inside."""
    return np.asarray(np.maximum(_deviate(value / margin, freedom), 0.0) + np.minimum(
        _deviate(value * margin, freedom), 0.0))


def _band(far: float, freedom: int) -> tuple[float, float]:
    """Return what a chi-square over its degrees of freedom keeps, with the margin."""
    part = 2.0 / (9.0 * freedom)
    low, high = ((1.0 - part + sign * far * np.sqrt(part))**3 for sign in (-1.0, 1.0))
    return float(max(low, 0.0) / MARGIN), float(high * MARGIN)


def _deviate(value: Array, freedom: Array) -> Array:
    """Return normal deviates as probable as chi-square numbers (Wilson and Hilferty 1931)."""
    part = 2.0 / (9.0 * freedom)
    return np.asarray((np.cbrt(np.maximum(value, 0.0) / freedom) - 1.0 + part) / np.sqrt(part))
