# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a camera calibrated with still images: one page of HTML."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

import starcal_ros
from starcal_ros.config import parameter_file
from starcal_ros.config.models import detector
from starcal_ros.filter.history import Residuals
from starcal_ros.report import coverage_charts, detector_charts, projection_charts
from starcal_ros.report.annotated import Annotated
from starcal_ros.report.calibration import called, made
from starcal_ros.report.cameras import entry, entry_columns, verdict_lines
from starcal_ros.report.markup import Page, PageSection, charts, items, paragraph, section, table
from starcal_ros.report.page_charts import against
from starcal_ros.report.residual_charts import StarResiduals
from starcal_ros.workflows.still_images.calibration import Refit, StillImageCamera
from starcal_ros.workflows.still_images.opencv_camera import KEYS

_OWN = KEYS[:3]
_PICTURES, _LONGEST_PX, _QUALITY = 8, 800, 50       # of some 0.1 MB


def still_images_page(found: StillImageCamera, outcome: dict[str, Any], notices: list[str],
                      command: str = '', drawn: Sequence[Annotated] = ()) -> Page:
    """Return the report of a camera.

    Parameters
    ----------
    found : StillImageCamera
    outcome : dict
        Its result as written, with ``method``, ``source`` and, by name, ``left_out`` images.
    notices : list of str
        What a user should know.
    command : str
        That was given.
    drawn : sequence of Annotated
        Pictures to show.
    """
    return Page(f'Camera of {called(outcome["source"])}', tuple(_facts(found, outcome, command)), (
        _verdict(outcome), _camera(outcome), _projection(found, outcome), _coverage(found),
        *_images(found), *_each_image(outcome), *_left_out(outcome), *_pictures(drawn),
        _distortion(found), _coupling(outcome), section(
            'notices', 'Notices', items(notices) if notices else paragraph('No notices.'),
            '<details><summary>Configuration</summary><pre>'
            f'{escape(parameter_file.dump(found.scenario))}</pre></details>')))


def shown(names: Sequence[str], left_out: Mapping[str, str]) -> set[str]:
    """Return the images that a report has room to show, those that are left out first."""
    return set(sorted(names, key=lambda name: name not in left_out)[:_PICTURES])


def _pictures(drawn: Sequence[Annotated]) -> list[PageSection]:
    figures = ''.join(
        f'<figure><figcaption>{escape(each.name)}: {escape(each.caption)}</figcaption>'
        f'<img alt="{escape(each.name)}" src="data:image/jpeg;base64,'
        f'{b64encode(each.jpeg(_LONGEST_PX, _QUALITY)).decode()}"></figure>' for each in drawn)
    return [section('pictures', 'Pictures', paragraph(
        f'At most {_PICTURES} are shown, those that are left out first; --annotate draws all.'),
        f'<div class="charts">{figures}</div>')] if drawn else []


def _facts(found: StillImageCamera, outcome: dict[str, Any], command: str
           ) -> list[tuple[str, str]]:
    camera, f = found.scenario.camera, outcome['f_px']
    edges = 0.5 * np.array([[[camera.width, 0.0]], [[0.0, camera.height]]]) * [[-1.0], [1.0]]
    lens, values = found.optics
    field = np.degrees(np.arccos(lens.unproject(edges, values)[..., 2])).sum(axis=-1)
    return [('Images', f'{outcome["counts"]["images"]} of {outcome["source"]}'),
            ('Camera', f'{camera.width} × {camera.height} px, f = {f:.5g} px, {field[0]:.3g}° × '
             f'{field[1]:.3g}°'),
            *made(command, starcal_ros.__version__)]


def _projection(found: StillImageCamera, outcome: dict[str, Any]) -> PageSection:
    pixels, (lens, values) = detector(found.scenario.camera), found.optics
    covariance = found.estimate.covariance[:len(values), :len(values)]
    doubt = (' The sigmas are not to be believed.' if outcome['verdict'] == 'inconsistent' else '')
    return section(
        'projection', 'Projection',
        paragraph('How far off the place of a star is on the detector, a turn of all stars taken '
                  'out: 1 sigma of each of two axes.' + doubt),
        charts(projection_charts.camera_sigmas(pixels, values, covariance, lens,
                                               outcome['f_px'])))


def _coverage(found: StillImageCamera) -> PageSection:
    pixels = detector(found.scenario.camera)
    uv = found.fit.spots.uv[found.fit.adjusted.used] + pixels.centre_raster
    figure, told = coverage_charts.star_counts(uv, pixels)
    return section('coverage', 'Coverage', paragraph(told),
                   charts([figure, coverage_charts.radial_counts(uv, pixels)]))


def _verdict(outcome: dict[str, Any]) -> PageSection:
    first, *others = verdict_lines(outcome)
    rows = [[each['name'], f'{each["value"]:.4g}', f'{each["low"]:.4g} to {each["high"]:.4g}',
             str(each['samples']), 'passed' if each['passed'] else 'failed']
            for each in outcome['consistency']]
    return section(
        'verdict', 'Verdict',
        f'<p class="verdict {"yes" if outcome["converged"] else "no"}">{escape(first)}</p>',
        items(others) if others else '',
        table(['test of the residuals', 'value', 'allowed', 'parts', ''], rows) if rows else '')


def _camera(outcome: dict[str, Any]) -> PageSection:
    counts = outcome['counts']
    return section(
        'camera', 'Camera',
        paragraph(f'{counts["images"]} images, {counts["stars"]} stars used, '
                  f'{counts["rejected_stars"]} rejected; method {outcome["method"]}, lens '
                  f'{outcome["lens"]}. OpenCV\'s forward model, (0, 0) the centre of the top-left '
                  'pixel. A centroid has a sigma '
                  f'of {outcome["centroid_sigma_px"]:.4f} px in each axis, from the residuals.'),
        table(list(entry_columns(outcome)),
              [entry(outcome, key) for key in outcome['parameters']]))


def _images(found: StillImageCamera) -> list[PageSection]:
    sections = [_residuals('fit', 'Images fitted', found.fit, found)]
    if found.heldout is not None:
        sections.append(_residuals('heldout', 'Images held out', found.heldout, found))
    return sections


def _each_image(outcome: dict[str, Any]) -> list[PageSection]:
    own = outcome.get('own_f_px', {})
    rows = [[each['image'], *([_value(own.get(each['image']))] if own else []),
             *(f'{each[key]:.2f}' for key in _OWN),
             *(f'{each["sigma"][key]:.2f}' for key in _OWN),
             'another camera' if each['disagrees'] else ''] for each in outcome['each_image']]
    return [section(
        'each-image', 'Images one by one',
        paragraph('The camera that each image alone asks for. Those that ask for another one than '
                  'all together do, beyond chance, are marked.'),
        table(['image', *(['f, the rest shared [px]'] if own else []), 'f [px]', 'u0 [px]',
               'v0 [px]', 'sigma f', 'sigma u0', 'sigma v0', ''], rows))] if rows else []


def _value(found: dict[str, float] | None) -> str:
    return f'{found["f_px"]:.2f} ± {found["sigma"]:.2f}' if found else ''


def _left_out(outcome: dict[str, Any]) -> list[PageSection]:
    reasons = outcome.get('left_out')
    return [section('left-out', 'Images left out',
                    table(['image', 'reason'], [list(item) for item in reasons.items()]))
            ] if reasons else []


def _residuals(name: str, title: str, refit: Refit, found: StillImageCamera) -> PageSection:
    spots, adjusted = refit.spots, refit.adjusted
    used = adjusted.used
    pixels = detector(found.scenario.camera)
    stars = Residuals(spots.uv + pixels.centre_raster, adjusted.residual, adjusted.used,
                      spots.sigma, refit.catalog_id)
    rows = []
    for k, image in enumerate(refit.names):
        mine = adjusted.used & (spots.frame == k)
        u, v = np.sqrt(np.mean(adjusted.residual[mine]**2, axis=0)) if mine.any() else (0.0, 0.0)
        rows.append([image, str(mine.sum()), str((spots.frame == k).sum() - mine.sum()),
                     f'{u:.4f}', f'{v:.4f}'])
    return section(
        name, title,
        paragraph(f'Measured minus predicted centroid, the attitude of each image fitted and the '
                  f'camera held: RMS {refit.rms_px:.4f} px an axis.'),
        table(['image', 'stars', 'rejected', 'RMS u [px]', 'RMS v [px]'], rows),
        charts([detector_charts.residual_map(stars, pixels),
                *detector_charts.residual_histograms(stars)]),
        *against(StarResiduals(
            adjusted.residual[used], spots.sigma[used], (spots.uv - adjusted.residual)[used],
            pixels.centre_raster, refit.catalog_id[used]), None))


def _distortion(found: StillImageCamera) -> PageSection:
    return section(
        'distortion', 'Distortion',
        paragraph('How far the lens moves the image of a star from where the same lens without '
                  'distortion has it.'),
        charts([detector_charts.distortion_map('Estimated', detector(found.scenario.camera),
                                               found.optics[1], lens=found.optics[0])]))


def _coupling(outcome: dict[str, Any]) -> PageSection:
    covariance = np.array(outcome['covariance'])
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    free = sigma > 0.0
    names = tuple(key.partition('_')[0] for key in np.array(outcome['parameters'])[free].tolist())
    return section(
        'coupling', 'Coupling',
        paragraph('Parameters that are strongly correlated are known together, not one by one: '
                  'the principal point with the tangential distortion, f with k1.'),
        charts([detector_charts.correlation(
            names, (covariance / np.outer(scale, scale))[np.ix_(free, free)])]))
