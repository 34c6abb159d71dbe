# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal info``: what a recording holds."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import show, show_json
from starcal_ros.files.foreign import clean, literal

if TYPE_CHECKING:
    from starcal_ros.checks.finding import Finding
    from starcal_ros.recording.bag import Bag
    from starcal_ros.recording.mcap_check import Findings
    from starcal_ros.recording.reader import Summary

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
    arguments.add_json(parser, 'the same')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.recording import reader
    from starcal_ros.recording.bag import open_bag
    bag = open_bag(Path(options.bag))
    summary = reader.summary_of(bag)
    uses, doubts = _uses(bag, options)
    stamps, unread = _stamps(bag, summary, uses)
    files = None
    if options.check:
        from starcal_ros.recording.check import check
        files = check(Path(options.bag))
    show_json(_as_dict(options, summary, uses, [*summary.warnings, *doubts, *unread], stamps,
                       files))
    _show_topics(options, summary, {name: word for word, name in uses.items()})
    for name, size in summary.attachments.items():
        show(f'attachment {clean(name)}, {size} bytes')
    for text in (*summary.warnings, *doubts):
        show(f'warning: {text}')
    for text in (*unread, *(each.sentence for each in stamps)):
        show(f'stamps: {text}')
    if files is None:
        return 0
    _show_check(files)
    return 0 if _is_sound(files) else _FOUND


def _as_dict(options: argparse.Namespace, summary: Summary, uses: dict[str, str],
             warnings: list[str], stamps: list[Finding], files: dict[str, Findings] | None
             ) -> dict[str, Any]:
    """Return everything for JSON."""
    words = {name: word for word, name in uses.items()}
    values: dict[str, Any] = {
        'recording': str(options.bag), 'duration_s': summary.duration_s, 'bytes': summary.n_bytes,
        'topics': [{'name': each.topic, 'type': each.type, 'messages': each.count,
                    'rate_hz': each.rate_hz if each.rate_hz == each.rate_hz else None,
                    'first_ns': each.first_ns, 'last_ns': each.last_ns,
                    'read_as': words.get(each.topic)} for each in summary.topics],
        'attachments': summary.attachments, 'warnings': warnings,
        'stamps': [each.as_dict() for each in stamps]}
    if files is not None:
        values['check'] = {'sound': _is_sound(files), 'files': {
            name: dataclasses.asdict(found) for name, found in files.items()}}
    return values


def _show_topics(options: argparse.Namespace, summary: Summary, uses: dict[str, str]) -> None:
    from rich.table import Table
    table = Table(title=literal(f'{options.bag}: {summary.duration_s:.2f} s, '
                                f'{summary.n_bytes / 1e6:.1f} MB'))
    for column in ('topic', 'type', 'messages', 'rate [Hz]', 'read as'):
        table.add_column(column, justify='right' if column in ('messages', 'rate [Hz]')
                         else 'left')
    for topic in summary.topics:
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz == topic.rate_hz else '-'
        table.add_row(literal(topic.topic, ''), literal(topic.type, ''), str(topic.count), rate,
                      uses.get(topic.topic, ''))
    show(table)


def _is_sound(files: dict[str, Findings]) -> bool:
    return not any(found.faults for found in files.values())


def _show_check(files: dict[str, Findings]) -> None:
    """Tell whether a recording is sound."""
    for name, found in files.items():
        for text in found.faults:
            show(f'fault: {clean(name)}: {text}')
        if found.unchecked:
            show(f'without checksums in {clean(name)}: {", ".join(found.unchecked)}')
    if _is_sound(files):
        show(f'sound: {sum(found.messages for found in files.values())} messages in '
             f'{sum(found.chunks for found in files.values())} chunks')


def _stamps(bag: Bag, summary: Summary, used: dict[str, str]
            ) -> tuple[list[Finding], list[str]]:
    """Return what the stamps of gyro and frames say by themselves, and why they can not."""
    from starcal_ros.checks.stamps import LogTimes, of_clocks, of_topic
    from starcal_ros.messages.cdr import RecordError
    from starcal_ros.recording import reader
    if not {'gyro', 'frames'} <= used.keys():
        return [], []
    try:
        gyro_ns, frames_ns = reader.read_stamps(bag, [used['gyro'], used['frames']])
    except RecordError as error:
        return [], [f'can not be read: {error}']
    logged = {topic.topic: LogTimes(topic.first_ns, topic.last_ns) for topic in summary.topics}
    return [*of_topic('gyro readings', gyro_ns, None, 0.0, 'gyro'),
            *of_topic('frames', frames_ns, None, 0.0, 'star tracker'),
            *of_clocks(gyro_ns, frames_ns, logged.get(used['frames']))], []


def _uses(bag: Bag, options: argparse.Namespace) -> tuple[dict[str, str], list[str]]:
    """Return the topics that other commands would read, by what they are, and what is open."""
    from starcal_ros.messages.cdr import RecordError
    from starcal_ros.recording.topic_choice import FRAMES, GYRO, IMAGE, candidates, choose
    uses, doubts = dict[str, str](), list[str]()
    for word, role, given in zip(('gyro', 'frames', 'images'), (GYRO, FRAMES, IMAGE),
                                 arguments.topics(options)):
        if given or len(found := candidates(bag.topics(), role)) == 1:
            try:
                uses[word] = choose(bag, role, Path(options.bag), given).name
            except RecordError as error:
                if given:
                    raise
                doubts.append(str(error))
        elif found:
            doubts.append(f'{len(found)} topics may be the {word}: {role.option} chooses one')
    return uses, doubts
