# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a command will write, looked at before the work."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.output import draft_beside, is_stream, same


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add ``--overwrite``, for `claim`."""
    parser.add_argument('--overwrite', action='store_true', help='replace existing files')


def add_report(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add ``--report`` and ``--light-report``, for `reports`."""
    parser.add_argument('--report', metavar='FILE', action='append', default=[],
                        help='write the report: verdict, numbers, charts, on one page, of HTML or '
                        '(FILE.pdf) PDF; may be given twice')
    parser.add_argument('--light-report', metavar='HTML',
                        help='write it with pictures in place of charts that zoom: half a '
                        'megabyte, no script')


def reports(options: argparse.Namespace) -> list[str | None]:
    """Return the reports that will be written."""
    return [*options.report, options.light_report]


def check_reports(options: argparse.Namespace) -> None:
    """See to it that the reports can be made; ConfigError where one can not."""
    if options.report or options.light_report:
        from starcal_ros.report import write
        write.check(options.report)
        if options.light_report and write.is_pdf(options.light_report):
            raise ConfigError(f'--light-report: {options.light_report}: is HTML; PDF is for '
                              '--report')


def claim(outputs: Iterable[str | Path | None], inputs: Iterable[str | Path | None],
          overwrite: bool, scratch: Path | None = None) -> None:
    """See to it that files can be written and destroy nothing.

    Parameters
    ----------
    outputs, inputs : iterable of path or None
        What is written and what is read; of a folder that is read its files count.
    overwrite : bool
        Outputs may exist.
    scratch : Path, optional
        A folder that is removed in the end.

    Raises
    ------
    ConfigError
        Where an output is an input or another output by any name or link, exists and may not, or
        can not be written.
    """
    wanted = [Path(path) for path in outputs if path]
    read = list(_files(inputs))
    for k, path in enumerate(wanted):
        if is_stream(path):
            continue
        for other in read:
            if same(path, other):
                raise ConfigError(f'{path}: would replace {other}, which is read: choose another '
                                  'name')
        if any(same(path, other) for other in wanted[:k]):
            raise ConfigError(f'{path}: is to be written twice: choose another name')
    if scratch is not None:
        for other in read:
            if other.resolve().is_relative_to(scratch.resolve()):
                raise ConfigError(f'{scratch}: is removed in the end and holds {other}, which is '
                                  'read: choose another name for the output')
    for path in wanted:
        if path.is_file() and not overwrite and not is_stream(path):
            raise ConfigError(f'{path} exists; choose another name, or replace it with '
                              '--overwrite')
        _try(path)


def make_folder(path: Path) -> None:
    """Make a folder to write to, before the work."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f'{path}: cannot be made: {error.strerror}') from None


def _files(inputs: Iterable[str | Path | None]) -> Iterator[Path]:
    """Yield what is read, the files of a folder in its place."""
    for given in inputs:
        if given:
            path = Path(given)
            try:
                yield from [file for file in path.iterdir() if file.is_file()]
            except OSError:             # no folder, or none that can be read
                yield path


def _try(path: Path) -> None:
    """Write nothing to where a file will be; ConfigError where that fails."""
    try:
        if path.is_dir():
            path.open('ab').close()
        elif not is_stream(path):
            draft = draft_beside(path)
            draft.open('xb').close()
            draft.unlink()
    except OSError as error:
        raise ConfigError(f'{path}: cannot be written: {error.strerror}') from None
