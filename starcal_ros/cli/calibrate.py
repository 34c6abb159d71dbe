# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal calibrate``: the 16-state filter over a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.aside import aside
from starcal_ros.cli.check import check_recording, open_recording
from starcal_ros.cli.terminal import STATUS, progress, say, show, show_json
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.files.output import write_text
from starcal_ros.recording.topic_choice import TopicChoice

if TYPE_CHECKING:
    from starcal_ros.filter.calibrator import Calibrator
    from starcal_ros.results.store import CalibrationStore

DESCRIPTION = ('Run the 16-state filter over a recording: an .mcap file or a rosbag2 directory '
               'with imu/data_raw (sensor_msgs/Imu) and star_tracker/centroids '
               '(sensor_msgs/PointCloud2: u, v, catalog_id). Where there are images '
               '(sensor_msgs/Image) and no centroids, their stars are measured and identified '
               '(extra identify).')

_INSTRUMENTS = ('camera.', 'mounting.', 'gyro.', 'star_tracker.', 'observer.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_config(parser, recorded=True)
    arguments.add_topics(parser)
    parser.add_argument('--out', metavar='RESULT.json', required=True, help='result to write')
    parser.add_argument('--figure', metavar='PNG', help='draw the convergence of the estimates')
    outputs.add_report(parser)
    parser.add_argument('--export', metavar='FOLDER',
                        help='write the calibration for other programs: camera_info.yaml, '
                        'opencv.yaml, cameras.txt (COLMAP), and camchain.yaml and imu.yaml as '
                        'Kalibr has them')
    parser.add_argument('--adopt', action='store_true',
                        help='where the data contradict the model and one extension of it '
                        'explains them better than all others, calibrate again with that')
    parser.add_argument('--no-check', action='store_true', help='skip what starcal check looks at')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what --out writes')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.results import export
    scenario = arguments.scenario_of(options.bag, options, ('estimator',))
    folder = Path(options.export) if options.export else None
    if folder is not None:
        outputs.make_folder(folder)
    outputs.claim(
        [options.out, options.figure, *outputs.reports(options),
         *([folder / name for name in export.NAMES] if folder else [])],
        [options.bag, options.config, *_saved(scenario).folders()], options.overwrite)
    outputs.check_reports(options)
    _, outcome = calibrate_recording(
        options.bag, scenario, Path(options.out),
        Path(options.figure) if options.figure else None,
        Reports(options.report, options.light_report, options.line), folder,
        arguments.topics(options), options.adopt, checked=not options.no_check)
    show_json(outcome)
    return STATUS[outcome['verdict']]


class Reports(NamedTuple):
    """The reports that are asked for, and the command that does.

    Attributes
    ----------
    paths : sequence of path
        Of HTML or PDF.
    light : path or None
        Of HTML without a script.
    command : str
    """

    paths: Sequence[str | Path] = ()
    light: str | Path | None = None
    command: str = ''


def calibrate_recording(bag: str | Path, scenario: Scenario, out: Path, figure: Path | None,
                        reports: Reports = Reports(), folder: Path | None = None,
                        choice: TopicChoice = TopicChoice(), adopt: bool = False,
                        checked: bool = True) -> tuple[Calibrator, dict[str, Any]]:
    """Calibrate a recording, write the result and show it; return the final state and it."""
    from starcal_ros.recording.reader import CONFIG_ATTACHMENT
    from starcal_ros.results import initial
    recording, scenario, measured = open_recording(bag, scenario, choice)
    contradictions = list(_contradictions(
        recording.attachments.get(CONFIG_ATTACHMENT), scenario))
    for text in contradictions:
        say(f'warning: {text}')
    start = initial.initial_values(scenario, _saved(scenario))
    check = aside(lambda: check_recording(recording, start.scenario)) if checked else None
    # Behind what is done aside: the filter takes its time to be imported.
    from starcal_ros import report
    from starcal_ros.core import verdict_words
    from starcal_ros.filter import explanations, verdict
    from starcal_ros.filter.noise_levels import said_aloud
    from starcal_ros.filter.offline import calibrate_source
    from starcal_ros.filter.progress import Progress
    from starcal_ros.results import document, export, result
    from starcal_ros.results.attached_truth import attached_truth
    with progress('calibrating') as on_progress:
        calibrator, history = calibrate_source(
            recording, start.scenario, on_progress, start.covariance)
    if check is not None:
        denied = [f'{each.points_at}: {each.sentence}' for each in check().findings]
        for text in denied:
            say(f'warning: {text}')
        contradictions += denied
    used, adopted = start.scenario, dict[str, str]()
    explained: explanations.Explanations | None = None
    if result.word(calibrator) == verdict_words.INCONSISTENT:
        with progress('explaining') as on_progress:
            explained = explanations.explain(recording, used, calibrator, start.covariance,
                                             on_progress)
        if adopt and explained.to_adopt:
            used = used.replace(explained.to_adopt.values)
            adopted = {'adopted': '; '.join(explained.to_adopt.lines),
                       'adopted_config_sha256': used.sha256}
            with progress('calibrating') as on_progress:
                calibrator, history = calibrate_source(
                    recording, used, on_progress, start.covariance)
    notices = [*recording.warnings, *measured, *start.notices, *calibrator.take_notices(),
               *said_aloud(calibrator.noise.levels())]
    for text in notices:
        say(f'warning: {text}')
    gained = Progress(zip(history.stamp_ns.tolist(), history.sigma))
    outcome = result.result(calibrator, {**result.provenance(scenario, recording),
                                         'began_with': start.source or 'nominal values',
                                         **adopted},
                            gained, explained)
    document.write_json(out, outcome)
    if folder is not None:
        for name, content in export.files(outcome, scenario).items():
            write_text(folder / name, content)
    truth, doubts = attached_truth(recording.attachments)
    for text in doubts:
        say(f'warning: {text}')
    show(report.table(report.rows(outcome, truth), f'Calibration of {bag}'))
    show(report.summary(outcome))
    for level in outcome['noise_levels']:
        show(f'Noise: {level["sentence"]}')
    judged = verdict.of(calibrator, gained)
    if explained is not None:
        show(report.explanations_table(outcome))
        show(f'The data contradict the model; {explained.sentence}. '
             + (f'Adopted: {adopted["adopted"]}' if adopted else
                'Nothing was adopted.' if adopt else 'See --adopt.'))
    show(f'Verdict: {report.symbols(judged.summary)}')
    if figure is not None:
        report.figure(history, truth, figure)
    if reports.paths or reports.light:
        from starcal_ros.report import write
        from starcal_ros.report.calibration import Calibration
        from starcal_ros.report.page import page
        write.write(page(Calibration(
            outcome, truth, history, judged, used, contradictions + notices,
            calibrator.consistency.history, start.covariance, reports.command)),
            reports.paths, reports.light)
    return calibrator, outcome


def _saved(scenario: Scenario) -> CalibrationStore:
    from starcal_ros.results.store import CalibrationStore
    return CalibrationStore(Path(scenario.estimator.calibration_directory))


def _contradictions(attached: bytes | None, scenario: Scenario) -> Iterator[str]:
    """Yield what the configuration in a recording says of the instruments and this one denies."""
    if attached is None:
        return
    try:
        own = parameter_file.parse(attached.decode(errors='replace'), 'its configuration').flat()
    except ConfigError as error:
        yield f'the recording has a configuration that can not be read: {error}'
        return
    given = scenario.flat()
    for key in sorted(own.keys() | given.keys()):
        if key.startswith(_INSTRUMENTS) and own.get(key) != given.get(key):
            yield (f"{key} is {own.get(key)} in the recording's own configuration, "
                   f'{given.get(key)} here')
