# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal bootstrap``: from a rough camera and unidentified stars to the 16 states."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import STATUS, progress, say, show, show_json
from starcal_ros.config.parameter import ConfigError

DESCRIPTION = ('Calibrate a recording of which only the focal length is known, to a tenth, and no '
               'star by its number (numbers in the recording are ignored): self-calibration, '
               'identification, angular distances, the 16-state filter, each from what the last '
               'one found, on frames of its own. Where there are images and no centroids, the '
               'stars are measured in them. Needs the extra identify.')

_NODES = ('estimator', 'intrinsics_estimator', 'centroid_extractor', 'star_identifier')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_config(parser, recorded=True)
    arguments.add_topics(parser)
    parser.add_argument('--images', action='store_true',
                        help='measure the stars in the images even where the recording has '
                        'centroids')
    parser.add_argument('--out', metavar='RESULT.json',
                        help='the result of the filter, with the camera after each step')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what --out writes')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    scenario = arguments.scenario_of(options.bag, options, _NODES)
    out = Path(options.out) if options.out else None
    outputs.claim([out], [options.bag, options.config], options.overwrite)
    from starcal_ros import report
    from starcal_ros.core import verdict_words
    from starcal_ros.filter import verdict
    from starcal_ros.recording import reader
    from starcal_ros.results import document, result
    from starcal_ros.results.attached_truth import attached_truth
    try:
        from starcal_ros.recording.measured_images import ImageMeter, as_measured
        from starcal_ros.workflows.bootstrap import bootstrap
        with progress('reading') as on_progress:
            recording = reader.read(options.bag, on_progress, measure=ImageMeter(scenario),
                                    images_first=options.images, choice=arguments.topics(options))
        if recording.measured:
            scenario = as_measured(scenario)
        with progress('bootstrap') as on_progress:
            chain = bootstrap(recording.gyro, recording.frames, scenario, on_progress)
    except ImportError as error:
        raise ConfigError(str(error)) from None
    for text in (*recording.warnings, *chain.notices):
        say(f'warning: {text}')
    outcome = result.result(chain.calibrator, result.provenance(scenario, recording),
                            chain.progress)
    outcome['steps'] = [{'step': step.name, **result.camera(step.camera)}
                        for step in chain.steps]
    truth, doubts = attached_truth(recording.attachments)
    for text in doubts:
        say(f'warning: {text}')
    show(report.chain(outcome['steps'], truth, f'Bootstrap of {options.bag}'))
    stars = chain.frames.catalog_id
    show(f'{(stars > 0).sum()} of {len(stars)} spots identified. {report.summary(outcome)}')
    if outcome['verdict'] == verdict_words.INCONSISTENT:
        show(report.table(report.rows(outcome, truth), 'The 16 states'))
    judged = verdict.of(chain.calibrator, chain.progress)
    show(f'Verdict: {report.symbols(judged.summary)}')
    if out is not None:
        document.write_json(out, outcome)
    show_json(outcome)
    return STATUS[outcome['verdict']]
