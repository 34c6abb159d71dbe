# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sections of the report of a calibration that have charts."""

from __future__ import annotations

import numpy as np

from starcal_ros.config.models import detector, intrinsics
from starcal_ros.core.arrays import Array
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.units import NS
from starcal_ros.core.verdict_words import INCONSISTENT
from starcal_ros.report import (coverage_charts, detector_charts, projection_charts,
                                residual_charts, statistic_charts, time_charts)
from starcal_ros.report.calibration import Calibration, camera_of
from starcal_ros.report.markup import (PageSection, Part, charts, items, key, paragraph, section,
                                       table)
from starcal_ros.report.page_tables import LABEL
from starcal_ros.report.residual_charts import StarResiduals
from starcal_ros.report.states import errors

_STATES, _CAMERA = slice(6, 16), slice(9, 16)       # mounting and camera, camera alone


def convergence(calibration: Calibration) -> list[PageSection]:
    """Return how the estimates came about."""
    history = calibration.history
    known = calibration.truth is not None
    against = 'truth' if known else 'final estimate'
    n = history.frames
    drawn = len(time_charts.thinned(len(history.stamp_ns)))
    thin = f' Of {n} frames {drawn} are drawn.' if drawn < n else ''
    last = errors(history, calibration.truth)[-1]
    return [section(
        'convergence', 'Convergence',
        paragraph(f'Estimate minus {against} with 3-sigma bounds, scaled to the bound at one '
                  f'fifth of the run.{thin} Converged is what has its bounds inside of three '
                  'times the tolerance; lines that are not there are beyond the chart.'),
        key([('curve', f'estimate minus {against}'), ('band', '3 sigma'),
             ('dashed', '3 × tolerance'), ('dotted', 'what it began with'),
             ('mark', 'no error' if known else 'final estimate')]),
        charts(time_charts.convergence(
            history, calibration.truth,
            [state.tolerance for state in calibration.verdict.states],
            (last - calibration.change).tolist())))]


def projection(calibration: Calibration) -> list[PageSection]:
    """Return how well the projection is known, and how it has changed."""
    pixels, found = detector(calibration.scenario.camera), calibration.camera
    covariance = np.array(calibration.outcome['covariance'])
    doubt = (' The data contradict the model: these sigmas are not to be believed.'
             if calibration.verdict.word == INCONSISTENT else '')
    return [section(
        'projection', 'Projection',
        paragraph('First, how far off the place of a star is on the detector by the camera alone, '
                  'a turn of all stars taken out; second, how far off the direction of a pixel is '
                  'in the gyro axes, by camera and mounting together. 1 sigma of each of two axes.'
                  ' Third, by how much the calibration has moved the stars, a turn of all taken '
                  'out.' + doubt),
        charts([
            projection_charts.camera_sigmas(
                pixels, found, covariance[_CAMERA, _CAMERA], Tan2018Lens(pixels.pitch_mm),
                found[2] / pixels.pitch_mm)[0],
            projection_charts.direction_sigma(pixels, found, covariance[_STATES, _STATES]),
            projection_charts.change_map('Found less what it began with', pixels,
                                         intrinsics(calibration.scenario.camera), found)]))]


def coverage(calibration: Calibration) -> list[PageSection]:
    """Return what the stars cover of the detector, and how far the gyros turned."""
    history, pixels = calibration.history, detector(calibration.scenario.camera)
    uv = history.stars.uv_raster[history.stars.accepted]
    figure, told = coverage_charts.star_counts(uv, pixels)
    turned = np.degrees(history.turned)
    return [section(
        'coverage', 'Coverage', paragraph(told),
        charts([figure, coverage_charts.radial_counts(uv, pixels)]),
        table(['gyro axis', 'turned, forth and back [°]'],
              [[axis, f'{angle:.0f}'] for axis, angle in zip('xyz', turned)]),
        *([paragraph('About an axis that was hardly turned, scale and mounting of the gyros are '
                     'hardly seen.')] if turned.min() < 0.1 * turned.max() else []))]


def residuals(calibration: Calibration) -> list[PageSection]:
    """Return the residuals over the detector and against what they should not depend on."""
    history, pixels = calibration.history, detector(calibration.scenario.camera)
    stars = history.stars
    used = stars.residual[stars.accepted]
    u, v = np.sqrt(np.mean(used**2, axis=0)) if len(used) else (0.0, 0.0)
    cells = detector_charts.CELLS
    which = (f'all {len(used)} stars used' if history.every == 1 else
             f'the {len(used)} stars used of one frame in {history.every}')
    minutes = np.repeat((history.stamp_ns - history.stamp_ns[0]) * NS / 60.0, history.seen)
    return [section(
        'residuals', 'Residuals',
        paragraph(f'Measured minus predicted centroid after the update, of {which}: RMS '
                  f'{u:.4f}, {v:.4f} px. The map averages them over {cells} by {cells} cells of '
                  'the detector; the lines in the histograms are the Gaussian that '
                  'the stated sigmas promise.'),
        charts([detector_charts.residual_map(stars, pixels),
                *detector_charts.residual_histograms(stars)]),
        *against(StarResiduals(used, stars.sigma[stars.accepted],
                               stars.uv_raster[stars.accepted] - used - pixels.centre_raster,
                               pixels.centre_raster, stars.catalog_id[stars.accepted]),
                 minutes[stars.accepted]))]


def against(stars: StarResiduals, minutes: Array | None) -> list[Part]:
    """Return the parts of a section on residuals that depend on something."""
    figure, worst, told = residual_charts.star_by_star(stars)
    return [
        '<h3>Against what they should not depend on</h3>',
        key([('curve', 'u, or outward'), ('mark', 'v, or across'), ('dashed', 'stated sigma')]),
        charts(residual_charts.against(stars, minutes)),
        '<h3>Star by star</h3>', paragraph(told), charts([figure] if figure else []),
        *([table(['HIP', 'Hp', 'B − V', 'times', 'mean u [px]', 'mean v [px]',
                  'in sigmas of the mean'], worst)] if worst else [])]


def consistency(calibration: Calibration) -> list[PageSection]:
    """Return the tests of the innovations."""
    figure, text = time_charts.consistency(calibration.history)
    white, said = time_charts.whiteness(calibration.history)
    tests, stamps = calibration.tests, calibration.history.stamp_ns
    if calibration.verdict.statistics:
        tests = [*tests, (int(stamps[-1]), calibration.verdict.statistics)]
    drawn = statistic_charts.statistics(tests, int(stamps[0]))
    failing = sum(not each.passed for each in calibration.verdict.statistics)
    told = (f'{failing} of {len(drawn)} tests of the innovations fail. ' if failing else
            f'All {len(drawn)} tests of the innovations pass. ') if drawn else (
            'There are too few frames for the tests of the innovations.')
    how = ('Each is drawn, minute by minute, by its place in the band that it keeps where the '
           'model is right, beyond it on a logarithmic scale: at 10 × it is ten half widths away '
           'from the middle.') if drawn else ''
    return [section('consistency', 'Consistency', paragraph(told + how), charts(drawn),
                    items([text, said]), charts([white, figure]))]


def distortion(calibration: Calibration) -> list[PageSection]:
    """Return the distortion before and after, and what is wrong of it where the truth is known."""
    pixels = detector(calibration.scenario.camera)
    before, after = intrinsics(calibration.scenario.camera), calibration.camera
    flat = not before[3:].any()
    maps = [] if flat else [detector_charts.distortion_map('Nominal', pixels, before)]
    maps.append(detector_charts.distortion_map('Estimated', pixels, after))
    if calibration.truth is not None:
        true = camera_of(calibration.truth)
        maps += [
            detector_charts.distortion_map('Nominal − truth', pixels, before, true),
            detector_charts.distortion_map('Estimate − truth', pixels, after, true)]
    return [section(
        'distortion', 'Distortion',
        paragraph('How far the lens moves the image of a star from where a pinhole camera has '
                  'it, before and after the calibration. Each map has its own scale.'
                  + (' The nominal camera has none.' if flat else '')),
        charts(maps))]


def coupling(calibration: Calibration) -> list[PageSection]:
    """Return what can not be told apart."""
    verdict = calibration.verdict
    sigma = calibration.outcome['intrinsics_sigma']
    u, v = verdict.equivalent_sigma_px
    return [section(
        'coupling', 'Coupling',
        paragraph('Principal point and fixed angles move the stars almost alike (T18 Sec. 3.4). '
                  'Their common effect, the equivalent principal point, is known long before '
                  f'them: sigma {u:.2g}, {v:.2g} px, of u0 and v0 {sigma["u0_px"]:.2g}, '
                  f'{sigma["v0_px"]:.2g} px. The attitude is counted in star tracker axes.'),
        charts([detector_charts.correlation(
                    tuple(LABEL.get(name, name) for name in verdict.names),
                    verdict.correlation),
                *time_charts.equivalent_principal_point(
                     calibration.history, calibration.truth,
                     calibration.scenario.camera.pixel_pitch_mm)]))]
