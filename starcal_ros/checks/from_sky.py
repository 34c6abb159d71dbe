# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the stars of single frames find: numbers, the camera, the noise of the centroids."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from starcal_ros.checks.chance import CHANCE, SIGMAS, beyond_chance
from starcal_ros.checks.finding import Finding
from starcal_ros.checks.sky import SeenSky
from starcal_ros.config.models import intrinsics, of_intrinsics
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.distributions import binomial_sf, chi2_cdf, chi2_sf
from starcal_ros.measurements.samples import Frames
from starcal_ros.sky import catalog

_FORMATS = ((640, 480), (752, 480), (800, 600), (1024, 768), (1024, 1024), (1280, 720),
            (1280, 960), (1280, 1024), (1440, 1080), (1600, 1200), (1920, 1080), (1920, 1200),
            (2048, 1088), (2048, 1536), (2048, 2048), (2448, 2048), (2592, 1944), (4096, 3000),
            (4096, 4096))
"""Detectors that are common."""
_FEW_STARS = 200        # from which on the edges of the detector are known
_NOISE_OFF = 1.1        # times or parts of a stated sigma that counts
_UNNAMED = 0.5          # part of the stars without a number that counts
_WRONG = 0.01           # part of the stars with a wrong one
_PHASE_PX = 1e-3        # least pixel phase that counts
_FEW_PIXELS = 300       # that stars have been in, for their phase to be told
_COLUMN = 1 << 20       # pixels of a column, at most


def of_messages(frames: Frames, scenario: Scenario) -> Iterator[Finding]:
    """Yield what is wrong with the frames as they are."""
    n = len(frames.catalog_id)
    if not len(frames):
        return
    if not n:
        yield Finding('no stars', f'none of {len(frames)} frames has a star',
                      'driver of the star tracker')
        return
    bad = ~np.isfinite(frames.uv_raster).all(axis=-1)
    if bad.any():
        yield Finding('not finite', f'{int(bad.sum())} of {n} centroids are not finite numbers',
                      'driver of the star tracker')
    unnamed = int((frames.catalog_id == 0).sum())
    if unnamed > _UNNAMED * n:
        yield Finding('unidentified stars', f'{unnamed} of {n} stars have no catalogue number '
                      '(catalog_id 0): only identified stars calibrate; the node star_identifier '
                      'gives them numbers', 'star_identifier')
    named = frames.catalog_id[frames.catalog_id != 0]
    unknown = named[catalog.load_containing(named).rows(named) < 0] if len(named) else named
    if len(unknown) > 0.02 * n:
        listed = ', '.join(map(str, np.unique(unknown)[:3].tolist()))
        yield Finding('unknown numbers', f'{len(unknown)} of {n} stars have numbers that '
                      f'Hipparcos lacks ({listed}, ...): numbers of another catalogue?',
                      'driver of the star tracker')


def of_sky(sky: SeenSky, frames: Frames, scenario: Scenario) -> Iterator[Finding]:
    """Yield what is wrong with camera and centroids."""
    if sky.mirrored:
        yield Finding('mirrored image', 'the stars fit the catalogue mirrored only: u or v counts '
                      'the other way, or the two are swapped', 'driver of the star tracker',
                      driver={'frames_mirrored': True})
    camera = list(_camera(sky, frames, scenario))
    yield from camera
    yield from _wrong_numbers(sky)
    waves: list[Finding] = [] if sky.mirrored else list(_phase(sky, scenario))
    yield from waves
    yield from _noise(sky, frames, scenario, sum(each.value[0]**2 for each in waves))


def _wrong_numbers(sky: SeenSky) -> Iterator[Finding]:
    n, wrong = len(sky.used), int((~sky.used).sum())
    if wrong > _WRONG * n and binomial_sf(wrong, n, 2e-3) < CHANCE:
        yield Finding('wrong numbers', f'{wrong} of {n} stars are not where the catalogue has '
                      'their number: wrong identifications', 'driver of the star tracker',
                      (wrong / n,), (float(np.sqrt(wrong) / n),), 'part')


def _camera(sky: SeenSky, frames: Frames, scenario: Scenario) -> Iterator[Finding]:
    stated = scenario.camera
    values, nominal = sky.camera.intrinsics, intrinsics(stated)
    sigma = np.sqrt(np.diag(sky.camera.covariance))
    initial = of_intrinsics(scenario.estimator.initial_sigma)
    off = np.abs(values - nominal)[:3] > SIGMAS * np.hypot(initial, sigma)[:3]
    uv = frames.uv_raster[np.isfinite(frames.uv_raster).all(axis=-1)]
    size = np.array([stated.width, stated.height])
    if _from_centre(uv, values, size, sky):
        yield Finding('centroids from the centre', f'u runs from {uv[:, 0].min():.0f} to '
                      f'{uv[:, 0].max():.0f} and v from {uv[:, 1].min():.0f} to '
                      f'{uv[:, 1].max():.0f}: counted from the centre of the detector, where '
                      'raster pixels, (0, 0) the top left one, are asked for',
                      'driver of the star tracker', driver={
                          'centroids_plus_px': ((size - 1) / 2.0).tolist()})
        off[:2] = False
        values = values + np.array([*(size - 1) / 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        off[:2] = np.abs(values - nominal)[:2] > SIGMAS * np.hypot(initial, sigma)[:2]
    found = None if sky.mirrored else _detector(uv, size, values, off)
    if found:
        width, height = found
        shift = (np.array(found) - size) / 2.0
        values = values - np.array([*shift, 0.0, 0.0, 0.0, 0.0, 0.0])
        off[:2] = np.abs(values - nominal)[:2] > SIGMAS * np.hypot(initial, sigma)[:2]
        yield Finding('detector', f'stars reach u = {uv[:, 0].max():.1f}, v = '
                      f'{uv[:, 1].max():.1f}: detector {width} x {height}, not {size[0]} x '
                      f'{size[1]}', 'camera.width, camera.height', (width, height), (), 'px',
                      {'camera.width': width, 'camera.height': height})
    # The frames give f over the pixel pitch: which of the two is wrong they do not tell.
    if off[2]:
        pitch = stated.pixel_pitch_mm * nominal[2] / values[2]
        yield Finding('focal length', f'focal length {values[2]:.4f} +- {sigma[2]:.2g} mm, '
                      f'camera.focal_length_mm is {nominal[2]:g} +- {initial[2]:g}; or a pixel '
                      f'pitch of {1e3 * pitch:.4f} um, which is the same to the stars',
                      'camera.focal_length_mm', (float(values[2]),), (float(sigma[2]),), 'mm',
                      {'camera.focal_length_mm': float(values[2]), **_lens(values, nominal, sigma,
                                                                           initial)})
    if off[:2].any() and not sky.mirrored:
        yield Finding('principal point', f'principal point {values[0]:.1f}, {values[1]:.1f} +- '
                      f'{sigma[0]:.1f}, {sigma[1]:.1f} px from the centre of the detector, '
                      f'camera.principal_point_px is {nominal[0]:g}, {nominal[1]:g} +- '
                      f'{initial[0]:g}', 'camera.principal_point_px',
                      tuple(values[:2].tolist()), tuple(sigma[:2].tolist()), 'px',
                      {'camera.principal_point_px': tuple(values[:2].tolist())})
    lens_off = np.abs(values - nominal)[3:] > SIGMAS * np.hypot(initial, sigma)[3:]
    if lens_off.any() and not off[2] and not sky.mirrored:
        listed = ', '.join(f'{name} {value:.3g} +- {spread:.1g}' for name, value, spread, bad in
                           zip(('k1', 'k2', 'p1', 'p2'), values[3:], sigma[3:], lens_off) if bad)
        yield Finding('distortion', f'distortion {listed}, beyond its initial sigma',
                      'camera.distortion', tuple(values[3:].tolist()), tuple(sigma[3:].tolist()),
                      'mm^-2, mm^-4, mm^-1, mm^-1',
                      {'camera.distortion': tuple(values[3:].tolist())})


def _lens(values: Array, nominal: Array, sigma: Array, initial: Array) -> dict[str, object]:
    off = np.abs(values - nominal)[3:] > SIGMAS * np.hypot(initial, sigma)[3:]
    return {'camera.distortion': tuple(values[3:].tolist())} if off.any() else {}


def _from_centre(uv: Array, values: Array, size: Array, sky: SeenSky) -> bool:
    """Tell whether centroids are negative down to half of the detector, and the axis says so."""
    half = (size - 1) / 2.0
    return bool(len(uv) >= _FEW_STARS and not sky.mirrored
                and (np.percentile(uv, 1.0, axis=0) < -0.5 * half).all()
                and (np.percentile(uv, 99.0, axis=0) < 1.3 * half).all()
                and (np.abs(values[:2] + half) < 0.3 * half).all())


def _detector(uv: Array, size: Array, values: Array, off: Mask) -> tuple[int, int] | None:
    """Return the common detector that the stars fill, where the stated one is not that.

    Stars beyond the edge deny the stated detector. Where they fill less of it than they should by
    chance, the principal point must say so too: a lens may darken the corners.
    """
    if len(uv) < _FEW_STARS or uv.min() < -1.5:
        return None
    reach = np.percentile(uv, 100.0 * (1.0 - 1.0 / len(uv)), axis=0) if len(uv) > 1 else uv[0]
    reach = np.maximum(reach, np.sort(uv, axis=0)[-2])
    beyond = (reach > size - 0.5 + 1.0).any()
    # The part of the detector that no star of n reaches by chance, at most.
    empty = 1.0 - np.exp(np.log(CHANCE) / len(uv))
    lacking = (reach < (size - 1) * (1.0 - empty)).any() and bool(off[:2].any())
    if not beyond and not lacking:
        return None
    fitting = [(w, h) for w, h in (*_FORMATS, *((h, w) for w, h in _FORMATS))
               if (reach <= np.array([w, h]) - 0.5 + 1.0).all()
               and (reach >= (np.array([w, h]) - 1) * (1.0 - empty)).all()]
    if len(fitting) >= 1:
        return min(fitting, key=lambda each: each[0] * each[1])
    if not beyond:
        return None
    width, height = np.maximum(np.ceil(reach + 1.0), size if not lacking else 0).astype(int)
    return int(width), int(height)


def _phase(sky: SeenSky, scenario: Scenario) -> Iterator[Finding]:
    """Yield a displacement of the centroids that repeats from pixel to pixel."""
    centre = (np.array([scenario.camera.width, scenario.camera.height]) - 1) / 2.0
    used = sky.used
    phase = 2.0 * np.pi * (sky.spots.uv[used] + centre)
    weight = 1.0 / (sky.scale * sky.spots.sigma[used])
    column, row = np.rint(sky.spots.uv[used] + centre).astype(np.int64).T
    pixel = np.unique(column * _COLUMN + row, return_inverse=True)[1]
    if len(pixel) == 0 or pixel.max() < _FEW_PIXELS:
        return
    for axis in range(2):
        X = np.stack((np.sin(phase[:, axis]), np.cos(phase[:, axis])), axis=-1) * weight[:, None]
        N = X.T @ X
        size = np.linalg.solve(N, X.T @ (sky.residual[used, axis] * weight))
        # What is left of a star is the same wherever it stays: each pixel counts as one.
        left = (sky.residual[used, axis] * weight - X @ size)[:, None] * X
        together = np.stack([np.bincount(pixel, column) for column in left.T], axis=-1)
        spread = np.linalg.inv(N) @ (together.T @ together) @ np.linalg.inv(N)
        gain = float(size @ np.linalg.solve(spread, size))
        # The noise of a centroid blurs the phase that it is read from.
        blur = np.exp(0.5 * (2.0 * np.pi * sky.scale * np.median(sky.spots.sigma[used]))**2)
        amplitude, sigma = float(blur * np.hypot(*size)), float(blur * np.sqrt(spread[0, 0]))
        if gain > beyond_chance(2) and amplitude > _PHASE_PX:
            yield Finding('pixel phase', f'centroids along {"uv"[axis]} are displaced by '
                          f'{amplitude:.3g} +- {sigma:.1g} px times a wave of one pixel: a '
                          'centroid that is drawn to the pixels (chi-square '
                          f'{gain:.0f})', 'centroiding of the star tracker', (amplitude,),
                          (sigma,), 'px', gain=gain)


def _noise(sky: SeenSky, frames: Frames, scenario: Scenario, waves_px2: float
           ) -> Iterator[Finding]:
    """Yield a scatter of the centroids that is not the stated one, beside waves of one pixel."""
    stated = float(np.median(sky.spots.sigma))
    # A wave of amplitude a has the variance a^2 / 2 along its axis, half of that over both.
    scale = float(np.sqrt(max(sky.scale**2 - 0.25 * waves_px2 / stated**2, 0.0)))
    if sky.freedom < 50 or 1.0 / _NOISE_OFF < scale < _NOISE_OFF:
        return
    statistic = scale**2 * sky.freedom
    if min(chi2_sf(statistic, sky.freedom), chi2_cdf(statistic, sky.freedom)) > CHANCE / 2.0:
        return
    value, sigma = stated * scale, stated * scale / np.sqrt(2.0 * sky.freedom)
    by_message = bool((frames.sigma > 0.0).any())
    parameters: dict[str, object] = {}
    if not by_message or scale > 1.0:
        parameters['star_tracker.centroid_sigma_px'] = float(value)
    if by_message and scale > 1.0:      # what the messages say is raised to that
        parameters['star_tracker.least_sigma_px'] = float(value)
    where = "the messages' own sigma" if by_message else 'star_tracker.centroid_sigma_px'
    points_at = ('driver of the star tracker (sigma)' if by_message
                 else 'star_tracker.centroid_sigma_px')
    yield Finding('centroid noise', f'centroids scatter by {value:.3g} +- {sigma:.1g} px, '
                  f'{where} is {stated:.3g}', points_at, (float(value),), (float(sigma),), 'px',
                  parameters, {'sigma_times': scale} if by_message else {})
