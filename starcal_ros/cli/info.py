# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal info``: what a recording holds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import show
from starcal_ros.files.foreign import clean, literal

if TYPE_CHECKING:
    from starcal_ros.recording.reader import Summary

SUMMARY = 'tell what a recording holds'
DESCRIPTION = ('List the topics, types, counts and rates of a recording, and what is odd of the '
               'stamps of gyro and frames. With --check also whether it is sound: every checksum, '
               'the definitions of its types and the counts that it states; exit status 4 where '
               'it is not.')

_FOUND = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_topics(parser)
    parser.add_argument('--check', action='store_true', help='verify all that the recording holds')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.recording import reader
    summary = reader.summary(options.bag)
    table = Table(title=literal(f'{options.bag}: {summary.duration_s:.2f} s, '
                                f'{summary.n_bytes / 1e6:.1f} MB'))
    uses = {name: word for word, name in _uses(options).items()}
    for column in ('topic', 'type', 'messages', 'rate [Hz]', 'read as'):
        table.add_column(column, justify='right' if column in ('messages', 'rate [Hz]')
                         else 'left')
    for topic in summary.topics:
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz == topic.rate_hz else '-'
        table.add_row(literal(topic.topic, ''), literal(topic.type, ''), str(topic.count), rate,
                      uses.get(topic.topic, ''))
    show(table)
    for name, size in summary.attachments.items():
        show(f'attachment {clean(name)}, {size} bytes')
    for text in summary.warnings:
        show(f'warning: {text}')
    for text in _stamps(options, summary, {word: name for name, word in uses.items()}):
        show(f'stamps: {text}')
    return _check(Path(options.bag)) if options.check else 0


def _check(path: Path) -> int:
    """Tell whether a recording is sound; return the exit status."""
    from starcal_ros.recording.check import check
    results = check(path)
    for name, found in results.items():
        for text in found.faults:
            show(f'fault: {clean(name)}: {text}')
        if found.unchecked:
            show(f'without checksums in {clean(name)}: {", ".join(found.unchecked)}')
    if any(found.faults for found in results.values()):
        return _FOUND
    show(f'sound: {sum(found.messages for found in results.values())} messages in '
         f'{sum(found.chunks for found in results.values())} chunks')
    return 0


def _stamps(options: argparse.Namespace, summary: Summary, used: dict[str, str]
            ) -> Iterator[str]:
    """Yield what the stamps of gyro and frames say by themselves."""
    from starcal_ros.checks.stamps import LogTimes, of_clocks, of_topic
    from starcal_ros.messages.cdr import RecordError
    from starcal_ros.recording import reader
    if not {'gyro', 'frames'} <= used.keys():
        return
    try:
        recording = reader.read(options.bag, choice=arguments.topics(options))
    except RecordError as error:
        yield f'can not be read: {error}'
        return
    logged = {topic.topic: LogTimes(topic.first_ns, topic.last_ns) for topic in summary.topics}
    found = [*of_topic('gyro readings', recording.gyro.stamp_ns, None, 0.0, 'gyro'),
             *of_topic('frames', recording.frames.stamp_ns, None, 0.0, 'star tracker'),
             *of_clocks(recording.gyro.stamp_ns, recording.frames.stamp_ns,
                        logged.get(recording.frames_topic))]
    yield from (each.sentence for each in found)


def _uses(options: argparse.Namespace) -> dict[str, str]:
    """Return the topics that other commands would read, by what they are; say what is open."""
    from starcal_ros.messages.cdr import RecordError
    from starcal_ros.recording.bag import open_bag
    from starcal_ros.recording.topic_choice import FRAMES, GYRO, IMAGE, candidates, choose
    bag, path, uses = open_bag(Path(options.bag)), Path(options.bag), {}
    for word, role, given in zip(('gyro', 'frames', 'images'), (GYRO, FRAMES, IMAGE),
                                 arguments.topics(options)):
        if given or len(found := candidates(bag.topics(), role)) == 1:
            try:
                uses[word] = choose(bag, role, path, given).name
            except RecordError as error:
                if given:
                    raise
                show(f'warning: {error}')
        elif found:
            show(f'{len(found)} topics may be the {word}: {role.option} chooses one')
    return uses
