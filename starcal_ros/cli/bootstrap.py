# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal bootstrap``: from a rough camera and unidentified stars to the 16 states."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
import os
from pathlib import Path
import traceback
from typing import Any, NamedTuple

from starcal_ros.cli import arguments, cluster, outputs
from starcal_ros.cli.terminal import STATUS, progress, say, show, show_json, told
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.recording.topic_choice import TopicChoice

DESCRIPTION = ('Calibrate a recording of which only the focal length is known, to a tenth, and no '
               'star by its number (numbers in the recording are ignored): self-calibration, '
               'identification, angular distances, the 16-state filter, each from what the last '
               'one found, on frames of its own. Where there are images and no centroids, the '
               'stars are measured in them. Several recordings are calibrated each by itself, as '
               'many at once as there are cores, and the exit status is the worst: wrong input, '
               'no result, contradicted, not yet. Needs the extra identify.')

_NODES = ('estimator', 'intrinsics_estimator', 'centroid_extractor', 'star_identifier')
_WORSE = (0, 3, 4, 1, 2)        # exit statuses, the worst last

_Task = tuple[str, Scenario, bool, TopicChoice]


class _Found(NamedTuple):
    """What came of a recording."""

    result: dict[str, Any]
    truth: dict[str, Any] | None
    notices: list[str]
    identified: str
    verdict: str


class _Failed(NamedTuple):
    """Why nothing came of a recording, and the exit status that this has."""

    status: int
    error: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument('bags', metavar='BAG', nargs='+', help='.mcap file or rosbag2 directory')
    arguments.add_config(parser, recorded=True)
    arguments.add_topics(parser)
    parser.add_argument('--images', action='store_true',
                        help='measure the stars in the images even where the recording has '
                        'centroids')
    parser.add_argument('--out', metavar='RESULT.json',
                        help='the result of the filter, with the camera after each step; of '
                        'several recordings a folder, with a file for each, called as it is')
    outputs.add_overwrite(parser)
    cluster.add_dask(parser)
    arguments.add_json(parser, 'what --out writes')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.results import document
    several = len(options.bags) > 1
    given = [(bag, arguments.scenario_of(bag, options, _NODES), options.images,
              arguments.topics(options)) for bag in options.bags]
    files: list[Path | None] = [None] * len(given)
    if options.out:
        files = _files(options.bags, Path(options.out)) if several else [Path(options.out)]
    outputs.claim(files, [*options.bags, options.config], options.overwrite)
    found: list[_Found | _Failed] = [_Failed(1, '')] * len(given)
    with cluster.spread(options.dask):
        for k, each in (_spread(given) if several or options.dask else
                        enumerate([_calibrated(*given[0], progress)])):
            found[k], path = each, files[k]
            if path is not None and isinstance(each, _Found):
                document.write_json(path, each.result)
    for bag, each in zip(options.bags, found):
        _show(bag, each, f'{bag}: ' if several else '')
    if several:
        show_json([{'recording': bag, **(
            each.result if isinstance(each, _Found) else {'error': each.error})}
            for bag, each in zip(options.bags, found)])
    elif isinstance(found[0], _Found):
        show_json(found[0].result)
    return max((STATUS[each.result['verdict']] if isinstance(each, _Found) else each.status
                for each in found), key=_WORSE.index)


def _files(bags: Sequence[str], folder: Path) -> list[Path | None]:
    """Make a folder; return a file in it for each recording, of its name.

    Where that is the same for two, the names of the folders that they are in come before it.
    """
    outputs.make_folder(folder)
    paths = [Path(os.path.abspath(bag)) for bag in bags]
    names = [path.stem if path.suffix == '.mcap' else path.name for path in paths]
    if len(set(names)) < len(names):
        common = os.path.commonpath([path.parent for path in paths])
        names = ['_'.join((*path.parent.relative_to(common).parts, name))
                 for path, name in zip(paths, names)]
    return [folder / f'{name}.json' for name in names]


def _spread(given: Sequence[_Task]) -> Iterator[tuple[int, _Found | _Failed]]:
    """Yield what comes of recordings, as it comes, and the number of each."""
    from starcal_ros.evaluation import tasks
    left = set(range(len(given)))
    try:
        with progress('bootstrap') as on_progress:
            for k, found in tasks.each(_alone, given):
                left.remove(k)
                yield k, found
                on_progress(1.0 - len(left) / len(given))
    except ConfigError as error:            # workers are lost: what is done is shown all the same
        for k in left:
            yield k, _Failed(*told(error))


def _alone(bag: str, scenario: Scenario, images_first: bool, choice: TopicChoice
           ) -> _Found | _Failed:
    """Calibrate one of several recordings: what it fails of, a defect too, ends no other."""
    try:
        return _calibrated(bag, scenario, images_first, choice, _untold)
    except Exception as error:
        try:
            return _Failed(*told(error))
        except Exception:
            return _Failed(1, traceback.format_exc().rstrip())


@contextmanager
def _untold(text: str) -> Iterator[Callable[[float], None]]:
    yield lambda part: None


def _calibrated(
        bag: str, scenario: Scenario, images_first: bool, choice: TopicChoice,
        shown: Callable[[str], AbstractContextManager[Callable[[float], None]]]) -> _Found:
    from starcal_ros.filter import verdict
    from starcal_ros.recording import reader
    from starcal_ros.results import result
    from starcal_ros.results.attached_truth import attached_truth
    try:
        from starcal_ros.recording.measured_images import ImageMeter, as_measured
        from starcal_ros.workflows.bootstrap import bootstrap
        with shown('reading') as on_progress:
            recording = reader.read(bag, on_progress, measure=ImageMeter(scenario),
                                    images_first=images_first, choice=choice)
        if recording.measured:
            scenario = as_measured(scenario)
        with shown('bootstrap') as on_progress:
            chain = bootstrap(recording.gyro, recording.frames, scenario, on_progress)
    except ImportError as error:            # of the extra, here or at a worker
        raise ConfigError(str(error)) from None
    outcome = result.result(chain.calibrator, result.provenance(scenario, recording),
                            chain.progress)
    outcome['steps'] = [{'step': step.name, **result.camera(step.camera)}
                        for step in chain.steps]
    truth, doubts = attached_truth(recording.attachments)
    stars = chain.frames.catalog_id
    return _Found(outcome, truth, [*recording.warnings, *chain.notices, *doubts],
                  f'{(stars > 0).sum()} of {len(stars)} spots identified',
                  verdict.of(chain.calibrator, chain.progress).summary)


def _show(bag: str, found: _Found | _Failed, prefix: str) -> None:
    """Show what came of a recording; messages name it by a prefix."""
    from starcal_ros import report
    from starcal_ros.core import verdict_words
    if isinstance(found, _Failed):
        say(f'starcal bootstrap: error: {prefix}{found.error}')
        return
    for text in found.notices:
        say(f'warning: {prefix}{text}')
    outcome = found.result
    show(report.chain(outcome['steps'], found.truth, f'Bootstrap of {bag}'))
    show(f'{found.identified}. {report.summary(outcome)}')
    if outcome['verdict'] == verdict_words.INCONSISTENT:
        show(report.table(report.rows(outcome, found.truth), 'The 16 states'))
    show(f'Verdict: {report.symbols(found.verdict)}')
