# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which star is which: lost in space, tracking, and the one after the other.

Lost in space, nothing is known of the attitude: a pattern of bright stars (`patterns`) gives
a first one and the scale. Tracking starts from the attitude that is expected. Both then look for
each star of the catalogue where it should be and fit attitude and camera to what they find
(`matching`), with a gate that narrows to what the fit leaves unexplained. An answer that random
spots could give once in a million frames is not given. In a sequence of frames a blend
(`blending`) gets no name.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from starcal_ros.core import kalman, robust, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.identification import blending, patterns
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.matching import Expected, View, chance, expected, fitted, match
from starcal_ros.identification.star_field import StarField
from starcal_ros.sky.apparent import Observer
from starcal_ros.sky.catalog import SHIPPED_LIMIT

MODEL_SIGMA_PX = 0.2
"""What no camera model explains of the place of a star, each axis [px]."""

MIN_STARS = 3
"""Stars that are needed to track; a search needs four."""

_FIRST_SIGMA_PX = 1.0   # as MODEL_SIGMA_PX, before the camera is fitted
_ROUNDS = 15
_CHANCE_SEARCHED, _CHANCE_TRACKED = 1e-6, 1e-4
_FIX_STARS = 2          # stars that an attitude found by searching is made of
_STARS_PER_SPOT, _SPARE_STARS = 3, 20    # how deep in the catalogue the spots are looked for
_BRIGHTER_MAGNITUDES = 1.0      # than its star, what a spot may be
_PHOTOMETRIC_STARS = 5
_BLEND_SIGMAS, _BLEND_PX = 0.5, 0.05     # shift by other stars of a spot that gets a name
_WORST_SIGMA_PX = 1.0   # stated of a spot that may get a name
_SCALE_SIGMA = 0.02     # of the focal length that a pattern gives
_TOLD = 0.02            # of the width, to which a star's place is known that is looked for
_CAMERA_DRIFT = 0.01    # of its first sigma, what the camera may change by from frame to frame


class MirroredError(ValueError):
    """The stars of an image match in the mirror only."""


@dataclass(frozen=True)
class Identification:
    """The stars of one frame.

    Attributes
    ----------
    catalog_id : (n,) int64 array
        Hipparcos number of each spot, 0 where it is not identified.
    view : View
        Attitude and camera that fit them, with covariance.
    rms_px : float
        Root mean square of the residuals, each axis [px].
    tracked : bool
        Whether an expected attitude led there, and not a search.
    """

    catalog_id: Ints
    view: View
    rms_px: float
    tracked: bool

    @property
    def C_si(self) -> Array:
        """Attitude (3, 3) of the star tracker, ``r_s = C_si r_i``."""
        return self.view.C_si

    def among(self, rows: Ints, total: int) -> Identification:
        """Return it for all spots of a frame of which it has but some rows."""
        catalog_id = np.zeros(total, np.int64)
        catalog_id[rows] = self.catalog_id
        return Identification(catalog_id, self.view, self.rms_px, self.tracked)


class Identifier:
    """Identifies the stars of frames of one camera.

    Parameters
    ----------
    guess : CameraGuess
        The camera.
    observer : Observer
        Who looks; counts for frames whose time is known.
    limiting_magnitude : float
        Faintest star of the catalogue that may be identified, Hp.
    turn_sigma : float
        Error of a turn that is given with a frame, each axis [rad].
    acceleration_sigma : float
        Change of the rate from frame to frame where no turn is given, each axis [rad/s^2].
    exposure_s : float
        For which a turning camera smears its stars, in `identify`.
    """

    def __init__(self, guess: CameraGuess, observer: Observer = Observer(),
                 limiting_magnitude: float = SHIPPED_LIMIT, turn_sigma: float = 5e-4,
                 acceleration_sigma: float = 5e-3, exposure_s: float = 0.0) -> None:
        self._guess, self._exposure_s = guess, exposure_s
        self._sky = StarField(observer, limiting_magnitude)
        self._limiting_magnitude = limiting_magnitude
        self._turn_sigma, self._acceleration_sigma = turn_sigma, acceleration_sigma
        self._drift = _CAMERA_DRIFT * View.around(
            np.eye(3), np.zeros((3, 3)), guess.intrinsics, guess.covariance).root[:, 3:]
        self._last: tuple[int, View] | None = None
        self._rate: Array | None = None

    def prepare(self) -> None:
        """Do at once what the first search would take seconds for.

        Raises
        ------
        ImportError
            Where tetra3rs is missing.
        """
        patterns.prepare(self._guess.seen, self._guess.focal_range_px,
                         self._limiting_magnitude)

    def identify(self, uv_raster: Array, flux: Array, stamp_ns: int,
                 turn: Array | None = None, sigma: ArrayLike = 0.0) -> Identification | None:
        """Identify the next frame: track it, or search where that does not succeed.

        Parameters
        ----------
        uv_raster : (n, 2) array
            Spots, (0, 0) the centre of the top-left pixel [px].
        flux : (n,) array
            Of the spots, in any unit; NaN where unknown.
        stamp_ns : int
            Middle of the exposure, UTC since the Unix epoch.
        turn : (3, 3) array, optional
            How the star tracker has turned since the last frame given here, as the gyros saw it:
            ``C_si = turn @ C_si`` of then. Without it the last rate is expected to go on.
        sigma : (n,) array or float
            Standard deviation of a spot, each axis [px].

        Returns
        -------
        identification : Identification or None
            None where the stars can not be told.

        Raises
        ------
        MirroredError, ImportError
            As `lost_in_space`.
        """
        last, found = self._last, None
        ahead = self._predict(stamp_ns, turn)
        # While gyros tell the turns, an attitude stays known through frames without stars.
        self._last = None if ahead is None or turn is None else (stamp_ns, ahead)
        if ahead is not None:
            found = self.track(ahead, uv_raster, flux, stamp_ns, sigma)
        if found is None:
            found = self.lost_in_space(uv_raster, flux, stamp_ns, sigma)
        self._rate = None
        if found is not None:
            self._last = stamp_ns, found.view
            if last is not None and stamp_ns > last[0]:
                turned = rotation.log(found.view.C_si @ last[1].C_si.T)
                self._rate = turned / ((stamp_ns - last[0]) * 1e-9)
            found = self._without_blends(found, stamp_ns, sigma)
        return found

    def _without_blends(self, found: Identification, stamp_ns: int, sigma: ArrayLike
                        ) -> Identification:
        """Take the names off the spots that other stars shift by much of their sigma."""
        lens = self._guess.lens
        field = self._sky.on(self._guess.detector, lens, found.view.C_si, found.view.intrinsics,
                             stamp_ns, _STARS_PER_SPOT * len(found.catalog_id) + _SPARE_STARS)
        # A frame that had to be searched for may be of a camera that was set down anew.
        rate = self._rate if found.tracked and self._rate is not None else np.zeros(3)
        turned = rotation.exp(rate * self._exposure_s)
        begin, end = (lens.project(field.u_i @ C_si.T, found.view.intrinsics)
                      for C_si in (found.view.C_si, turned @ found.view.C_si))
        spot = np.flatnonzero(np.isin(found.catalog_id, field.hip))
        order = np.argsort(field.hip)
        seen = order[np.searchsorted(field.hip, found.catalog_id[spot], sorter=order)]
        shift_px = np.linalg.norm(
            blending.photocentre_shift(begin, field.magnitude, end - begin, seen), axis=-1)
        allowed = np.maximum(
            _BLEND_SIGMAS * np.broadcast_to(sigma, found.catalog_id.shape)[spot], _BLEND_PX)
        catalog_id = found.catalog_id.copy()
        catalog_id[spot[shift_px > allowed]] = 0
        return replace(found, catalog_id=catalog_id)

    def lost_in_space(self, uv_raster: Array, flux: Array, stamp_ns: int | None = None,
                      sigma: ArrayLike = 0.0) -> Identification | None:
        """Identify a frame of which nothing is known; as `identify`, without a memory.

        Raises
        ------
        MirroredError
            Where the image must be flipped first.
        ImportError
            Where tetra3rs is missing.
        """
        spots, guess = self._spots(uv_raster, flux, sigma), self._guess
        seen, uv = guess.flattened(spots.uv)
        found = patterns.search(uv, spots.flux[seen], guess.seen, guess.focal_range_px,
                                self._limiting_magnitude)
        if found is None:
            return None
        if found.mirrored:
            raise MirroredError('the stars match in the mirror only: flip the image, top to '
                                'bottom or left to right')
        intrinsics, covariance = guess.intrinsics.copy(), guess.covariance.copy()
        intrinsics[2] = found.focal_px * guess.detector.pitch_mm
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = (_SCALE_SIGMA * intrinsics[2])**2
        uv, u_i = spots.uv[seen[found.spot]], self._sky.places(found.hip, stamp_ns)
        fix, _ = Rotation.align_vectors(guess.lens.unproject(uv, intrinsics), u_i)
        prior = View.around(fix.as_matrix(), np.eye(3), intrinsics, covariance)
        start = fitted(prior, u_i, uv, np.full(len(uv), _FIRST_SIGMA_PX), guess.lens)
        settled = self._settle(prior, start, _FIRST_SIGMA_PX, spots, stamp_ns)
        if settled is None or chance(
                len(settled.row) - _FIX_STARS, len(spots.row), settled.stars, settled.sigma,
                guess.detector) > _CHANCE_SEARCHED:
            return None
        return settled.identification(spots, tracked=False)

    def track(self, prior: View, uv_raster: Array, flux: Array, stamp_ns: int | None = None,
              sigma: ArrayLike = 0.0) -> Identification | None:
        """Identify a frame whose attitude is expected; as `identify`, without a memory.

        Parameters
        ----------
        prior : View
            Attitude and camera, and their covariance.
        """
        spots = self._spots(uv_raster, flux, sigma)
        settled = self._settle(prior, prior, MODEL_SIGMA_PX, spots, stamp_ns)
        if settled is None or chance(
                len(settled.row), len(spots.row), expected(
                    prior, settled.u_i, self._guess.lens), settled.sigma,
                self._guess.detector) > _CHANCE_TRACKED:
            return None
        return settled.identification(spots, tracked=True)

    def _settle(self, prior: View, start: View, sigma: float, spots: _Observed,
                stamp_ns: int | None) -> _Settled | None:
        """Match and fit in turn until the gate is as narrow as the residuals allow."""
        view, detector, lens = start, self._guess.detector, self._guess.lens
        spots = spots.take(spots.sigma <= _WORST_SIGMA_PX)
        count = _STARS_PER_SPOT * len(spots.row) + _SPARE_STARS
        matched = 0
        for _ in range(_ROUNDS):
            field = self._sky.on(detector, lens, view.C_si, view.intrinsics, stamp_ns, count)
            stars = expected(view, field.u_i, lens)
            told = stars.told(_TOLD * detector.width)
            field, stars = field.take(told), stars.take(told)
            noise = np.hypot(spots.sigma, sigma)
            spot, star = match(stars, spots.uv, noise)
            plausible = _plausible(spots.flux[spot], field.magnitude[star])
            spot, star = spot[plausible], star[plausible]
            if len(spot) < MIN_STARS:
                return None
            view = fitted(prior, field.u_i[star], spots.uv[spot], noise[spot], lens)
            residual = spots.uv[spot] - expected(view, field.u_i[star], lens).uv
            unexplained = robust.scale_of(np.linalg.norm(residual, axis=-1))
            if len(spot) <= matched and (unexplained > 0.9 * sigma or sigma == MODEL_SIGMA_PX):
                break
            sigma, matched = float(np.clip(unexplained, MODEL_SIGMA_PX, sigma)), len(spot)
        return _Settled(view, spots.row[spot], field.hip[star], field.u_i, stars, sigma,
                        float(np.sqrt(np.mean(residual**2))))

    def _spots(self, uv_raster: Array, flux: Array, sigma: ArrayLike) -> _Observed:
        """Return the spots that can be used: on the detector, with a finite sigma."""
        detector = self._guess.detector
        uv = np.asarray(uv_raster, float) - detector.centre_raster
        sigma = np.broadcast_to(np.asarray(sigma, float), len(uv))
        row = np.flatnonzero(detector.contains(uv) & np.isfinite(sigma) & (sigma >= 0.0))
        return _Observed(len(uv), row, uv[row], np.asarray(flux, float)[row], sigma[row])

    def _predict(self, stamp_ns: int, turn: Array | None) -> View | None:
        """Return the view that is expected at a stamp; None where nothing is."""
        if self._last is None:
            return None
        dt = (stamp_ns - self._last[0]) * 1e-9
        if turn is not None:
            sigma = self._turn_sigma
        elif self._rate is not None and dt > 0.0:
            turn, sigma = rotation.exp(self._rate * dt), self._acceleration_sigma * dt**2
        else:
            return None
        view = self._last[1]
        Phi = np.eye(len(view.root))
        Phi[:3, :3] = turn
        Q_root = np.hstack((np.diag([sigma] * 3 + [0.0] * len(view.intrinsics)), self._drift))
        return view._replace(C_si=turn @ view.C_si, root=kalman.predict(view.root, Phi, Q_root))


def _plausible(flux: Array, magnitude: Array) -> Mask:
    """Tell which spots are no brighter than their star can be, by the others' zero point.

    What lies on a faint star by chance is mostly brighter than it. A spot may well be fainter:
    saturated, or a star redder than most.
    """
    known = flux > 0.0
    if known.sum() < _PHOTOMETRIC_STARS:
        return np.ones(len(flux), bool)
    excess = -2.5 * np.log10(np.where(known, flux, 1.0)) - magnitude
    excess -= np.median(excess[known])
    spread = 1.4826 * np.median(np.abs(excess[known]))      # the sigma of a normal distribution
    return ~known | (excess > -max(_BRIGHTER_MAGNITUDES, 4.0 * spread))


class _Observed(NamedTuple):
    """The usable spots of a frame of `total`: rows, places from the centre, fluxes, sigmas."""

    total: int
    row: Ints
    uv: Array
    flux: Array
    sigma: Array

    def take(self, rows: Mask) -> _Observed:
        """Return some of the spots, of the same frame."""
        return _Observed(self.total, self.row[rows], self.uv[rows], self.flux[rows],
                         self.sigma[rows])


class _Settled(NamedTuple):
    """What `Identifier._settle` comes to: rows (m) and their stars, all stars (n), residuals."""

    view: View
    row: Ints
    hip: Ints
    u_i: Array
    stars: Expected
    sigma: float
    rms_px: float

    def identification(self, spots: _Observed, tracked: bool) -> Identification:
        catalog_id = np.zeros(spots.total, np.int64)
        catalog_id[self.row] = self.hip
        return Identification(catalog_id, self.view, self.rms_px, tracked)
