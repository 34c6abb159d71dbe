# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal montecarlo``: one scenario, many seeds."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from starcal_ros.cli import arguments, cluster, outputs
from starcal_ros.cli.terminal import progress, show, show_json
from starcal_ros.config.scenario import parameters

DESCRIPTION = ('Simulate and estimate a scenario with many seeds and compare the errors with the '
               'covariance that the filter states and with the Cramér-Rao bound. A killed study '
               'goes on where it was when the same command is given again.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_config(parser)
    parser.add_argument('--runs', metavar='N', type=int, default=100,
                        help='runs, at each value of a sweep (default: %(default)s)')
    sweep = parser.add_argument(
        '--sweep', metavar='KEY=V1,V2,…',
        help='a parameter and the values that it takes one after the other')
    arguments.completed_by(sweep, lambda: (f'{key}=' for key in parameters()))
    arguments.add_duration(parser)
    parser.add_argument('--verdicts', action='store_true',
                        help='judge each run as starcal calibrate does, which takes as long again')
    parser.add_argument('--out', metavar='SUMMARY.json', default='montecarlo.json',
                        help='summary to write; all runs go into an .npz file beside it '
                        '(default: %(default)s)')
    outputs.add_report(parser)
    outputs.add_overwrite(parser)
    cluster.add_dask(parser)
    arguments.add_json(parser, 'what --out writes')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.evaluation import montecarlo
    scenario = arguments.scenario(options, arguments.SIMULATED, duration_s=options.duration)
    study = dataclasses.replace(
        montecarlo.MonteCarlo.of(scenario, options.runs, options.sweep), judged=options.verdicts)
    out = Path(options.out)
    parts = out.with_name(out.name + '.parts')
    outputs.claim([out, out.with_suffix('.npz'), *outputs.reports(options)], [options.config],
                  options.overwrite, parts)
    outputs.check_reports(options)
    with cluster.spread(options.dask), progress('running') as on_progress:
        results = montecarlo.run(study, parts, on_progress, bounded=True)
    summary = montecarlo.finish(study, results, out, parts)
    from starcal_ros import report
    for point in summary.get('points', [summary]):
        title = f'{study.key} = {point[study.key]}' if study.key else str(options.config or '')
        show(report.study(point, title))
    if options.report or options.light_report:
        from starcal_ros.report import write
        from starcal_ros.report.calibration import called
        from starcal_ros.report.montecarlo_page import montecarlo_page
        write.write(montecarlo_page(summary, called(options.config or 'tan2018.yaml'),
                                    options.line), options.report, options.light_report)
    show_json(summary)
    return 0
