# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the stars say without the gyros: the camera, its noise, and an attitude a frame.

The camera is fitted to frames evenly spread over the recording (`calibration.bundle_adjustment`),
from a focal length that is searched over more than a decade, as it stands and mirrored. All frames
then get the attitude that fits their stars best, with the covariance ::

    R_k = s^2 (sum H' H / sigma^2)^-1,    C_k = (I + [delta_k x]) C_k(true)              (K.1)

s being what the residuals are larger than stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.calibration import bundle_adjustment, bundle_start
from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.config.models import detector, intrinsics, observer, of_intrinsics, star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, robust, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.units import NS
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

MIN_STARS = 4
"""Identified stars of a frame that counts: three more numbers than a turn takes up."""
_SAMPLE = 60            # frames that the camera is fitted to
_LEAST_FRAMES = 8
_SEARCHED = 10          # of these, that a focal length is searched with
_FOCAL = np.geomspace(0.1, 10.0, 41)    # of the nominal one
_NEAR_PX = 5.0          # that the stated camera may be off and no other is searched
_PART = 0.5             # of the stars that must fit
_WIDE = 20.0            # of the initial sigmas, that the camera may be off
_PASSES = 8
_RESISTING = 4          # of these, in which wrong stars are made light
_WIDTH = 2.0            # of the robust weight
_TRAILS = 0.05          # by how much the variance along its trail grows, that a star trails


class NoSkyError(ValueError):
    """The stars give no attitudes; the message says why."""


@dataclass(frozen=True)
class SeenSky:
    """Frames whose attitude is known from their stars.

    Attributes
    ----------
    stamp_ns : (n,) int64 array
        Increasing.
    C_si, R : (n, 3, 3) array
        Attitudes, and the covariance of their errors by Eq. (K.1) [rad^2].
    spots : Observations
        The stars of these frames.
    residual : (m, 2) array
        What they leave [px].
    used : (m,) bool array
        Stars that fit.
    camera : Adjusted
        The fit, of some of the frames.
    mirrored : bool
        Whether u was reversed for it.
    scale : float
        s of Eq. (K.1), of stars that do not trail.
    freedom : float
        Degrees of freedom that it is known from.
    """

    stamp_ns: Ints
    C_si: Array
    R: Array
    spots: Observations
    residual: Array
    used: Mask
    camera: Adjusted
    mirrored: bool
    scale: float
    freedom: float


def newer(stamp_ns: Ints) -> Mask:
    """Tell which stamps are newer than all before them, (n,)."""
    before = np.maximum.accumulate(stamp_ns)
    return np.concatenate(([True], stamp_ns[1:] > before[:-1])) if len(stamp_ns) else (
        np.zeros(0, bool))


def directions(frames: Frames, scenario: Scenario) -> Stars:
    """Return all stars that the catalogue has, on the detector or not.

    `measurements.star_directions` takes what is off the configured detector for unusable; here
    that is what may be wrong.
    """
    stars = catalog.load_containing(frames.catalog_id)
    row = stars.rows(frames.catalog_id)
    uv = frames.uv_raster - detector(scenario.camera).centre_raster
    usable = (row >= 0) & np.isfinite(uv).all(axis=-1) & (np.abs(uv) < 1e5).all(axis=-1)
    u_i = np.tile([0.0, 0.0, 1.0], (len(row), 1))
    u_i[usable] = apparent_places(
        stars, row[usable], frames.stamp_ns,
        np.bincount(frames.frame_index[usable], minlength=len(frames)),
        observer(scenario.observer))
    stated = np.where((frames.sigma > 0.0) & np.isfinite(frames.sigma), frames.sigma,
                      scenario.star_tracker.centroid_sigma_px)
    sigma = np.maximum(stated, max(scenario.star_tracker.least_sigma_px, 1e-4))
    return Stars(u_i, np.where(usable[:, None], uv, 0.0), np.where(usable, sigma, np.inf))


def look(frames: Frames, scenario: Scenario) -> SeenSky:
    """Return what the stars say.

    Raises
    ------
    NoSkyError
        Where too few frames have identified stars, or these do not fit the catalogue.
    """
    frames = frames.take(newer(frames.stamp_ns))
    stars = directions(frames, scenario)
    number = frames.frame_index
    usable = np.isfinite(stars.sigma)
    count = np.bincount(number, usable, len(frames))
    kept = count >= MIN_STARS
    if kept.sum() < _LEAST_FRAMES:
        raise NoSkyError(f'{int(kept.sum())} of {len(frames)} frames have {MIN_STARS} stars with '
                         f'a number of the catalogue, {_LEAST_FRAMES} are needed')
    rows = usable & kept[number]
    numbers = (np.cumsum(kept) - 1)[number[rows]]
    u_i, uv, sigma = stars.take(rows)
    spots = Observations(numbers, uv, sigma, u_i, np.full(len(numbers), -1))
    stamps = frames.stamp_ns[kept]
    begin, mirrored = _begin(_some(spots, len(stamps), _SEARCHED), scenario)
    if mirrored:
        spots = spots._replace(uv=spots.uv * [-1.0, 1.0])
    fitted = _fitted(_some(spots, len(stamps), _SAMPLE), begin, scenario)
    return _attitudes(stamps, spots, fitted, mirrored, scenario)


def _some(spots: Observations, n: int, most: int) -> Observations:
    """Return the stars of some of n frames, numbered from 0."""
    chosen = np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))
    rows = np.isin(spots.frame, chosen)
    return Observations(np.searchsorted(chosen, spots.frame[rows]), spots.uv[rows],
                        spots.sigma[rows], spots.u_i[rows], spots.point[rows])


def _begin(spots: Observations, scenario: Scenario) -> tuple[Array, bool]:
    """Return the intrinsics to begin with, and whether the image is mirrored."""
    nominal, pitch_mm = intrinsics(scenario.camera), scenario.camera.pixel_pitch_mm

    def miss(values: Array, flip: float) -> float:
        mirrored = spots._replace(uv=spots.uv * [flip, 1.0])
        r_s = camera.unproject(mirrored.uv, values, pitch_mm)
        C_si = bundle_start.attitudes(mirrored, r_s)
        u_s = (C_si[spots.frame] @ spots.u_i[..., None])[..., 0]
        return float(np.median(np.linalg.norm(u_s - r_s, axis=-1)))

    if miss(nominal, 1.0) < _NEAR_PX * pitch_mm / nominal[2]:
        return nominal, False
    # The stated lens belongs to the stated focal length: others are searched without one.
    tried = [nominal, *(np.array([0.0, 0.0, part * nominal[2], 0.0, 0.0, 0.0, 0.0])
                        for part in _FOCAL)]
    best = min(((miss(values, flip), k, flip) for k, values in enumerate(tried)
                for flip in (1.0, -1.0)), key=lambda each: each[0])
    return tried[best[1]], best[2] < 0.0


def _fitted(spots: Observations, begin: Array, scenario: Scenario) -> Adjusted:
    """Fit the camera: first what a shift and a scale explain, then the lens too."""
    lens = Tan2018Lens(scenario.camera.pixel_pitch_mm)
    sigma = of_intrinsics(scenario.estimator.initial_sigma)
    half = 0.5 * np.array([scenario.camera.width, scenario.camera.height])
    wide = np.maximum(_WIDE * sigma, np.array([*half, begin[2], 0.0, 0.0, 0.0, 0.0]))
    gate = star_gate(scenario.estimator)
    first = np.diag([wide[0]**2, wide[1]**2, wide[2]**2, 0.0, 0.0, 0.0, 0.0])
    r_s = lens.unproject(spots.uv, begin)
    C_si = bundle_start.attitudes(spots, r_s)
    rough = bundle_adjustment.adjust(spots, begin, C_si, np.empty((0, 3)), lens, first, gate)
    found = bundle_adjustment.adjust(spots, rough.intrinsics, rough.C_si, np.empty((0, 3)),
                                     lens, np.diag(wide**2), gate)
    if found.used.mean() < _PART or not 0.0 < found.scale * np.median(spots.sigma) < (
            0.02 * half.max()):
        raise NoSkyError(f'{int((~found.used).sum())} of {len(found.used)} stars are not where '
                         'the catalogue has their numbers, with any focal length')
    return found


def _attitudes(stamp_ns: Ints, spots: Observations, fitted: Adjusted, mirrored: bool,
               scenario: Scenario) -> SeenSky:
    pitch_mm, gate = scenario.camera.pixel_pitch_mm, star_gate(scenario.estimator)
    values, n = fitted.intrinsics, len(stamp_ns)
    C_si = bundle_start.attitudes(spots, camera.unproject(spots.uv, values, pitch_mm))
    used: Mask = np.ones(len(spots.frame), bool)
    first = np.flatnonzero(np.diff(spots.frame, prepend=-1))
    for step in range(_PASSES):
        r_s = np.einsum('nij,nj->ni', C_si[spots.frame], spots.u_i)
        ahead = r_s[:, 2] > 0.1
        uv, H, _ = camera.linearize(np.where(ahead[:, None], r_s, (0.0, 0.0, 1.0)), values,
                                    pitch_mm)
        residual = np.where(ahead[:, None], spots.uv - uv, 1e6)
        if step in (0, _RESISTING):         # the rates are known well enough by then
            W, across = _information(spots, stamp_ns, C_si, H, scenario)
            W /= fitted.scale**2
        length = np.sqrt(np.einsum('ni,nij,nj->n', residual, W, residual))
        if step < _RESISTING:
            usual = np.maximum(_medians(length, spots.frame, first) / robust.RAYLEIGH_MEDIAN, 1.0)
            weight = robust.sigma_factor(length, usual, _WIDTH)**-2
        else:
            used = length**2 <= gate
            weight = np.where(used, 1.0, 0.0)
        HW = weight[:, None, None] * np.swapaxes(H, -1, -2) @ W
        N = np.add.reduceat(HW @ H, first)
        # A frame that is left with no star keeps its attitude and is not used.
        N += np.eye(3) * 1e-9 * np.trace(N, axis1=1, axis2=2).max()
        g = np.add.reduceat((HW @ residual[..., None])[..., 0], first)
        C_si = rotation.exp(np.linalg.solve(N, g[..., None])[..., 0]) @ C_si
    kept = np.bincount(spots.frame, used, n) >= MIN_STARS
    counted = used & kept[spots.frame]
    spread = np.linalg.inv(W) - H @ np.linalg.inv(N)[spots.frame] @ np.swapaxes(H, -1, -2)
    # Along its trail a star is worse than stated; across, it is as at rest, or better where the
    # stated sigma is the mean of both.
    if not scenario.star_tracker.smear:
        counted = counted & (np.trace(across, axis1=1, axis2=2) > 1.5)
    variance = (fitted.scale * spots.sigma)**2
    freedom = float((np.einsum('nij,nji->n', across, spread) / variance)[counted].sum())
    misfit = np.einsum('ni,nij,nj->n', residual, across, residual) / variance
    scale = fitted.scale * float(np.sqrt(misfit[counted].sum() / freedom)) if (
        freedom > 0.0) else fitted.scale
    R = np.linalg.inv(N) * (scale / fitted.scale)**2
    rows = kept[spots.frame]
    known = Observations((np.cumsum(kept) - 1)[spots.frame[rows]], spots.uv[rows],
                         spots.sigma[rows], spots.u_i[rows], spots.point[rows])
    return SeenSky(stamp_ns[kept], C_si[kept], R[kept], known, residual[rows], used[rows], fitted,
                   mirrored, scale, max(freedom, 0.0))


def _medians(length: Array, frame: Ints, first: Ints) -> Array:
    """Return for each star the median of its frame, (m,)."""
    order = np.lexsort((length, frame))
    counts = np.diff(first, append=len(frame))
    return np.asarray(length[order][first + counts // 2][frame])


def _information(spots: Observations, stamp_ns: Ints, C_si: Array, H: Array, scenario: Scenario
                 ) -> tuple[Array, Array]:
    """Return the inverse covariance of each star, and what is left of it across its trail.

    Both (m, 2, 2); the second projects, and is the identity for a star that does not trail.

    A star that moves by l during the exposure has ``sigma^2 (I + l l' / (12 s^2))``, s being that
    of its spot: Eq. (S.1) of `simulation.errors.smear`. Where the stated sigma holds the trail, as
    the mean of both axes, that is ``sigma^2 (1 + q / (2 + q))`` along it, q being the square of
    l / (sqrt(12) s).
    """
    W = np.broadcast_to(np.eye(2), (len(spots.frame), 2, 2)) / spots.sigma[:, None, None]**2
    if len(stamp_ns) < 2:
        return W, np.broadcast_to(np.eye(2), W.shape)
    turn = rotation.log(C_si[1:] @ np.swapaxes(C_si[:-1], -1, -2))
    rate = turn / (np.diff(stamp_ns) * NS)[:, None]
    rate = np.concatenate((rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]))
    trail = (H @ rate[spots.frame][..., None])[..., 0] * (
        scenario.star_tracker.exposure_s / (np.sqrt(12.0) * scenario.image.psf_sigma_px))
    square = np.sum(trail**2, axis=-1)
    if not scenario.star_tracker.smear:
        trail /= np.sqrt(2.0 + square)[:, None]
        square /= 2.0 + square
    shape = np.eye(2) - trail[:, :, None] * trail[:, None, :] / (1.0 + square)[:, None, None]
    along = trail[:, :, None] * trail[:, None, :] / np.maximum(square, 1e-12)[:, None, None]
    return W @ shape, np.eye(2) - np.where((square > _TRAILS)[:, None, None], along, 0.0)
