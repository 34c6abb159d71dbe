# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every method that needs no attitude on images that others took, and pictures of any sky."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros import calibration
from starcal_ros.config.models import detector
from starcal_ros.config.scenario import Scenario
from starcal_ros.imaging.files import is_image
from starcal_ros.reproduction import real_images, sky_cases
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.real_images import ImageSet
from starcal_ros.reproduction.sky_cases import SkyCase
from starcal_ros.workflows.still_images import calibration as still_images, pipeline
from starcal_ros.workflows.still_images.calibration import Refit, StillImageCamera
from starcal_ros.workflows.still_images.pipeline import Conditions

RUNS = 1
COLUMNS = ('set', 'method', 'f (px)', 'sigma f', 'fitted (px)', 'held out (px)', 'reference f',
           'reference fitted', 'reference held out')
NOTES = (
    'RMS residual of an axis, of the stars inside the gate, the attitude of each image fitted and '
    'the camera held; every fourth image is held out. The reference is a bundle fit by others, '
    'its last column with each image held out in turn.',
    'angular_distance, fully weighted, uses what the bundle uses, one image after the other; '
    'singular_value leaves out part of what an image knows. interstar (TCOC) weights all pairs of '
    'stars alike: its sigmas are larger by an eighth.',
    'Own centroids are those of this package in the same images: more stars, and fainter ones, '
    'whose RMS is larger as their stated sigmas say. Of the stars that both have, each measured '
    'and fitted in its own way, it is the same.',
    'sky_cases are pictures that others brought, each beside what an independent fit, or the same '
    'sky in another form, gives; in brackets, within what it is to be. Of the phone, whose lens '
    'moves, sigma f is that of the scatter between its images.')
_BINS = 8


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Calibrate each camera by each method; the scenario and the number of runs do not matter."""
    methods = [name for name in calibration.names() if name != 'predicted_centroid']
    rows: list[tuple[str | float, ...]] = []
    panels = []
    for k, images in enumerate(real_images.SETS):
        curves = []
        for j, method in enumerate(methods):
            found = calibrate(images, method)
            if found is not None:
                rows.append(_row(images, method, found))
                curves.append(_over_radius(found, method))
            on_progress((k + (j + 1) / len(methods)) / len(real_images.SETS))
        rows += _own_centroids(images)
        panels.append(Panel(images.name, 'distance from the middle [px]',
                            'RMS residual of an axis [px]', tuple(curves)))
    rows += [_case(sky_cases.calibrate(folder)) for folder in sky_cases.folders()]
    return Outcome('Real sky', COLUMNS, tuple(rows), NOTES, tuple(panels))


def _own_centroids(images: ImageSet) -> list[tuple[str | float, ...]]:
    """Return the camera of a set from its images, and the residuals of the stars of the table."""
    folder = real_images.folder() / images.name
    if not any(is_image(path) for path in folder.iterdir()):
        return []
    own = pipeline.calibrate(pipeline.of_folder(
        folder, Conditions(images.fov_deg), real_images.HELD_OUT)).camera
    table = calibrate(images, 'bundle')
    assert table is not None            # the reference method knows these images
    both = _stars(own.fit) & _stars(table.fit), _stars(own.heldout) & _stars(table.heldout)
    return [_row(images, 'bundle, own centroids', own),
            *((images.name, f'{label}, stars of both', '', '', _rms(found.fit, both[0]),
               _rms(found.heldout, both[1]), '', '', '')
              for label, found in (('own centroids', own), ('bundle', table)))]


def _stars(part: Refit | None) -> set[tuple[str, int]]:
    """Return image and number of the stars inside the gate."""
    return set() if part is None else {
        (part.names[frame], number) for frame, number in zip(
            _used(part, part.spots.frame).tolist(), _used(part, part.catalog_id).tolist())}


def _rms(part: Refit | None, stars: set[tuple[str, int]]) -> float:
    """Return the RMS residual of an axis of some stars."""
    assert part is not None
    chosen = [(part.names[frame], number) in stars for frame, number in zip(
        part.spots.frame.tolist(), part.catalog_id.tolist())]
    return float(np.sqrt(np.mean(part.adjusted.residual[chosen]**2)))


def _case(case: SkyCase) -> tuple[str | float, ...]:
    result = case.found.as_dict()
    between = (result['sigma_between_images'] or {}).get('f_px', 0.0)
    return (sky_cases.FOLDER, case.name, f'{result["f_px"]:.2f}',
            max(result['sigma']['f_px'], between), result['fit_rms_px'], '',
            f'{case.f_px:.2f} ({case.tolerance_px:.2g})', '', '')


def calibrate(images: ImageSet, method: str) -> StillImageCamera | None:
    """Return the camera of a set by a method that begins at what the stars themselves say."""
    table = real_images.stars(images)
    f_px = still_images.focal_length_px(table, images.width, images.height)
    scenario = still_images.scenario_of(images.width, images.height, f_px, method)
    return still_images.calibrate(table, scenario)


def _row(images: ImageSet, method: str, found: StillImageCamera) -> tuple[str | float, ...]:
    result = found.as_dict()
    return (images.name, method, f'{result["f_px"]:.2f}', result['sigma']['f_px'],
            result['fit_rms_px'], result['heldout_rms_px'], f'{images.reference_f_px:.2f}',
            images.reference_rms_px, images.reference_heldout_px)


def _over_radius(found: StillImageCamera, label: str) -> Curve:
    """Return the residuals of all images over the distance from the middle of the field."""
    parts = [part for part in (found.fit, found.heldout) if part is not None]
    pixels = detector(found.scenario.camera)
    radius = np.concatenate([np.linalg.norm(_used(part, part.spots.uv), axis=-1)
                             for part in parts])
    square = np.concatenate([np.mean(_used(part, part.adjusted.residual)**2, axis=-1)
                             for part in parts])
    edges = np.linspace(0.0, 0.5 * np.hypot(pixels.width, pixels.height), _BINS + 1)
    count, total = (np.histogram(radius, edges, weights=weight)[0] for weight in (None, square))
    seen = count > 0
    middle = 0.5 * (edges[1:] + edges[:-1])
    return Curve(middle[seen], np.sqrt(total[seen] / count[seen]), label, 'marked')


def _used(part: Refit, values: NDArray[Any]) -> NDArray[Any]:
    return values[part.adjusted.used]
