# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal serve``: a calibration on a page for browsers."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import progress, show, show_json
from starcal_ros.config.nodes import ServeConfig

DESCRIPTION = ('Serve a page for browsers that shows a calibration: stars and residuals on the '
               'detector, each sigma over its tolerance, the tests, the verdict, the axis to turn '
               'about next, time to go and rates. Without FILE that of the running estimator, as '
               'it goes on; of a recording at any time. Only browsers on this machine reach it, '
               'unless --host says otherwise. Ctrl-C ends it.')

_DEFAULT = ServeConfig()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument('file', metavar='FILE', nargs='?', help='a recording with the results of '
                        'an estimator (.mcap file or rosbag2 directory), RESULT.json, or the '
                        'folder of a saved calibration')
    parser.add_argument('--host', metavar='ADDRESS', default=_DEFAULT.host,
                        help='address to listen on; 0.0.0.0 is open to everybody on the network '
                        '(default: %(default)s)')
    parser.add_argument('--port', metavar='N', type=arguments.port, default=_DEFAULT.port,
                        help='port to listen on; 0 is any that is free (default: %(default)s)')
    parser.add_argument('--namespace', metavar='NS', help='namespace of the estimator')
    arguments.add_json(parser, 'the address of the page, and what it shows,')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    if options.file is None:
        from starcal_ros.workflows.node_program import node_command
        command = node_command('serve', {'serve.host': options.host, 'serve.port': options.port},
                               namespace=options.namespace, as_json=options.json)
        os.execv(command[0], command)   # so that Ctrl-C and the status are the node's own
    from starcal_ros.live.serving import serve
    path = Path(options.file)
    moments = _moments(path, options.namespace)

    def say_where(address: str) -> None:
        show(f'{address} shows {options.file}; Ctrl-C ends it')
        show_json({'address': address, 'shows': options.file})
    serve(path.name, options.host, options.port, moments, say_where)
    return 0


def _moments(path: Path, namespace: str | None) -> list[tuple[str, bytes]]:
    """Return what the page shows of a file: the stamps of its moments, and these."""
    from starcal_ros.config.parameter import ConfigError
    from starcal_ros.core.utc import utc_text
    from starcal_ros.live.finished import finished
    from starcal_ros.live.picture import encoded
    from starcal_ros.live.recorded import moments
    from starcal_ros.results.initial import RESULT
    from starcal_ros.results.document import CalibrationError
    if path.suffix == '.json' or (path / RESULT).is_file():
        try:
            return [('', encoded(finished(path)))]
        except CalibrationError as error:
            raise ConfigError(str(error)) from None
    with progress('reading') as on_progress:
        return [(utc_text(moment.stamp_ns), encoded(moment.seen))
                for moment in moments(path, namespace, on_progress)]
