# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether still images show one camera: each alone, and all but some of them.

An autofocus, a stabiliser or a zoom that creeps moves the camera from image to image. Each image
alone then asks for another focal length and principal point than all together do, and the formal
sigma, of the noise of the stars, promises too much. What the scatter between images makes of the
joint camera is told by the jackknife: with G groups of images, each left out once ::

    V = (G - 1) / G  sum over g of (x_g - mean)^2                                     (O.1)

(Efron 1982, *The jackknife, the bootstrap and other resampling plans*, Ch. 3; the groups keep the
cost of many images bounded.) It has the noise in it as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.calibration import bundle_adjustment
from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.calibration.lens_bundle import LensStart
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.calibration.residual_tests import IMAGES
from starcal_ros.config.models import star_gate
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.distributions import f_isf
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.statistic import ALARM, Statistic
from starcal_ros.workflows.still_images import opencv_camera
from starcal_ros.workflows.still_images.table import StillImages

LEAST_IMAGES = 4
"""Images whose scatter tells a sigma."""

_GROUPS = 20
_NAMED = 5
_LEAST_STARS = 12       # of an image that is fitted alone,
_SPARE_STARS = 5        # and more than there are parameters
_OWN = [0, 1, 2]        # u0, v0, f of the intrinsics


class OwnCamera(NamedTuple):
    """The camera of an image alone.

    Attributes
    ----------
    name : str
        Image.
    keys : tuple of str
        Parameters of its lens model, as `opencv_camera.keys` has them.
    values, sigma : (p,) array
        Of each.
    disagrees : bool
        Whether focal length and principal point are not those of all, beyond chance; what each
        image has for itself (``intrinsics.free``) left aside.
    """

    name: str
    keys: tuple[str, ...]
    values: Array
    sigma: Array
    disagrees: bool

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {'image': self.name, **dict(zip(self.keys, self.values.tolist())),
                'sigma': dict(zip(self.keys, self.sigma.tolist())),
                'disagrees': self.disagrees}


def own_cameras(names: tuple[str, ...], spots: Observations, adjusted: Adjusted,
                estimate: CameraEstimate, scenario: Scenario, start: LensStart
                ) -> tuple[OwnCamera, ...]:
    """Fit a camera to each image alone, where its stars suffice.

    Parameters
    ----------
    names : tuple of str
        Images, as `spots` counts them.
    spots, adjusted : Observations, Adjusted
        Their stars with the camera of all.
    estimate : CameraEstimate
        That camera.
    scenario : Scenario
        Pixels, gate.
    start : LensStart
        What was known before.
    """
    free = estimate.sigma > 0.0
    prior, keys = start.covariance * np.outer(free, free), opencv_camera.keys(start.lens)
    own = [k for k in _OWN if free[k] and start.lens.parameters[k] not in scenario.intrinsics.free]
    least = max(_LEAST_STARS, int(free.sum()) + _SPARE_STARS)
    found = []
    for k, name in enumerate(names if own else ()):
        row = spots.frame == k
        if row.sum() < least:
            continue
        mine = Observations(np.zeros(row.sum(), np.int64), spots.uv[row], spots.sigma[row],
                            spots.u_i[row], spots.point[row])
        alone = bundle_adjustment.adjust(
            mine, estimate.intrinsics, adjusted.C_si[k:k + 1], np.empty((0, 3)),
            start.lens, prior, star_gate(scenario.estimator))
        if alone.used.sum() < least:
            continue
        covariance = alone.scale**2 * alone.covariance
        off = (alone.intrinsics - estimate.intrinsics)[own]
        excess = float(off @ np.linalg.solve(covariance[np.ix_(own, own)], off)) / len(own)
        values, wide = opencv_camera.from_estimate(
            CameraEstimate(alone.intrinsics, covariance, 1, int(alone.used.sum())), scenario,
            start.lens)
        found.append(OwnCamera(
            name, keys, values, np.sqrt(np.diag(wide)),
            bool(excess > f_isf(ALARM / len(names), len(own), alone.freedom))))
    return tuple(found)


def scattered(own: tuple[OwnCamera, ...], formal: Array) -> Array:
    """Return the variances (p,) of the mean of cameras that differ from image to image.

    What their estimates scatter beyond their own sigmas is shared by the root of their number;
    beside it stands the formal variance (p,).
    """
    values, sigma = (np.array(each) for each in zip(*((one.values, one.sigma) for one in own)))
    beyond = np.maximum(values.var(axis=0, ddof=1) - np.mean(sigma**2, axis=0), 0.0)
    return np.asarray(formal + beyond / len(own))


def disagreement(own: tuple[OwnCamera, ...]) -> Statistic:
    """Return how many images ask for a camera of their own, of which none is allowed."""
    odd = [each for each in own if each.disagrees]
    scatter = float(np.std([each.values[0] for each in own], ddof=1)) if len(own) > 1 else 0.0
    fits = (f'{", ".join(each.name for each in odd[:_NAMED])}{" ..." * (len(odd) > _NAMED)}: the '
            f'focal lengths of single images scatter by {scatter:.3g} px') if odd else ''
    return Statistic(IMAGES, float(len(odd)), 0.0, 0.0, len(own), fits=fits)


def jackknife(images: StillImages, scenario: Scenario, begin: Callable[[], CameraMethod],
              lens: LensModel) -> Array | None:
    """Return the variances (p,) of the camera from the scatter between images, Eq. (O.1).

    In the order of `opencv_camera.keys`; None of fewer than LEAST_IMAGES.

    Parameters
    ----------
    images : StillImages
        Those that were fitted.
    scenario : Scenario
        Pixels.
    begin : callable
        Begins the method that they were fitted by.
    lens : LensModel
        What the camera is.
    """
    if len(images.names) < LEAST_IMAGES:
        return None
    values = np.array([*_without(images, scenario, begin, lens)])
    if len(values) < LEAST_IMAGES:
        return None
    off = values - values.mean(axis=0)
    return np.asarray((len(values) - 1.0) / len(values) * (off**2).sum(axis=0))


def _without(images: StillImages, scenario: Scenario, begin: Callable[[], CameraMethod],
             lens: LensModel) -> Iterator[Array]:
    """Yield the camera (p,) of all images but each group of them."""
    group = np.arange(len(images.names)) % min(_GROUPS, len(images.names))
    for left_out in range(group.max() + 1):
        method = begin()
        method.add_frames(images.which(group != left_out).frames)
        part = method.estimate()
        if part is not None:
            yield opencv_camera.from_estimate(part, scenario, lens)[0]
