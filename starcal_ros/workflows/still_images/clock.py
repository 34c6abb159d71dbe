# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the air that was taken away is that of the right time and place.

Refraction depends on where in the sky the images look, so on the clock and the site. The same
stars are fitted with the clock some whole hours off, as a wrong zone has it, and without any air.
It is done with the lens model of the camera: one of more terms would take a wrong air for its own.
With s^2 the mean square of what a fit leaves, m degrees of freedom ::

    g = m ln(s_0^2 / s^2)                                                              (K.1)

is twice the logarithm of the likelihood ratio against the time and the site that were stated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import bundle_start, lens_bundle
from starcal_ros.calibration.lens_bundle import LensStart
from starcal_ros.calibration.residual_tests import AIR
from starcal_ros.config.models import star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.distributions import chi2_isf
from starcal_ros.core.statistic import ALARM, Statistic
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.workflows.still_images.calibration import StillImageCamera
from starcal_ros.workflows.still_images.table import StillImages

HOURS = range(-13, 14)
"""By which the clock may be off, and another zone of it would fit."""

FAR = 1.5
"""Factor in variance from which another zone fits far better: no lens is quite that of the model,
and what it lacks may look like a little of another air."""
ALIKE = 1.25
"""Factor in variance within which zones are alike."""

_IMAGES = 6             # that are looked at, evenly spread
_HOUR_NS = 3600 * 10**9


class _Fit(NamedTuple):
    """A fit with the air of some time: hours off, or no air (None); squares, number of stars."""

    hours: int | None
    squares: Array
    intrinsics: Array
    freedom: int


class Air(NamedTuple):
    """What the air says of the time and the site.

    Attributes
    ----------
    test : Statistic
        Another zone that fits far better fails it.
    factors : tuple of float
        By what it multiplies the variances of the camera.
    doubt : str
        What a user should know of the site; mostly empty.
    """

    test: Statistic
    factors: tuple[float, ...]
    doubt: str


def look(images: StillImages, scenario: Scenario, zone_h: float, found: StillImageCamera
         ) -> Air | None:
    """Test the time and the site of images; None where their stars have no fit.

    Parameters
    ----------
    images : StillImages
        That a camera was calibrated with.
    scenario : Scenario
        What was known of the camera, and the site.
    zone_h : float
        Zone in which times of theirs were read, from UTC [h].
    found : StillImageCamera
        The camera that was found.
    """
    some = np.zeros(len(images.names), bool)
    some[np.linspace(0, len(some) - 1, min(_IMAGES, len(some))).astype(int)] = True
    frames, start = images.which(some).frames, found.start
    stated = _fit(frames, scenario, start, 0, None)
    if stated is None:
        return None
    others = (_fit(frames, scenario, start, hours, stated.intrinsics)
              for hours in (None, *HOURS) if hours != 0)
    fits = [stated, *filter(None, others)]
    most = star_gate(scenario.estimator) * float(np.median(stated.squares)) / np.log(2.0)
    cost = {each.hours: float(np.minimum(each.squares, most).sum()) for each in fits}
    gain = {hours: stated.freedom * float(np.log(cost[0] / each)) for hours, each in cost.items()}
    best = max((each for each in fits if each.hours is not None),
               key=lambda each: gain[each.hours])
    chance = float(chi2_isf(ALARM / len(cost), 1))
    rms = {hours: float(np.sqrt(each / (2.0 * len(stated.squares))))
           for hours, each in cost.items()}
    test = Statistic(AIR, gain[best.hours], 0.0, chance + stated.freedom * float(np.log(FAR)),
                     len(cost), gain=gain[best.hours])
    sigma = found.estimate.sigma
    factors = (1.0,) * len(sigma)
    if not test.passed:
        alike = [zone_h - hours for hours, each in cost.items()
                 if hours is not None and each < ALIKE * cost[best.hours]]
        zones = ' or '.join(f'UTC{zone:+g}' for zone in sorted(alike))
        test = test._replace(fits=f'a clock at {zones}: RMS {rms[best.hours]:.3g} sigma at '
                             f'--utc-offset={zone_h - (best.hours or 0):g} against {rms[0]:.3g} '
                             'as stated')
        moved = np.where(sigma > 0.0, (best.intrinsics - stated.intrinsics) / np.where(
            sigma > 0.0, sigma, 1.0), 0.0)
        factors = tuple((1.0 + moved**2).tolist())
    doubt = ''
    if gain.get(None, 0.0) > chance:
        doubt = (f'the site makes the fit worse: RMS {rms[0]:.3g} sigma, {rms[None]:.3g} without '
                 'air: site or times are wrong')
    return Air(test, factors, doubt)


def _fit(frames: Frames, scenario: Scenario, start: LensStart, hours: int | None,
         begin: Array | None) -> _Fit | None:
    """Fit the camera with the air of a time, from one that is nearly right if there is one.

    None where stars would be too low.
    """
    if hours is None:
        scenario = scenario.replace({'observer.site_pressure_hpa': 0.0})
    else:
        frames = replace(frames, stamp_ns=frames.stamp_ns + hours * _HOUR_NS)
    stars = StarDirections(scenario).of(frames)
    spots = bundle_start.identified(frames, stars)
    if not len(spots.frame) or len(spots.frame) < (frames.catalog_id > 0).sum():
        return None
    gate = star_gate(scenario.estimator)
    try:
        found = lens_bundle.fit(spots, start, gate) if begin is None else lens_bundle.finish(
            spots, begin, bundle_start.attitudes(spots, start.lens.unproject(spots.uv, begin)),
            start, gate)
    except np.linalg.LinAlgError:
        return None
    return _Fit(hours, np.sum((found.residual / spots.sigma[:, None])**2, axis=1),
                found.intrinsics, max(found.freedom, 1))
