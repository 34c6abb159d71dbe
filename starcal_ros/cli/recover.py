# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal recover``: finish what a killed recorder left behind."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import show, show_json
from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.foreign import clean

DESCRIPTION = ('Write a recording anew from all that is whole in it, with the index and the '
               'summary that other readers need, and for a directory metadata.yaml. Tells what is '
               'lost. A sound recording stays as it is.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    parser.add_argument('--out', metavar='BAG', help='file or directory to write; default: BAG '
                        'itself, of which each file that is replaced is kept as FILE.orig')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what was done')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    bag, out = Path(options.bag), Path(options.out) if options.out else None
    if out is not None and not bag.is_dir():
        outputs.claim([out], [bag], options.overwrite)
    from starcal_ros.recording.recover import OutputExists, recover
    try:
        results = recover(bag, out, options.overwrite)
    except OutputExists as error:
        raise ConfigError(str(error)) from None
    show_json({'recording': str(bag), 'out': str(out or bag), 'files': [
        {'name': each.name, 'sound': each.sound, 'chunks': each.chunks,
         'messages': each.messages, 'lost_chunks': each.lost_chunks,
         'lost_messages': each.lost_messages, 'lost_bytes': each.lost_bytes}
        for each in results]})
    for each in results:
        show(f'{clean(each.name)}: ' + (
            f'sound, {each.messages} messages' if each.sound else
            f'{each.messages} messages in {each.chunks} chunks recovered; lost: '
            f'{each.lost or "nothing that was in the file"}'))
    return 0
