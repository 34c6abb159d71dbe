# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal check``: which assumption of the configuration a recording denies."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import progress, say, show, show_json
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.files.output import write_text

if TYPE_CHECKING:
    from starcal_ros.checks.check import Checked
    from starcal_ros.recording.measured_images import ImageMeter
    from starcal_ros.recording.recording_stream import RecordingStream
    from starcal_ros.recording.topic_choice import TopicChoice

DESCRIPTION = ('Read from a recording, before any filter, what of its configuration is wrong: '
               'units, axes and mounting of the gyros, stamps and clocks, rates, noise, the '
               'camera. Exit status 0: nothing found; 4: found; 2: wrong input.')
_FOUND = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_config(parser, recorded=True)
    arguments.add_topics(parser)
    parser.add_argument('--write', metavar='FIXED.yaml',
                        help='parameter file with what is proposed, to calibrate with')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'the findings')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.checks.finding import proposed
    scenario = arguments.scenario_of(options.bag, options, ('estimator',))
    outputs.claim([options.write], [options.bag, options.config], options.overwrite)
    recording, scenario, measured = open_recording(options.bag, scenario,
                                                   arguments.topics(options))
    with progress('checking') as on_progress:
        checked = check_recording(recording, scenario, on_progress)
    for text in (*recording.warnings, *measured):
        say(f'warning: {text}')
    show_json({'recording': str(options.bag), 'untold': list(checked.untold),
               'findings': [each.as_dict() for each in checked.findings]})
    _show(checked)
    if options.write:
        write_text(options.write, parameter_file.dump(proposed(scenario, checked.findings)))
    return _FOUND if checked.findings else 0


def open_recording(bag: str | Path, scenario: Scenario, choice: TopicChoice
                   ) -> tuple[RecordingStream, Scenario, tuple[str, ...]]:
    """Open a recording; where it has images and no centroids, measure and identify its stars.

    Returns
    -------
    recording : RecordingStream
    scenario : Scenario
        As it is for frames that were measured.
    notices : tuple of str
        What is to be said of the identification.
    """
    from starcal_ros.recording.recording_stream import RecordingStream

    @cache
    def meter() -> ImageMeter:
        from starcal_ros.recording.measured_images import ImageMeter     # slow; few have images
        return ImageMeter(scenario)
    recording = RecordingStream(bag, measure=lambda *given, **named: meter()(*given, **named),
                                choice=choice)
    if not recording.measured:
        return recording, scenario, ()
    from starcal_ros.recording.measured_images import as_measured
    try:
        with progress('identifying') as on_progress:
            numbered = meter().identify(recording, on_progress)
    except ImportError as error:
        raise ConfigError(str(error)) from None
    return recording, as_measured(scenario), numbered.notices


def check_recording(recording: RecordingStream, scenario: Scenario,
                    on_progress: Callable[[float], None] | None = None) -> Checked:
    """Check a recording, or parts of a long one."""
    from starcal_ros.checks.check import check
    from starcal_ros.checks.frame_ids import of_frame_ids
    from starcal_ros.checks.stamps import LogTimes
    from starcal_ros.recording.excerpt import excerpt
    logged = recording.span(recording.frames_topic)
    messages = excerpt(recording)
    checked = check(messages.gyro, messages.frames, scenario,
                    LogTimes(*logged) if logged else None, on_progress)
    return checked.with_findings(of_frame_ids(*(
        recording.frame_ids.get(topic) for topic in (recording.gyro_topic,
                                                     recording.frames_topic))))


def _show(checked: Checked) -> None:
    for each in checked.findings:
        show(f'{each.points_at}: {each.sentence}')
    for text in checked.untold:
        show(f'not told: {text}')
    count = len(checked.findings)
    show(f'{count} found' if count else 'Nothing found')
