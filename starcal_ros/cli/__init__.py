# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command ``starcal``, one file a sub-command.

A sub-command is a module of this package with ``SUMMARY``, ``DESCRIPTION``,
``add_arguments(parser)`` and ``run(options)``, which returns the exit status: 0 done, 1 no result,
2 wrong input; of a calibration also 3 and 4, see `terminal.STATUS`, of a check 4. What takes long
to import is imported by ``run``.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from importlib import import_module
import os
import sys

import starcal_ros
from starcal_ros.cli.terminal import printing, say
from starcal_ros.config.parameter import ConfigError
from starcal_ros.messages.cdr import RecordError
from starcal_ros.workflows.live_run import NodeError

COMMANDS = ('demo', 'simulate', 'check', 'calibrate', 'intrinsics', 'bootstrap', 'allan',
            'montecarlo', 'reproduce', 'play', 'watch', 'info', 'recover')
"""In the order in which the usage lists them."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit status."""
    options = parse(arguments)
    try:
        with printing(getattr(options, 'json', False)):
            status = int(options.run(options))
        sys.stdout.flush()
        return status
    except (ConfigError, RecordError, FileNotFoundError) as error:
        status, text = 2, str(error)
    except (ValueError, NodeError) as error:
        status, text = 1, str(error)
    except OSError as error:
        status, text = 1, f'{error.filename or "standard output"}: {error.strerror or error}'
        if error.filename is None:      # nothing goes there at the end of the process, too
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        status, text = 130, 'interrupted'
    say(f'starcal {options.command}: {text}')
    return status


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
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
    for name in COMMANDS:
        module = import_module(f'{__name__}.{name}')
        command = commands.add_parser(name, help=module.SUMMARY, description=module.DESCRIPTION)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser.parse_args(arguments)
