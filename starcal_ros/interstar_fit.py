# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One camera from many windows of spots: Newton's method on the sum of their equations.

A window is linearised anew only when the camera has moved by `STALE` sigmas since, so that the
camera can be asked for again and again while windows are added. There is no prior: what the stars
do not tell stays unknown, and a fit that knows an intrinsic less well than `Fit.largest` says
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros import interstar
from starcal_ros.camera import Detector

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STALE = 0.1
MISFIT = 8.0
"""A spot does not fit that misses by so many sigmas, or by so many times what most miss by."""

_STEPS = 30
_SCREENINGS = 8
_RAYLEIGH = 1.1774      # median of the length of a normal vector in two dimensions


class Sums(NamedTuple):
    """The equations of a window, linearised.

    Attributes
    ----------
    at : (K,) array
        The intrinsics estimated, where this is.
    value, matrix, noise : (K,), (K, K), (K, K) array
        As in `interstar`.
    """

    at: Array
    value: Array
    matrix: Array
    noise: Array


@dataclass
class Window:
    """Spots that are compared with one another.

    Attributes
    ----------
    uv : (..., NF, NS, 2) array
        Spots, from the centre of the detector [px].
    sigma : (..., NF, NS) array
        Their standard deviations [px].
    seen : (..., NF, NS) bool array
        Which there are, less those that do not fit.
    u_i : (..., NS, 3) array, optional
        Their places in the catalogue; the leading axis is that of the frames then, and NF is 1.
    sums : Sums, optional
        What they said when they were linearised last.
    screened : bool
        Whether all that are seen fit.
    """

    uv: Array
    sigma: Array
    seen: Mask
    u_i: Array | None = None
    sums: Sums | None = None
    screened: bool = False

    @property
    def cosines(self) -> Array | None:
        """Of the catalogue, (..., NS, NS)."""
        return None if self.u_i is None else self.u_i @ np.swapaxes(self.u_i, -1, -2)

    def linearize(self, sight: interstar.Sight, at: Array) -> Sums:
        """Return, and keep, what the spots say at a camera."""
        equations = interstar.equations(sight, self.cosines, self.seen)
        value, matrix, noise = (
            part.reshape(-1, *part.shape[self.seen.ndim - 2:]).sum(axis=0)
            for part in (equations.value, equations.product(sight.by_intrinsics),
                         equations.noise(sight.by_spot, self.sigma)))
        self.sums = Sums(at, value, matrix, noise)
        return self.sums

    def screen(self, sight: interstar.Sight) -> None:
        """Take the spots that do not fit out, of each frame the worst and those half as bad."""
        misfit = np.linalg.norm(interstar.misfit(sight, self.cosines, self.seen), axis=-1)
        misfit = np.where(self.seen, misfit / self.sigma, 0.0)
        most = np.median(misfit[self.seen]) / _RAYLEIGH if self.seen.any() else 0.0
        bad = ((misfit > MISFIT * max(1.0, float(most)))
               & (misfit >= 0.5 * misfit.max(axis=-1, keepdims=True)))
        self.screened = not bad.any()
        if bad.any():
            self.seen, self.sums = self.seen & ~bad, None


def identified(frames: Sequence[tuple[Array, Array, Array]]) -> Window:
    """Return the window of frames, each ``(uv, sigma, u_i)`` of its stars."""
    slots = max(len(uv) for uv, *_ in frames)
    uv, u_i = np.zeros((len(frames), 1, slots, 2)), np.zeros((len(frames), slots, 3))
    sigma, seen = np.ones(uv.shape[:-1]), np.zeros(uv.shape[:-1], np.bool_)
    for k, (uv_k, sigma_k, u_k) in enumerate(frames):
        n = len(uv_k)
        uv[k, 0, :n], sigma[k, 0, :n], seen[k, 0, :n], u_i[k, :n] = uv_k, sigma_k, True, u_k
    return Window(uv, sigma, seen, u_i)


def followed(frames: Sequence[tuple[Array, Array, NDArray[np.int64]]]) -> Window:
    """Return the window of frames, each ``(uv, sigma, track)`` of its spots.

    A spot that no other frame of the window shows again tells nothing and has no place in it.
    """
    frame = np.repeat(np.arange(len(frames)), [len(uv) for uv, *_ in frames])
    uv_rows, sigma_rows, track = (np.concatenate(part) for part in zip(*frames))
    _, slot, count = np.unique(track, return_inverse=True, return_counts=True)
    again = count > 1
    rows = again[slot]
    place = frame[rows], (np.cumsum(again) - 1)[slot[rows]]
    uv = np.zeros((len(frames), int(again.sum()), 2))
    sigma, seen = np.ones(uv.shape[:-1]), np.zeros(uv.shape[:-1], np.bool_)
    uv[place], sigma[place], seen[place] = uv_rows[rows], sigma_rows[rows], True
    return Window(uv, sigma, seen)


class Fit:
    """The fit of one camera.

    Parameters
    ----------
    detector : Detector
        Its pixels.
    nominal : (7,) array
        Where to begin, and the value of what is not estimated.
    estimated : sequence of int
        Which of the seven intrinsics are.
    constrained : bool
        Hold the optical path, WC.
    """

    def __init__(self, detector: Detector, nominal: Array, estimated: Sequence[int],
                 constrained: bool) -> None:
        half_mm = 0.5 * np.hypot(detector.width, detector.height) * detector.pitch_mm
        # A quarter of the detector, f / 10, 1 % of distortion in the corner.
        self.largest = np.array([
            0.25 * detector.width, 0.25 * detector.height, 0.1 * nominal[2],
            *(0.01 / half_mm**power for power in (2, 4, 1, 1))])
        self._pitch_mm, self._constrained = detector.pitch_mm, constrained
        self._nominal, self._estimated = nominal, list(estimated)
        self._last: Array | None = None
        self._stale = np.zeros(7)                       # step that asks for new sums

    def solve(self, windows: Sequence[Window]) -> tuple[Array, Array] | None:
        """Return the intrinsics (7,) and the covariance (7, 7) of their errors, if there are any.

        Spots that do not fit are taken out of the windows.
        """
        windows = [window for window in windows if window.seen.shape[-1] > 1]
        x, covariance = self._nominal if self._last is None else self._last, np.zeros((7, 7))
        rough = [k for k in self._estimated if k < 3]
        try:
            if self._last is None and rough != self._estimated and rough:
                # Distortion is told apart where the rest is about right.
                x, _ = self._newton(windows, x, rough)
                for window in windows:
                    window.sums = None
            for _ in range(_SCREENINGS):
                x, part = self._newton(windows, x, self._estimated)
                unscreened = [window for window in windows if not window.screened]
                for window in unscreened:
                    window.screen(self._sight(window, x, self._estimated))
                if all(window.screened for window in unscreened):
                    break
        except np.linalg.LinAlgError:
            self._last = None
            return None
        self._last = x
        covariance[np.ix_(self._estimated, self._estimated)] = part
        return x, covariance

    def _sight(self, window: Window, x: Array, estimated: Sequence[int]) -> interstar.Sight:
        return interstar.lens(window.uv, x, self._pitch_mm, estimated, self._constrained,
                              window.seen)

    def _newton(self, windows: Sequence[Window], x: Array, estimated: list[int]
                ) -> tuple[Array, Array]:
        """Return the camera that solves the equations, and the covariance of what is estimated."""
        largest, noise = self.largest[estimated], np.zeros((len(estimated),) * 2)

        def evaluate(at: Array) -> tuple[Array, Array]:
            nonlocal noise
            camera_at = x.copy()
            camera_at[estimated] = at
            value, matrix, noise = np.zeros(len(at)), np.zeros(noise.shape), np.zeros(noise.shape)
            for window in windows:
                sums = window.sums
                if sums is None or (
                        np.abs(at - sums.at) > self._stale[estimated]).any():
                    sums = window.linearize(self._sight(window, camera_at, estimated), at)
                value += sums.value + sums.matrix @ (at - sums.at)
                matrix += sums.matrix
                noise += sums.noise
            self._stale[estimated] = STALE * np.sqrt(np.diag(interstar.covariance(matrix, noise)))
            return value, matrix

        at = interstar.solve(evaluate, x[estimated], largest, _STEPS)
        value, matrix = evaluate(at)
        covariance = interstar.covariance(matrix, noise)
        step, sigma = np.linalg.solve(matrix, value), np.sqrt(np.diag(covariance))
        if not (np.abs(step) < 1e-3 * largest).all() or not (sigma < largest).all():
            raise np.linalg.LinAlgError
        found = x.copy()
        found[estimated] = at
        return found, covariance
