# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal info``: what a recording holds."""

from __future__ import annotations

import argparse

from rich.table import Table

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import show

SUMMARY = 'tell what a recording holds'
DESCRIPTION = 'List the topics, types, counts and rates of a recording.'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.recording import reader
    summary = reader.summary(options.bag)
    table = Table(title=f'{options.bag}: {summary.duration_s:.2f} s, '
                        f'{summary.n_bytes / 1e6:.1f} MB')
    for column in ('topic', 'type', 'messages', 'rate [Hz]'):
        table.add_column(column, justify='right' if column in ('messages', 'rate [Hz]')
                         else 'left')
    for topic in summary.topics:
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz == topic.rate_hz else '-'
        table.add_row(topic.topic, topic.type, str(topic.count), rate)
    show(table)
    for name, size in summary.attachments.items():
        show(f'attachment {name}, {size} bytes')
    for text in summary.warnings:
        show(f'warning: {text}')
    return 0
