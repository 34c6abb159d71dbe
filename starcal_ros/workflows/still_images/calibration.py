# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images of the sky, each with an attitude of its own: no gyro, no clock.

They become `Frames`, so that every method which needs no attitude calibrates with them. Nothing
is known of the camera but its number of pixels: it begins at a focal length found from the
distances of the stars, and its pixel pitch is `PITCH_MM` whatever it is in truth, for only ratios
to it are told.

Results are in OpenCV's forward model: f, u0, v0 in raster pixels, k1, k2, p1, p2 without unit, or
the coefficients of another lens model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.calibration import (camera_verdict, held_camera, lens_bundle, residual_tests,
                                     residual_trends)
from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.bundle_problem import MIN_STARS, Observations
from starcal_ros.calibration.camera_verdict import CameraVerdict
from starcal_ros.calibration.fitted_stars import FittedStars
from starcal_ros.calibration.lens_bundle import LensStart
from starcal_ros.calibration.lens_choice import LensChoice
from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import detector, star_gate
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, from_flat
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses import PLUMB_BOB
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.phased import PhasedLens
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.statistic import gated_nis
from starcal_ros.measurements.samples import Stars
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.sky.refraction import Site
from starcal_ros.workflows.still_images import lens as lens_models, one_camera, opencv_camera
from starcal_ros.workflows.still_images.one_camera import OwnCamera
from starcal_ros.workflows.still_images.opencv_camera import from_estimate
from starcal_ros.workflows.still_images.table import StillImages

PITCH_MM = 0.005
"""Pixel pitch that stands for any."""

STATED = 1.5**2
"""Factor by which the variance of a centroid may differ from the stated one: the sigmas of a fit
to pixels of unknown gain are good to a half."""

_SIGMA_PX = 0.1         # of a centroid without a sigma of its own, to begin with
_LEAST_SIGMA_PX = 1e-4
_ROUNDS = 2


class Refit(NamedTuple):
    """Some images, their attitudes fitted with a camera that is held.

    Attributes
    ----------
    names : tuple of str
        Images.
    spots : Observations
        Their stars.
    adjusted : Adjusted
        With the residuals.
    stars : FittedStars
        Those inside the gate, linearised.
    catalog_id : (m,) int64 array
        Numbers of the stars.
    """

    names: tuple[str, ...]
    spots: Observations
    adjusted: Adjusted
    stars: FittedStars
    catalog_id: Ints

    @property
    def rms_px(self) -> float:
        """RMS residual of an axis, of the stars inside the gate [px]."""
        return float(np.sqrt(np.mean(self.adjusted.residual[self.adjusted.used]**2)))


@dataclass(frozen=True)
class StillImageCamera:
    """A camera calibrated with still images.

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
    verdict : CameraVerdict
        Whether the residuals are noise; there are no tolerances in units of PITCH_MM.
    start : LensStart
        The lens model, and what was known of it.
    own : tuple of OwnCamera
        What each image alone asks for.
    scatter : (p,) array or None
        Variances of the camera from the scatter between images, in the order of `keys`.
    own_f_px : (n, 2) array or None
        Focal length of each fitted image and its sigma, where each has its own
        (``intrinsics.free``); that of the camera is their mean.
    choice : LensChoice or None
        The lens models that were compared.
    """

    estimate: CameraEstimate
    sigma_px: float
    fit: Refit
    heldout: Refit | None
    scenario: Scenario
    verdict: CameraVerdict
    start: LensStart
    own: tuple[OwnCamera, ...] = ()
    scatter: Array | None = None
    own_f_px: Array | None = None
    choice: LensChoice | None = None

    @property
    def lens(self) -> LensModel:
        """What the camera is."""
        return self.start.lens

    @property
    def optics(self) -> tuple[LensModel, Array]:
        """The lens without its pixels, and its values."""
        if isinstance(self.lens, PhasedLens):
            return self.lens.optics, self.estimate.intrinsics[:len(self.lens.optics.parameters)]
        return self.lens, self.estimate.intrinsics

    @property
    def keys(self) -> tuple[str, ...]:
        """Its parameters in results."""
        return opencv_camera.keys(self.lens)

    @property
    def trends(self) -> dict[str, list[dict[str, Any]]]:
        """How the residuals of fitted images depend on pixel, magnitude and colour."""
        return residual_trends.of_stars(
            self.fit.stars, self.fit.catalog_id[self.fit.adjusted.used],
            detector(self.scenario.camera))

    @property
    def refused(self) -> float:
        """Share of the stars outside the gate."""
        return float(np.mean(~self.fit.adjusted.used))

    def with_test(self, test: Statistic, factors: tuple[float, ...]) -> StillImageCamera:
        """Return it with one more test, which multiplies the variances where it fails."""
        found = Consistency((test,), None, factors).beside(self.verdict.consistency)
        return replace(self, verdict=replace(self.verdict, consistency=found))

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON, the covariance in the order of `keys`."""
        keys, lens = self.keys, self.lens
        values, covariance = from_estimate(self.estimate, self.scenario, lens)
        judged = self.verdict.as_dict()
        factors = dict(zip(lens.parameters, self.verdict.consistency.camera_factors))
        judged['variance_factor'] = {
            'centroids': judged['variance_factor']['centroids'],
            **{key: factors.get(name, 1.0)
               for key, name in zip(keys, opencv_camera.in_ours(lens))}}
        sigma = np.sqrt(np.diag(covariance))
        scatter = None if self.scatter is None else dict(
            zip(keys, np.sqrt(self.scatter).tolist()))
        return {
            'lens': lens.name,
            **dict(zip(keys, values.tolist())), 'sigma': dict(zip(keys, sigma.tolist())),
            'sigma_between_images': scatter,
            'parameters': list(keys), 'covariance': covariance.tolist(),
            'centroid_sigma_px': self.sigma_px, 'fit_rms_px': self.fit.rms_px,
            'heldout_rms_px': self.heldout.rms_px if self.heldout else None,
            **judged,
            **({} if self.own_f_px is None else {'own_f_px': {
                name: {'f_px': f_px, 'sigma': sigma}
                for name, (f_px, sigma) in zip(self.fit.names, self.own_f_px.tolist())}}),
            'lens_models': [each.as_dict() for each in self.choice.scores] if self.choice else [],
            'residual_trends': self.trends,
            'each_image': [each.as_dict() for each in self.own],
            'counts': {'images': self.estimate.frames, 'stars': self.estimate.stars,
                       'rejected_stars': int((~self.fit.adjusted.used).sum()),
                       'heldout_stars': (int(self.heldout.adjusted.used.sum())
                                         if self.heldout else 0)}}


def scenario_of(width: int, height: int, focal_length_px: float, method: str,
                velocity: str = 'barycentre', site: Site | None = None) -> Scenario:
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
    site : Site, optional
        Where the camera looks through the air.
    """
    f_mm = focal_length_px * PITCH_MM
    through = {} if site is None else {
        'site_deg': (site.latitude_deg, site.longitude_deg), 'site_height_m': site.height_m,
        **dict(zip(('site_pressure_hpa', 'site_temperature_c'), site.air))}
    return from_flat({
        **{f'observer.{name}': value for name, value in through.items()},
        'camera.width': width, 'camera.height': height, 'camera.pixel_pitch_mm': PITCH_MM,
        'camera.focal_length_mm': f_mm, 'observer.velocity': velocity,
        'star_tracker.centroid_sigma_px': _SIGMA_PX, 'intrinsics.method': method,
        'intrinsics.interstar_equations': 'TCOC',      # no two images show the same stars
        'estimator.initial_sigma.principal_point_px': 0.2 * width,
        'estimator.initial_sigma.focal_length_mm': 0.2 * f_mm,
        'estimator.initial_sigma.k1': 1.0 / f_mm**2, 'estimator.initial_sigma.k2': 10.0 / f_mm**4,
        'estimator.initial_sigma.p1': 0.05 / f_mm, 'estimator.initial_sigma.p2': 0.05 / f_mm})


def focal_length_px(images: StillImages, width: int, height: int) -> float:
    """Return a focal length, good to some per cent, from identified stars [px].

    In the middle of the field the distance of two stars on the detector is f times their angle;
    the median over the pairs of neighbours in the tables cares for no wrong star.
    """
    frames = images.frames
    stars = StarDirections(scenario_of(width, height, width, 'bundle')).of(frames)
    frame = frames.frame_index
    known = np.isfinite(stars.sigma)
    frame, uv, u_i = frame[known], frames.uv_raster[known], stars.u_i[known]
    pairs = frame[1:] == frame[:-1]
    angle = 2.0 * np.arcsin(0.5 * np.linalg.norm(np.diff(u_i, axis=0), axis=-1)[pairs])
    length = np.linalg.norm(np.diff(uv, axis=0), axis=-1)[pairs]
    if not (angle > 0.0).any():
        raise ConfigError(f'{len(frames)} images with {known.sum()} stars of known direction: '
                          'needs two identified stars in one image')
    return float(np.median(length[angle > 0.0] / angle[angle > 0.0]))


def calibrate(images: StillImages, scenario: Scenario, lens: str = PLUMB_BOB, phase: bool = False
              ) -> StillImageCamera | None:
    """Calibrate the camera of still images by the method ``intrinsics.method``.

    The size of the residuals is not known beforehand: the method runs again with what it was.
    None where the method has nothing to say.

    Parameters
    ----------
    images : StillImages
    scenario : Scenario
        What is known of the camera, the observer, the method.
    lens : str
        Lens model, one of `lens.CHOICES`.
    phase : bool
        Estimate the pixel phase, too.
    """
    measured, stated, name = images.frames, 1.0, lens
    choice: LensChoice | None = None
    for k in range(_ROUNDS):
        stars = StarDirections(scenario).of(images.frames)
        fitted = images.which(~images.heldout)
        if lens == lens_models.AUTO and k == 0:
            choice = lens_models.compare(fitted, scenario)
            if choice is None:
                return None
            name = choice.chosen.name
        start = lens_bundle.start_of(name, scenario, phase)
        method = lens_models.begin(start, scenario)
        method.add_frames(fitted.frames)
        estimate = method.estimate()
        if estimate is None:
            return None
        fit = refit(images, stars, ~images.heldout, estimate, scenario, start)
        assert fit is not None          # or there would be no estimate
        adjusted = fit.adjusted
        shared = np.count_nonzero(estimate.sigma) - (adjusted.own_f is not None)
        freedom = max(1, adjusted.freedom - int(shared))
        residual, given = adjusted.residual[adjusted.used], fit.spots.sigma[adjusted.used]
        sigma = float(np.sqrt(np.sum(residual**2) / freedom))
        heldout = refit(images, stars, images.heldout, estimate, scenario, start)
        # A sigma that nobody stated can not be contradicted.
        found = residual_tests.consistency(
            fit.stars, estimate, detector(scenario.camera),
            gated_nis(scenario.estimator.gate_probability),
            STATED if (measured.sigma > 0.0).all() else None, 1.0 / stated**2,
            heldout=heldout.stars if heldout else None)
        result = StillImageCamera(estimate, sigma, fit, heldout, scenario,
                                  _verdict(found, estimate, start), start, choice=choice)
        if k == _ROUNDS - 1:
            own = getattr(method, 'own_f', None)
            return _with_lenses(_between_images(replace(
                result, own_f_px=None if own is None else own / _px(start)), fitted), fitted)
        scale = float(np.sqrt(np.sum((residual / given[:, None])**2) / freedom))
        stated *= scale
        known = measured.sigma > 0.0
        measured = replace(measured, sigma=np.where(
            known, np.maximum(scale * measured.sigma, _LEAST_SIGMA_PX), 0.0))
        images = replace(images, frames=measured)
        scenario = scenario.replace({'star_tracker.centroid_sigma_px': max(
            scale * scenario.star_tracker.centroid_sigma_px, _LEAST_SIGMA_PX)})
    return None


def _between_images(found: StillImageCamera, fitted: StillImages) -> StillImageCamera:
    """Return a camera with what its images say one by one, and the verdict on that."""
    fit, scenario = found.fit, found.scenario
    own = one_camera.own_cameras(fit.names, fit.spots, fit.adjusted, found.estimate, scenario,
                                 found.start)
    scatter = one_camera.jackknife(fitted, scenario,
                                   partial(lens_models.begin, found.start, scenario), found.lens)
    odd, factors = one_camera.disagreement(own), (1.0,) * len(found.keys)
    if not odd.passed and scatter is not None and len(own) > 1:
        formal = np.diag(from_estimate(found.estimate, scenario, found.lens)[1])
        scatter = np.maximum(scatter, one_camera.scattered(own, formal))
        ratio = dict(zip(opencv_camera.in_ours(found.lens), np.maximum(1.0, scatter / np.where(
            formal > 0.0, formal, np.inf)).tolist()))
        factors = tuple(ratio[name] for name in found.lens.parameters)
    judged = found.verdict.consistency
    if own and judged.statistics:
        judged = Consistency((odd,), None, factors).beside(judged)
    return replace(found, own=own, scatter=scatter,
                   verdict=_verdict(judged, found.estimate, found.start))


def _verdict(found: Consistency, estimate: CameraEstimate, start: LensStart) -> CameraVerdict:
    return CameraVerdict(found, {}, (), *camera_verdict.of_prior(
        estimate, np.sqrt(np.diag(start.covariance)), start.lens.parameters,
        dict(zip(opencv_camera.in_ours(start.lens), opencv_camera.keys(start.lens)))))


def _px(start: LensStart) -> float:
    """Return a pixel in the unit of the focal length of a lens model."""
    return PITCH_MM if start.lens.name == PLUMB_BOB else 1.0


def _with_lenses(found: StillImageCamera, fitted: StillImages) -> StillImageCamera:
    """Return a camera with what the other lens models say, where its residuals ask for that."""
    judged = found.verdict.consistency
    if not lens_models.is_doubtful(judged, found.refused):
        return found
    choice = found.choice or lens_models.compare(fitted, found.scenario)
    if choice is None:
        return found
    if judged.statistics:
        judged = Consistency((choice.test(found.lens.name),), None,
                             (1.0,) * len(found.keys)).beside(judged)
    return replace(found, choice=choice, verdict=replace(
        found.verdict, consistency=judged, about_lens=choice.sentence(
            found.lens.name, found.refused, found.fit.rms_px)))


def refit(images: StillImages, stars: Stars, part: Mask, estimate: CameraEstimate,
          scenario: Scenario, start: LensStart) -> Refit | None:
    """Fit the attitudes alone, the camera held; None where no image has stars enough.

    Parameters
    ----------
    images : StillImages
    stars : Stars
        Their stars.
    part : (n,) bool array
        Which images.
    estimate : CameraEstimate
    scenario : Scenario
        Gate.
    start : LensStart
        What the camera is.
    """
    stars = stars.take(np.repeat(part, images.frames.star_counts))
    images = images.which(part)
    frames = images.frames
    fitted = held_camera.fit(frames, stars, estimate.intrinsics, start.lens,
                             star_gate(scenario.estimator), start.own_f_sigma)
    if fitted is None:
        return None
    enough = np.bincount(frames.frame_index, np.isfinite(stars.sigma),
                         len(frames)) >= MIN_STARS
    return Refit(tuple(np.array(images.names)[enough].tolist()), *fitted)
