# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images of the sky, each with an attitude of its own: no gyro, no clock.

They become `Frames`, so that every method which needs no attitude calibrates with them. Nothing
is known of the camera but its number of pixels: it begins at a focal length found from the
distances of the stars, and its pixel pitch is `PITCH_MM` whatever it is in truth, for only ratios
to it are told.

Where the stars were seen through the air from a known site, each round of the calibration frees
the centroids of the refraction at the attitudes and with the camera of the round before.

Results are in OpenCV's forward model: f, u0, v0 in raster pixels, k1, k2, p1, p2 without unit.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from starcal_ros import calibration
from starcal_ros.calibration import bundle_adjustment, bundle_start
from starcal_ros.calibration.bundle_adjustment import Adjusted, Spots
from starcal_ros.calibration.camera_estimate import CameraEstimate
from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, from_flat
from starcal_ros.core import camera
from starcal_ros.core.units import DEG
from starcal_ros.core.utc import unix_ns
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import Places
from starcal_ros.messages.conventions import camera_info
from starcal_ros.sky.refraction import Site
from starcal_ros.workflows.still_images.atmosphere import without_air

Array = NDArray[np.float64]

PITCH_MM = 0.005
"""Pixel pitch that stands for any."""
KEYS = ('f_px', 'u0_px', 'v0_px', 'k1', 'k2', 'p1', 'p2')
"""The intrinsics in results; p1 and p2 are OpenCV's."""

_SIGMA_PX = 0.1         # of a centroid without a sigma of its own, to begin with
_LEAST_SIGMA_PX = 1e-4
_COLUMNS = ('image', 'u', 'v', 'catalog_id')
_STEP_NS = 10**6        # between images without a time of their own: methods want an order
_ROUNDS, _ROUNDS_IN_AIR = 2, 4


@dataclass(frozen=True)
class Plates:
    """Images and the stars found in them.

    Attributes
    ----------
    names : tuple of str
        Images, in the order of the frames.
    frames : Frames
        Their stars.
    heldout : (n,) bool array
        Images that judge a calibration and take no part in it.
    """

    names: tuple[str, ...]
    frames: Frames
    heldout: NDArray[np.bool_]

    def which(self, part: NDArray[np.bool_]) -> Plates:
        """Return some of the images."""
        return Plates(tuple(np.array(self.names)[part].tolist()), self.frames.take(part),
                      self.heldout[part])


class Refit(NamedTuple):
    """Some images, their attitudes fitted with a camera that is held.

    Attributes
    ----------
    names : tuple of str
        Images.
    spots : Spots
        Their stars.
    adjusted : Adjusted
        With the residuals.
    """

    names: tuple[str, ...]
    spots: Spots
    adjusted: Adjusted

    @property
    def rms_px(self) -> float:
        """RMS residual of an axis, of the stars inside the gate [px]."""
        return float(np.sqrt(np.mean(self.adjusted.residual[self.adjusted.used]**2)))


@dataclass(frozen=True)
class PlateCamera:
    """A camera calibrated with plates.

    Attributes
    ----------
    estimate : CameraEstimate
        In units of PITCH_MM.
    sigma_px : float
        Of a centroid, each axis, as the residuals have it: their mean square [px].
    fit, heldout : Refit or None
        The images that took part and those that did not.
    scenario : Scenario
        What the method began with.
    """

    estimate: CameraEstimate
    sigma_px: float
    fit: Refit
    heldout: Refit | None
    scenario: Scenario

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON, the covariance in the order of KEYS."""
        values, covariance = opencv(self.estimate, self.scenario)
        sigma = np.sqrt(np.diag(covariance))
        return {
            **dict(zip(KEYS, values.tolist())), 'sigma': dict(zip(KEYS, sigma.tolist())),
            'parameters': list(KEYS), 'covariance': covariance.tolist(),
            'centroid_sigma_px': self.sigma_px, 'fit_rms_px': self.fit.rms_px,
            'heldout_rms_px': self.heldout.rms_px if self.heldout else None,
            'counts': {'images': self.estimate.frames, 'stars': self.estimate.stars,
                       'refused_stars': int((~self.fit.adjusted.used).sum()),
                       'heldout_stars': (int(self.heldout.adjusted.used.sum())
                                         if self.heldout else 0)}}


def read_centroids(path: str | Path, epoch_utc: str) -> Plates:
    """Read a table of identified stars.

    Parameters
    ----------
    path : path
        CSV with a head: ``image``, ``u``, ``v`` [raster px], ``catalog_id`` (Hipparcos), and
        optionally ``split``, ``fit`` or ``heldout``, the same for all stars of an image, and
        ``sigma`` of a centroid, right but for a factor that all share [px].
    epoch_utc : str
        Time of the images, for the proper motions, ISO 8601.

    Raises
    ------
    ConfigError
        Where a column is missing or a row is not what it should be.
    """
    rows: dict[str, list[tuple[float, float, int, float]]] = {}
    splits: dict[str, str] = {}
    with Path(path).open(newline='', encoding='utf-8-sig') as stream:
        table = csv.DictReader(stream)
        missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
        if missing:
            raise ConfigError(f'{path}: no column {", ".join(missing)}; needs '
                              f'{", ".join(_COLUMNS)}')
        for row in table:
            image, split = row['image'], row.get('split') or 'fit'
            try:
                star = (float(row['u']), float(row['v']), int(row['catalog_id']),
                        float(row.get('sigma') or 0.0))
            except (TypeError, ValueError):
                raise ConfigError(
                    f'{path}, line {table.line_num}: got {row["u"]!r}, {row["v"]!r}, '
                    f'{row["catalog_id"]!r}, needs two numbers and a Hipparcos number (and a '
                    'number for sigma)') from None
            if split not in ('fit', 'heldout') or splits.setdefault(image, split) != split:
                raise ConfigError(f'{path}, line {table.line_num}: got split {split!r}, needs fit '
                                  'or heldout, the same for all stars of an image')
            rows.setdefault(image, []).append(star)
    return plates(list(rows), [np.array(stars)[:, :2] for stars in rows.values()],
                  [np.array(stars)[:, 2] for stars in rows.values()],
                  [splits[image] == 'heldout' for image in rows], epoch_utc,
                  [np.array(stars)[:, 3] for stars in rows.values()])


def plates(names: list[str], uv_raster: list[Array], catalog_id: list[NDArray[Any]],
           heldout: list[bool], epoch_utc: str, sigma: list[Array] | None = None,
           stamp_ns: list[int | None] | None = None) -> Plates:
    """Return images as frames, in the order of their times.

    Parameters
    ----------
    names : list of str
    uv_raster : list of (n, 2) arrays
        Centroids of each image [px].
    catalog_id : list of (n,) arrays
        Hipparcos numbers.
    heldout : list of bool
    epoch_utc : str
        Time of images without one, ISO 8601.
    sigma : list of (n,) arrays, optional
        Standard deviation of each centroid, right but for a factor that all share [px].
    stamp_ns : list of int or None, optional
        Time of each image, UTC since the Unix epoch.
    """
    counts = [len(stars) for stars in uv_raster]
    total, step = sum(counts), np.arange(len(names))
    stamps = unix_ns(epoch_utc) + _STEP_NS * step
    for k, own in enumerate(stamp_ns or ()):
        stamps[k] = stamps[k] if own is None else own
    frames = Frames(
        stamps, np.concatenate(([0], np.cumsum(counts, dtype=np.int64))),
        np.concatenate([np.empty((0, 2)), *uv_raster]),
        np.zeros(total) if sigma is None else np.concatenate([np.empty(0), *sigma]),
        np.full(total, np.nan), np.concatenate([np.empty(0), *catalog_id]).astype(np.int64))
    order = np.argsort(stamps, kind='stable')
    frames = frames.take(order)
    later = np.maximum.accumulate(frames.stamp_ns - step) + step    # no two at the same time
    return Plates(tuple(names[k] for k in order), replace(frames, stamp_ns=later),
                  np.array(heldout, bool)[order])


def scenario_of(width: int, height: int, focal_length_px: float, method: str,
                velocity: str = 'barycentre') -> Scenario:
    """Return a camera of which little is known, as a scenario.

    Parameters
    ----------
    width, height : int
        Pixels.
    focal_length_px : float
        Within a fifth.
    method : str
        Calibration method.
    velocity : str
        Whose velocity aberrates the stars; ``barycentre`` for no aberration.
    """
    f_mm = focal_length_px * PITCH_MM
    return from_flat({
        'camera.width': width, 'camera.height': height, 'camera.pixel_pitch_mm': PITCH_MM,
        'camera.focal_length_mm': f_mm, 'observer.velocity': velocity,
        'star_tracker.centroid_sigma_px': _SIGMA_PX, 'intrinsics.method': method,
        'intrinsics.interstar_equations': 'TCOC',      # no two images show the same stars
        'estimator.initial_sigma.principal_point_px': 0.2 * width,
        'estimator.initial_sigma.focal_length_mm': 0.2 * f_mm,
        'estimator.initial_sigma.k1': 1.0 / f_mm**2, 'estimator.initial_sigma.k2': 10.0 / f_mm**4,
        'estimator.initial_sigma.p1': 0.05 / f_mm, 'estimator.initial_sigma.p2': 0.05 / f_mm})


def focal_length_px(images: Plates, width: int, height: int) -> float:
    """Return a focal length, good to some per cent, from identified stars [px].

    In the middle of the field the distance of two stars on the detector is f times their angle;
    the median over the pairs of neighbours in the tables cares for no wrong star.
    """
    frames = images.frames
    placed = Places(scenario_of(width, height, width, 'bundle')).of(frames)
    frame = np.repeat(np.arange(len(frames)), frames.star_counts)
    known = np.isfinite(placed.stars.sigma)
    frame, uv, u_i = frame[known], frames.uv_raster[known], placed.stars.u_i[known]
    pairs = frame[1:] == frame[:-1]
    angle = 2.0 * np.arcsin(0.5 * np.linalg.norm(np.diff(u_i, axis=0), axis=-1)[pairs])
    length = np.linalg.norm(np.diff(uv, axis=0), axis=-1)[pairs]
    if not (angle > 0.0).any():
        raise ConfigError(f'{len(frames)} images with {known.sum()} stars of known place: needs '
                          'two identified stars in one image')
    return float(np.median(length[angle > 0.0] / angle[angle > 0.0]))


def calibrate(images: Plates, scenario: Scenario, site: Site | None = None
              ) -> PlateCamera | None:
    """Calibrate the camera of some plates by the method ``intrinsics.method``.

    The size of the residuals is not known beforehand: the method runs again with what it was.
    None where the method has nothing to say.

    Parameters
    ----------
    images : Plates
    scenario : Scenario
        What is known of the camera, the method.
    site : Site, optional
        Where the images were taken, to free them of refraction.
    """
    measured, result = images.frames, None
    for _ in range(_ROUNDS if site is None else _ROUNDS_IN_AIR):
        fitted, held = (images.which(part) for part in (~images.heldout, images.heldout))
        method = calibration.start(scenario)
        method.add_frames(fitted.frames)
        estimate = method.estimate()
        if estimate is None:
            return None
        fit = refit(fitted, estimate, scenario)
        assert fit is not None          # or there would be no estimate
        adjusted = fit.adjusted
        freedom = max(1, 2 * int(adjusted.used.sum()) - 3 * len(adjusted.C_si)
                      - int(np.count_nonzero(estimate.sigma)))
        residual, stated = adjusted.residual[adjusted.used], fit.spots.sigma[adjusted.used]
        sigma = float(np.sqrt(np.sum(residual**2) / freedom))
        result = PlateCamera(estimate, sigma, fit, refit(held, estimate, scenario), scenario)
        scale = float(np.sqrt(np.sum((residual / stated[:, None])**2) / freedom))
        known = measured.sigma > 0.0
        measured = replace(measured, sigma=np.where(
            known, np.maximum(scale * measured.sigma, _LEAST_SIGMA_PX), 0.0))
        freed = replace(images.frames, sigma=measured.sigma)
        if site is not None and (every := refit(images, estimate, scenario)) is not None:
            freed = without_air(measured, freed, every.adjusted.C_si, estimate.intrinsics,
                                scenario, site)
        images = replace(images, frames=freed)
        scenario = scenario.replace({'star_tracker.centroid_sigma_px': max(
            scale * scenario.star_tracker.centroid_sigma_px, _LEAST_SIGMA_PX)})
    return result


def refit(images: Plates, estimate: CameraEstimate, scenario: Scenario) -> Refit | None:
    """Fit the attitudes alone, the camera held; None where no image has stars enough."""
    frames = images.frames
    placed = Places(scenario).of(frames)
    spots = bundle_start.identified(frames, placed)
    if not len(spots.frame):
        return None
    image = np.repeat(np.arange(len(frames)), frames.star_counts)
    enough = np.bincount(image, np.isfinite(placed.stars.sigma),
                         len(frames)) >= bundle_adjustment.MIN_STARS
    pitch_mm = scenario.camera.pixel_pitch_mm
    r_s = camera.unproject(spots.uv, estimate.intrinsics, pitch_mm)
    adjusted = bundle_adjustment.adjust(
        spots, estimate.intrinsics, bundle_start.attitudes(spots, r_s), np.empty((0, 3)), pitch_mm,
        np.zeros((7, 7)), float(chi2.ppf(scenario.estimator.gate_probability, 2)))
    return Refit(tuple(np.array(images.names)[enough].tolist()), spots, adjusted)


def opencv(estimate: CameraEstimate, scenario: Scenario) -> tuple[Array, Array]:
    """Return a camera in OpenCV's forward model, (7,) in the order of KEYS, and its covariance."""
    info = camera_info(estimate.intrinsics, detector(scenario.camera))
    f, (k1, k2, p1, p2, _) = estimate.intrinsics[2], info.D
    J = np.zeros((7, 7))
    J[0, 2], J[1, 0], J[2, 1] = 1.0 / scenario.camera.pixel_pitch_mm, 1.0, 1.0
    J[3, 3], J[4, 4], J[5, 6], J[6, 5] = f**2, f**4, f, f
    J[3:, 2] = 2.0 * k1 / f, 4.0 * k2 / f, p1 / f, p2 / f
    return (np.array([info.K[0], info.K[2], info.K[5], k1, k2, p1, p2]),
            J @ estimate.covariance @ J.T)


def focal_length_of_field(fov_deg: float, width: int) -> float:
    """Return the focal length of a field of view across the width [px]."""
    return 0.5 * width / float(np.tan(0.5 * fov_deg * DEG))
