# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal compare``: whether calibrations agree."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import progress, say, show, show_json
from starcal_ros.config.parameter import ConfigError

if TYPE_CHECKING:
    from starcal_ros.core.arrays import Array
    from starcal_ros.core.camera import Detector
    from starcal_ros.results.comparison import Agreement, OverDetector, Trend
    from starcal_ros.results.read import StoredResult

DESCRIPTION = ('Tell by how much calibrations of one instrument differ: each state in sigmas, the '
               'cameras in pixels over the detector (less the turn that a mounting or an attitude '
               'would take), and whether chance explains it. Of three and more with stamps also '
               'how they go with time. Exit status 0: camera and mounting agree; 4: they do not; '
               '2: wrong input.')
_DIFFER = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument('results', metavar='RESULT', nargs='+',
                        help='RESULT.json of calibrate, bootstrap or intrinsics (of a recording), '
                        'or the folder of a saved calibration; two or more, the first is what '
                        'the others are compared with; or one recording, with --cross-validate')
    parser.add_argument('--cross-validate', metavar='N', type=int,
                        help='compare calibrations of N parts of one recording')
    parser.add_argument('--temperature', metavar='C,C,…',
                        help='temperature of the instrument at each result, deg C: how the states '
                        'go with it')
    parser.add_argument('--config', metavar='FILE', help='parameter file that states the '
                        'detector, where the results do not; of --cross-validate the scenario, '
                        'default: that of the recording')
    parser.set_defaults(namespace=None)
    arguments.add_json(parser, 'all of it')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.results import comparison
    results, notices = _parts(options) if options.cross_validate is not None else _read(options)
    detector = _detector(results, options)
    notices += _notices(results, detector)
    temperature = _temperature(options.temperature, len(results))
    for text in notices:
        say(f'warning: {text}')
    first, *others = results
    found = comparison.agreements(results)
    differ = comparison.differing(found)
    states = [comparison.states(first, each) for each in others]
    maps = [comparison.over_detector(first, each, detector) for each in others] if detector else []
    trends = comparison.trends(results)
    warmth = [] if temperature is None else comparison.trends_over(results, temperature)
    if options.json:
        show_json({
            'results': [{'name': each.name, 'stamp_ns': each.stamp_ns, 'verdict': each.verdict}
                        for each in results],
            'agree': not differ, 'differ': differ, 'warnings': notices,
            'groups': {name: _agreement(each) for name, each in found.items()},
            'less_the_first': [{
                'name': each.name, 'states': [state._asdict() for state in rows],
                'over_the_detector': _over(maps[k]) if maps else None}
                for k, (each, rows) in enumerate(zip(others, states))],
            'trends': [_trend(each, 'slope_a_day') for each in trends],
            'trends_with_temperature': [_trend(each, 'slope_a_kelvin') for each in warmth]})
        return _DIFFER if differ else 0
    from starcal_ros.report import comparison as report
    show(report.differences([each.name for each in results], states))
    for each, over in zip(others, maps):
        show(report.detector_line(each.name, over))
    if trends:
        show(report.trend_table(trends))
    if warmth:
        show(report.trend_table(warmth, 'temperature', 'kelvin'))
    for text in report.verdict_lines(found, differ):
        show(text)
    return _DIFFER if differ else 0


def _read(options: argparse.Namespace) -> tuple[list[StoredResult], list[str]]:
    """Return the results that are named."""
    from starcal_ros.results.read import read_result
    from starcal_ros.results.document import CalibrationError
    if len(options.results) < 2:
        raise ConfigError(f'{options.results[0]}: alone; needs two results or more, or '
                          '--cross-validate N for a recording')
    try:
        return [read_result(Path(name)) for name in options.results], []
    except CalibrationError as error:
        raise ConfigError(str(error)) from None


def _parts(options: argparse.Namespace) -> tuple[list[StoredResult], list[str]]:
    """Return the calibrations of the parts of a recording, and what is to be said of them."""
    from starcal_ros.recording import reader
    from starcal_ros.workflows.cross_validation import calibrate_parts, hardly_seen
    if len(options.results) > 1:
        raise ConfigError('--cross-validate: takes one recording, got '
                          f'{len(options.results)} names')
    if options.cross_validate < 2:
        raise ConfigError(f'--cross-validate: got {options.cross_validate}, needs 2 or more')
    bag = options.results[0]
    scenario = arguments.scenario_of(bag, options, ('estimator',))
    with progress('reading') as on_progress:
        recording = reader.read(bag, on_progress)
    with progress('calibrating') as on_progress:
        results = calibrate_parts(recording.gyro, recording.frames, scenario,
                                  options.cross_validate, on_progress)
    return results, [*recording.warnings, *hardly_seen(results, scenario)]


def _temperature(text: str | None, results: int) -> Array | None:
    """Return the temperatures that are given, one a result."""
    import numpy as np
    if text is None:
        return None
    try:
        values = np.array([float(word) for word in text.split(',')])
    except ValueError:
        values = np.empty(0)
    if len(values) != results or not np.isfinite(values).all():
        raise ConfigError(f'--temperature: got {text!r}, needs {results} numbers, one for each '
                          'result, such as ' + ','.join(['20.5'] * results))
    return values


def _detector(results: Sequence[StoredResult], options: argparse.Namespace) -> Detector | None:
    """Return the detector that all results are of; None where nothing tells it."""
    known = {each.name: each.detector for each in results if each.detector}
    if options.config:
        from starcal_ros.config import parameter_file
        from starcal_ros.config.models import detector
        known[options.config] = detector(parameter_file.load(options.config).camera)
    if len({*known.values()}) > 1:
        raise ConfigError('these are not of one detector: ' + ', '.join(
            f'{name} has {of.width} x {of.height} pixels of {of.pitch_mm:g} mm'
            for name, of in known.items()))
    return next(iter(known.values()), None)


def _notices(results: Sequence[StoredResult], detector: Detector | None) -> Iterator[str]:
    for a, b in combinations(results, 2):
        if a.bag_sha256 and a.bag_sha256 == b.bag_sha256:
            yield (f'{a.name} and {b.name} are of the same recording: they share their noise, and '
                   'sigmas of the difference and chance do not hold')
        elif Path(b.began_with) == Path(a.name) or Path(a.began_with) == Path(b.name):
            yield (f'{a.name} and {b.name}: one began with what the other found, so they are not '
                   'independent: sigmas of the difference and chance do not hold')
    for each in results:
        if each.verdict in ('inconsistent', 'lost'):
            yield f'{each.name} is {each.verdict}: its sigmas are not to be believed'
    if detector is None:
        yield ('no result states its detector: nothing is told in pixels; --config FILE, or '
               'the folder of a saved calibration, would')


def _trend(found: Trend, slope: str) -> dict[str, Any]:
    return {'name': found.name, slope: found.slope, 'sigma': found.sigma,
            'constant': _agreement(found.constant), 'line': _agreement(found.line)}


def _agreement(found: Agreement) -> dict[str, Any]:
    return {'chi2': found.chi2, 'degrees_of_freedom': found.freedom,
            'probability': found.probability}


def _over(found: OverDetector) -> dict[str, Any]:
    import numpy as np

    from starcal_ros.core.units import ARCSEC
    return {'rms_px': float(np.sqrt(np.mean(found.length**2))),
            'rms_by_the_sigmas_px': float(np.sqrt(2.0 * np.mean(found.sigma**2))),
            'most_px': float(found.length.max()),
            'turn_taken_out_arcsec': (found.turn / ARCSEC).tolist(),
            'turn_in_gyro_axes_arcsec': None if found.net is None else
            (found.net / ARCSEC).tolist(),
            'turn_in_gyro_axes_sigma_arcsec': None if found.net_sigma is None else
            (found.net_sigma / ARCSEC).tolist(),
            'u_px': found.uv[0, :, 0].tolist(), 'v_px': found.uv[:, 0, 1].tolist(),
            'difference_px': found.difference.tolist(), 'sigma_px': found.sigma.tolist()}
