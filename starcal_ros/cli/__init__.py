# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""The command ``starcal``, one file a sub-command.

A sub-command is a name in `COMMANDS` and a module of this package that is called so, with
``DESCRIPTION``, ``add_arguments(parser)`` and ``run(options)``, which returns the exit status: 0
done, 1 no result, 2 wrong input; of a calibration also 3 and 4, see `terminal.STATUS`, of a check
4. The module is imported when its command is given, and what it takes long to import by ``run``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import difflib
from importlib import import_module
import os
import shlex
import sys

import starcal_ros

COMMANDS = {
    'demo': 'simulate over ROS 2, record, calibrate',
    'simulate': 'write a simulated recording',
    'check': 'tell which assumption a recording denies',
    'calibrate': 'calibrate a recording',
    'intrinsics': 'calibrate the camera alone',
    'bootstrap': 'calibrate without knowing camera or stars',
    'compare': 'tell whether calibrations agree',
    'allan': 'noise of a gyro at rest',
    'config': 'make, check and explain parameter files',
    'montecarlo': 'run a scenario many times',
    'reproduce': "compare with a paper's table or figure",
    'play': 'publish a recording again over ROS 2',
    'watch': 'watch the running estimator',
    'serve': 'show a calibration on a page for browsers',
    'display': 'write what other viewers draw of a recording',
    'info': 'tell what a recording holds',
    'recover': 'finish a recording whose recorder was killed',
}
"""What each does, in the order in which the usage lists them."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit status."""
    options = parse(arguments)
    try:
        from starcal_ros.core.collector import look_seldom
        look_seldom()
        from starcal_ros.cli.terminal import onto_output, printing
        with printing(getattr(options, 'json', False)):
            status = int(options.run(options))
        with onto_output():
            sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        status, text = 130, 'interrupted'
    except Exception as error:
        from starcal_ros.cli.terminal import told
        status, text = told(error)
    from starcal_ros.cli.terminal import say
    say(f'{options.parser.prog}: error: {text}')
    return status


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Read a command line; a wrong one ends the process with status 2 and the usage."""
    parser = argparse.ArgumentParser(
        prog='starcal', description='Calibrate a star tracker and three gyros from the stars '
        'they see: principal point, focal length, distortion, gyro bias, mounting and attitude.',
        epilog='Exit status: 0 done; 3 the result is written, but not yet inside the tolerances; '
               '4 the result is written, but the data contradict the model, or check found '
               'something; 1 no result; 2 wrong input. For one command: starcal COMMAND --help')
    parser.add_argument('--version', action='version',
                        version=f'starcal_ros {starcal_ros.__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    completed = os.environ.get('COMP_LINE') if '_ARGCOMPLETE' in os.environ else None
    words = sys.argv[1:] if arguments is None else arguments
    given = next((word for word in (words if completed is None else completed.split()[1:])
                  if not word.startswith('-')), '')
    for name, text in COMMANDS.items():
        if name != given:
            commands.add_parser(name, help=text)
            continue
        module = import_module(f'{__name__}.{name}')
        command = commands.add_parser(name, help=text, description=module.DESCRIPTION)
        module.add_arguments(command)
        command.set_defaults(run=module.run, parser=command)
    if completed is not None:
        import argcomplete
        argcomplete.autocomplete(parser)
    if given not in COMMANDS and (near := difflib.get_close_matches(given, COMMANDS, n=1)):
        parser.error(f'no command {given!r}; did you mean {near[0]}?')
    options, unknown = parser.parse_known_args(words)
    if unknown:
        options.parser.error(f'unrecognized arguments: {" ".join(unknown)}')
    options.line = shlex.join(('starcal', *words))
    return options
