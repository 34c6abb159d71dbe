# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal reproduce``: a paper's table or figure beside ours."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import shutil

from starcal_ros import __version__
from starcal_ros.cli import arguments, cluster, outputs
from starcal_ros.cli.terminal import progress, say, show, show_json
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.files.output import write_text
from starcal_ros.reproduction import published

DESCRIPTION = ('Run what a table or figure of a paper was made from, and put its numbers beside '
               'ours and the bound. Names without a prefix are of Tan et al. 2018; real-sky and '
               'half-real need star images of others, in the folder STARCAL_REAL_SKY; '
               'user-mistakes takes a recording of others, with its truth, from the folder '
               'STARCAL_FOREIGN too.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    names = [*published.names(), 'all']
    parser.add_argument('name', metavar='NAME', choices=names, type=arguments.one_of(names),
                        help='%(choices)s')
    arguments.add_config(parser)
    parser.add_argument('--runs', '--rounds', metavar='N', type=int, dest='runs',
                        help='runs a column or point (default: as many as the study needs)')
    arguments.add_duration(parser)
    parser.add_argument('--out', metavar='FILE.json', default='reproduce.json',
                        help='the same numbers as JSON; figures are drawn beside it, as NAME.png '
                        '(default: %(default)s)')
    outputs.add_overwrite(parser)
    cluster.add_dask(parser)
    arguments.add_json(parser, 'what --out writes')


def _provenance(name: str, options: argparse.Namespace, scenario: Scenario) -> dict[str, str]:
    """Return where the numbers of one name come from."""
    given = {'--config': options.config, '--duration': options.duration,
             '--runs': options.runs or published.load(name).RUNS}
    words = [f'{key} {value}' for key, value in given.items() if value is not None]
    return {'command': ' '.join(['starcal reproduce', name, *words]), 'version': __version__,
            'config_sha256': scenario.sha256}


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    scenario = arguments.scenario(options, arguments.SIMULATED, duration_s=options.duration)
    out = Path(options.out)
    parts = out.with_name(out.name + '.parts')
    names = published.names() if options.name == 'all' else [options.name]
    outputs.claim([out, *(out.with_name(f'{name}.png') for name in names)], [options.config],
                  options.overwrite, parts)
    outcomes = {}
    for name in names:
        study = published.load(name)
        try:
            with cluster.spread(options.dask), progress(name) as on_progress:
                outcomes[name] = study.reproduce(
                    scenario, options.runs or study.RUNS, parts, on_progress)
        except ConfigError as error:        # data that are no part of this package are not there
            if options.name != 'all':
                raise
            say(f'{name} is left out: {error}')
    from starcal_ros import report
    for name, outcome in outcomes.items():
        show(report.published(outcome))
        if outcome.panels:
            figure = out.with_name(f'{name}.png')
            report.draw(outcome, figure)
            show(f'Figure: {figure}')
    results = {name: {**outcome.as_dict(), 'provenance': _provenance(name, options, scenario)}
               for name, outcome in outcomes.items()}
    write_text(out, json.dumps(results, indent=1, allow_nan=False) + '\n')
    shutil.rmtree(parts, ignore_errors=True)
    show_json(results)
    return 0
