# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The group ``image``: what a rendered frame looks like, and how centroids are found in one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from starcal_ros.config.parameter import Spec


@dataclass(frozen=True)
class CentroidConfig:
    """How spots are found in an image and measured."""

    threshold: Annotated[float, Spec(
        'Least peak of a spot over the background, in standard deviations of the smoothed noise',
        '', 2.0, 1e3)] = 5.0
    gain_electrons: Annotated[float | None, Spec(
        'Electrons a count; left out, the scatter about the fitted spot tells its noise',
        'e', 1e-4, 1e6)] = None
    saturation_counts: Annotated[float | None, Spec(
        'Counts from which a pixel is saturated; left out, the top of the type of the image',
        'counts', 1.0, 1e9)] = None
    max_spots: Annotated[int, Spec('Brightest spots that are kept', '', 1, 10000)] = 200


@dataclass(frozen=True)
class ImageConfig:
    """The true images of the simulated star tracker, and the centroids found in any.

    By default a star of Hp 6 is measured to 0.05 px at rest, and seen down to Hp 7.6.
    """

    psf_sigma_px: Annotated[float, Spec(
        'Standard deviation of the spot of a star at rest', 'px', 0.3, 20.0)] = 0.7
    zero_point_electrons_s: Annotated[float, Spec(
        'Electrons a second of a star of Hp 0', 'e/s', 1.0, 1e12)] = 1e6
    limiting_magnitude: Annotated[float, Spec('Faintest star in the images, Hp', 'mag', -2.0, 14.0)
                                  ] = 8.0
    sky_electrons_s: Annotated[float, Spec(
        'Background of sky and stray light in each pixel', 'e/s', 0.0, 1e6)] = 20.0
    dark_electrons_s: Annotated[float, Spec('Dark current of a pixel', 'e/s', 0.0, 1e6)] = 5.0
    read_noise_electrons: Annotated[float, Spec('Noise of the readout', 'e', 0.0, 1e4)] = 8.0
    gain_electrons: Annotated[float, Spec('Electrons a count', 'e', 1e-3, 1e4)] = 1.0
    offset_counts: Annotated[float, Spec('Counts of a pixel without electrons', 'counts',
                                         0.0, 6e4)] = 200.0
    full_well_electrons: Annotated[float, Spec(
        'Electrons that a pixel holds; where the counts of so many are less than '
        'saturation_counts, centroid.saturation_counts has to say so', 'e', 1.0, 1e7)] = 1e5
    saturation_counts: Annotated[int, Spec('Largest count', 'counts', 1, 65535)] = 65535
    hot_pixels: Annotated[int, Spec('Hot pixels, at the same places in every frame', '', 0, 10000)
                          ] = 0
    hot_electrons_s: Annotated[float, Spec(
        'Mean dark current of a hot pixel; theirs are exponentially distributed', 'e/s', 0.0, 1e8)
    ] = 1e4
    false_magnitude: Annotated[float | None, Spec(
        'Magnitude of an object that is no star, at a new place in each frame; left out, none',
        'mag', -30.0, 14.0)] = None
    false_rate_px_s: Annotated[float, Spec(
        'How fast that object moves: 0 is a planet, more a satellite', 'px/s', 0.0, 1e5)] = 0.0
    centroid: CentroidConfig = field(default_factory=CentroidConfig)
