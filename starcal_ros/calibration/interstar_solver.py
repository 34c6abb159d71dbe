# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One camera from many windows of spots: Newton's method on the sum of their equations.

A window is linearised anew only when the camera has moved by `STALE` sigmas since, so that the
camera can be asked for again and again while windows are added. There is no prior: what the stars
do not tell stays unknown, and a fit that knows an intrinsic less well than
`InterstarSolver.largest` says nothing.

SCOC is freed of its bias (`interstar_equations.bias`). The bias grows with the square of the
noise, and is a hundred sigmas where distortion is estimated: the noise is therefore taken from the
residuals, as a factor on the variances that are stated, and what is not known of that factor is
part of the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.core import robust
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector

Look = Callable[[Array], interstar.SpotDirections]
Frame = tuple[Array, Array, NDArray[Any]]

STALE = 0.1
MISFIT = 8.0
"""A spot does not fit that misses by so many sigmas, or by so many times what most miss by."""

_STEPS, _PASSES = 20, 8
_SOME = 16              # windows from which the camera is found for a start


class Sums(NamedTuple):
    """The equations of a window, linearised.

    Attributes
    ----------
    at : (K,) array
        The intrinsics estimated, where this is.
    value, matrix, noise : (K,), (K, K), (K, K) array
        As in `interstar_equations`.
    bias : interstar.Bias
        Zero where it is not removed.
    """

    at: Array
    value: Array
    matrix: Array
    noise: Array
    bias: interstar.Bias

    def step(self, factor: float) -> Array:
        """Return how far the solution is, (K,), for a factor on the variances of the spots."""
        return np.asarray(np.linalg.solve(self.matrix, self.value - factor * self.bias.value))

    def covariance(self, factor: float) -> Array:
        """Return the covariance, (K, K), of the solution, the factor known from the residuals."""
        covariance = interstar.covariance(self.matrix, self.noise)
        if not self.bias.expected > 0.0:
            return covariance
        shift = np.linalg.solve(self.matrix, factor * self.bias.value)
        return (factor * covariance
                + np.outer(shift, shift) * (self.bias.variance / self.bias.expected**2))


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

    def linearize(self, look: Look, at: Array, unbiased: bool) -> Sums:
        """Return, and keep, what the spots say at a camera."""
        sight, cosines = look(self.uv), self.cosines
        equations = interstar.equations(sight, cosines, self.seen)
        value, matrix, noise = (
            part.reshape(-1, *part.shape[self.seen.ndim - 2:]).sum(axis=0)
            for part in (equations.value, equations.product(sight.by_intrinsics),
                         equations.noise(sight.by_spot, self.sigma)))
        zero = np.zeros(())
        bias = (interstar.bias(look, self.uv, self.sigma, self.seen) if unbiased
                else interstar.Bias(np.zeros_like(value), zero, zero, zero))
        self.sums = Sums(at, value, matrix, noise, bias)
        return self.sums

    def screen(self, look: Look) -> None:
        """Take the spots that do not fit out, of each frame the worst and those half as bad."""
        misfit = np.linalg.norm(interstar.misfit(look(self.uv), self.cosines, self.seen), axis=-1)
        misfit = np.where(self.seen, misfit / self.sigma, 0.0)
        most = robust.scale_of(misfit[self.seen]) if self.seen.any() else 0.0
        bad = ((misfit > MISFIT * max(1.0, most))
               & (misfit >= 0.5 * misfit.max(axis=-1, keepdims=True)))
        self.screened = not bad.any()
        if bad.any():
            self.seen, self.sums = self.seen & ~bad, None


def identified(frames: Sequence[Frame]) -> Window:
    """Return the window of frames, each ``(uv, sigma, u_i)`` of its stars."""
    slots = max(len(uv) for uv, *_ in frames)
    uv, u_i = np.zeros((len(frames), 1, slots, 2)), np.zeros((len(frames), slots, 3))
    sigma, seen = np.ones(uv.shape[:-1]), np.zeros(uv.shape[:-1], np.bool_)
    for k, (uv_k, sigma_k, u_k) in enumerate(frames):
        n = len(uv_k)
        uv[k, 0, :n], sigma[k, 0, :n], seen[k, 0, :n], u_i[k, :n] = uv_k, sigma_k, True, u_k
    return Window(uv, sigma, seen, u_i)


def followed(frames: Sequence[Frame]) -> Window:
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


class InterstarSolver:
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
        self._factor = 1.0                              # of the noise on the variance stated

    def solve(self, windows: Sequence[Window]) -> tuple[Array, Array] | None:
        """Return the intrinsics (7,) and the covariance (7, 7) of their errors, if there are any.

        Spots that do not fit are taken out of the windows.
        """
        windows = [window for window in windows if window.seen.shape[-1] > 1]
        try:
            x = self._first(windows) if self._last is None else self._last
            self._screen(windows, x)
            x, part = self._root(windows, x, self._estimated, self._constrained)
        except np.linalg.LinAlgError:
            self._last = None
            return None
        self._last = x
        covariance = np.zeros((7, 7))
        covariance[np.ix_(self._estimated, self._estimated)] = part
        return x, covariance

    def _first(self, windows: Sequence[Window]) -> Array:
        """Return an initial camera, from a subset of the windows.

        Distortion is told apart only where the rest is about right, and r held leads there from
        further away.
        """
        some = windows[::len(windows) // _SOME + 1]
        x, rough = self._nominal, [k for k in self._estimated if k < 3]
        stages = ((rough, True), (self._estimated, self._constrained))
        for estimated, constrained in stages[not rough:]:
            for window in some:
                window.sums, window.screened = None, False
            self._screen(some, x)
            # The residuals of a rough camera make the noise too large, what is stated may be too
            # small; and all windows may tell what some do not.
            factors = [1.0]
            residuals = self._total(x[estimated], some, x, estimated, constrained).bias
            if residuals.expected > 0.0:
                factors.append(float(residuals.squares / residuals.expected))
            for self._factor in factors:
                with suppress(np.linalg.LinAlgError):
                    x, _ = self._root(some, x, estimated, constrained)
                    break
        for window in some:
            window.screened = False
        return x

    def _screen(self, windows: Sequence[Window], x: Array) -> None:
        """Take out the spots that do not fit a camera."""
        for window in windows:
            while not window.screened:
                window.screen(self._look(window, x, self._estimated, self._constrained))

    def _look(self, window: Window, x: Array, estimated: Sequence[int], constrained: bool) -> Look:
        return partial(interstar.lens, intrinsics=x, pitch_mm=self._pitch_mm, estimated=estimated,
                       constrained=constrained, seen=window.seen)

    def _root(self, windows: Sequence[Window], x: Array, estimated: list[int], constrained: bool
              ) -> tuple[Array, Array]:
        """Return the camera that solves the equations, and the covariance of what is estimated."""
        total = partial(self._total, windows=windows, x=x, estimated=estimated,
                        constrained=constrained)
        at, largest = x[estimated], self.largest[estimated]
        for _ in range(_PASSES):
            before, factor = at, self._factor
            at = interstar.solve(partial(_unbiased, total, factor), at, largest, _STEPS)
            sums = total(at)
            if not (np.abs(sums.step(factor)) < largest).all():
                raise np.linalg.LinAlgError
            if sums.bias.expected > 0.0:
                self._factor = float(sums.bias.squares / sums.bias.expected)
            sigma = np.sqrt(np.diag(sums.covariance(self._factor)))
            if (np.abs(at - before) <= STALE * sigma).all() or self._factor == factor:
                break
        if not (np.abs(sums.step(self._factor)) < np.minimum(sigma, largest)).all() or not (
                sigma < largest).all():
            raise np.linalg.LinAlgError
        found = x.copy()
        found[estimated] = at
        return found, sums.covariance(self._factor)

    def _total(self, at: Array, windows: Sequence[Window], x: Array, estimated: list[int],
               constrained: bool) -> Sums:
        """Return the sums over all windows at some values of what is estimated."""
        camera_at = x.copy()
        camera_at[estimated] = at
        sums = []
        for window in windows:
            part = window.sums
            if part is None or (np.abs(at - part.at) > self._stale[estimated]).any():
                look = self._look(window, camera_at, estimated, constrained)
                part = window.linearize(look, at, window.u_i is None and not constrained)
            sums.append(part)
        if not sums:
            raise np.linalg.LinAlgError
        _, _, matrix, noise, biases = zip(*sums)
        value = np.sum([part.value + part.matrix @ (at - part.at) for part in sums], axis=0)
        whole = Sums(at, value, np.sum(matrix, axis=0), np.sum(noise, axis=0),
                     interstar.Bias(*(np.sum(parts, axis=0) for parts in zip(*biases))))
        self._stale[estimated] = STALE * np.sqrt(np.diag(whole.covariance(self._factor)))
        return whole


def _unbiased(total: Callable[[Array], Sums], factor: float, at: Array) -> tuple[Array, Array]:
    """Return value, less its expectation, and matrix for `interstar_equations.solve`."""
    sums = total(at)
    return sums.value - factor * sums.bias.value, sums.matrix
