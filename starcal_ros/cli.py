# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command ``starcal``.

Exit status: 0 done, 1 the data gave no calibration or a node failed, 2 wrong input.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import shutil
import subprocess
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

import starcal_ros
from starcal_ros import parameter_file, resources
from starcal_ros.cdr import RecordError
from starcal_ros.config import Scenario
from starcal_ros.parameter import ConfigError
from starcal_ros.demo import NodeError
from starcal_ros.evaluation import published
from starcal_ros.stream import Stream

SAME = 1e-9
"""Relative difference up to which the live and the offline estimates are the same."""

_INSTRUMENTS = ('camera.', 'mounting.', 'gyro.', 'star_tracker.', 'observer.')

CONFIG_HELP = ('parameter file of the scenario (ROS 2 parameters, /**: ros__parameters:); '
               'default: the shipped tan2018.yaml')


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit status."""
    options = parse(arguments)
    try:
        return int(options.run(options))
    except (ConfigError, RecordError, FileNotFoundError) as error:
        status, text = 2, str(error)
    except (ValueError, NodeError) as error:
        status, text = 1, str(error)
    except KeyboardInterrupt:
        status, text = 130, 'interrupted'
    _say(f'starcal {options.command}: {text}')
    return status


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Read a command line; a wrong one ends the process with status 2 and the usage."""
    return _parser().parse_args(arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='starcal', description='Calibrate a star tracker and three gyros from the stars '
        'they see: principal point, focal length, distortion, gyro bias, mounting and attitude.',
        epilog='Exit status: 0 done, 1 no calibration from this data, 2 wrong input. '
               'For one command: starcal COMMAND --help')
    parser.add_argument('--version', action='version',
                        version=f'starcal_ros {starcal_ros.__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')

    demo = _command(commands, 'demo', _demo, 'simulate over ROS 2, record, calibrate',
                    'Start star tracker, gyro, estimator and recorder as separate ROS 2 '
                    'processes, run a shortened scenario faster than real time, record it, '
                    'calibrate the recording again and compare. Leaves run.mcap, result.json, '
                    'convergence.png and report.html.')
    demo.add_argument('--config', metavar='FILE', help=CONFIG_HELP)
    demo.add_argument('--out', metavar='FOLDER', default='demo',
                      help='where to put the results (default: %(default)s)')
    demo.add_argument('--duration', metavar='S', type=float, default=1092.0,
                      help='simulated seconds (default: %(default)s, twice through the '
                      'rotations of tan2018.yaml)')
    demo.add_argument('--factor', metavar='N', type=float, default=0.0,
                      help='simulated seconds a second; 0 is as fast as the nodes go '
                      '(default: %(default)s)')

    simulate = _command(commands, 'simulate', _simulate, 'write a simulated recording',
                        'Simulate the sensors of a scenario and write their messages, the '
                        'configuration and the truth into an MCAP recording, without ROS.')
    simulate.add_argument('--config', metavar='FILE', help=CONFIG_HELP)
    simulate.add_argument('--out', metavar='BAG', required=True, help='.mcap file to write')
    simulate.add_argument('--duration', metavar='S', type=float,
                          help='simulated seconds, in place of simulation.duration_s')
    simulate.add_argument('--seed', metavar='N', type=int,
                          help='seed of the noise, in place of simulation.seed')
    simulate.add_argument('--overwrite', action='store_true', help='replace an existing file')

    calibrate = _command(commands, 'calibrate', _calibrate, 'calibrate a recording',
                         'Run the 16-state filter over a recording: an .mcap file or a rosbag2 '
                         'directory with imu/data_raw (sensor_msgs/Imu) and '
                         'star_tracker/centroids (sensor_msgs/PointCloud2: u, v, catalog_id).')
    calibrate.add_argument('bag', metavar='BAG', help='.mcap file or rosbag2 directory')
    calibrate.add_argument('--config', metavar='FILE', help=CONFIG_HELP)
    calibrate.add_argument('--out', metavar='RESULT.json', required=True,
                           help='result to write')
    calibrate.add_argument('--figure', metavar='PNG',
                           help='draw the convergence of the estimates')
    calibrate.add_argument('--report', metavar='HTML',
                           help='write the report: verdict, states, charts, on one page')

    play = _command(commands, 'play', _play, 'publish a recording again over ROS 2',
                    'Publish the sensor topics of a recording, as the node `player` does.')
    play.add_argument('bag', metavar='BAG', help='.mcap file or rosbag2 directory')
    play.add_argument('--rate', metavar='N', type=float, default=1.0,
                      help='recorded seconds a second; 0 is as fast as the subscribers take it '
                      '(default: %(default)s)')

    study = _command(commands, 'montecarlo', _montecarlo, 'run a scenario many times',
                     'Simulate and estimate a scenario with many seeds and compare the errors '
                     'with the covariance that the filter states and with the Cramér-Rao bound. '
                     'A killed study goes on where it was when the same command is given again.')
    study.add_argument('--config', metavar='FILE', help=CONFIG_HELP)
    study.add_argument('--runs', metavar='N', type=int, default=100,
                       help='runs, at each value of a sweep (default: %(default)s)')
    study.add_argument('--sweep', metavar='KEY=V1,V2,…',
                       help='a parameter and the values that it takes one after the other')
    study.add_argument('--duration', metavar='S', type=float,
                       help='simulated seconds, in place of simulation.duration_s')
    study.add_argument('--out', metavar='SUMMARY.json', default='montecarlo.json',
                       help='summary to write; all runs go into an .npz file beside it '
                       '(default: %(default)s)')
    study.add_argument('--dask', metavar='ADDRESS',
                       help='scheduler of a Dask cluster to run on (needs the extra dask)')

    again = _command(commands, 'reproduce', _reproduce, "compare with a paper's table",
                     'Run what a table of Tan et al. 2018 was made from, and put its numbers '
                     'beside ours and the Cramér-Rao bound.')
    again.add_argument('table', choices=[*published.names(), 'all'], help='which table')
    again.add_argument('--config', metavar='FILE', help=CONFIG_HELP)
    again.add_argument('--runs', metavar='N', type=int, default=100,
                       help='runs a column (default: %(default)s)')
    again.add_argument('--duration', metavar='S', type=float,
                       help='simulated seconds, in place of simulation.duration_s')
    again.add_argument('--out', metavar='FILE.json', default='reproduce.json',
                       help='the same numbers as JSON (default: %(default)s)')

    info = _command(commands, 'info', _info, 'tell what a recording holds',
                    'List the topics, types, counts and rates of a recording.')
    info.add_argument('bag', metavar='BAG', help='.mcap file or rosbag2 directory')
    return parser


def _command(commands: 'argparse._SubParsersAction[argparse.ArgumentParser]', name: str,
             run: Callable[[argparse.Namespace], int], summary: str, text: str
             ) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=summary, description=text)
    parser.set_defaults(run=run)
    return parser


def _scenario(options: argparse.Namespace, **values: object) -> Scenario:
    path = options.config or resources.config_file('tan2018.yaml')
    given = {key: value for key, value in values.items() if value is not None}
    scenario = parameter_file.load(path)
    return scenario.replace({f'simulation.{key}': value for key, value in given.items()})


@contextmanager
def _progress(text: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error; yield what moves it, from 0 to 1."""
    with Progress(TextColumn(f'{text:<12}'), BarColumn(), TaskProgressColumn(),
                  TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda part: bar.update(task, completed=part)


def _simulate(options: argparse.Namespace) -> int:
    from starcal_ros.simulate import simulate
    scenario = _scenario(options, duration_s=options.duration, seed=options.seed)
    with _progress('simulating') as on_progress:
        simulate(scenario, options.out, options.overwrite, on_progress)
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    _calibrate_recording(options.bag, _scenario(options), Path(options.out),
                         Path(options.figure) if options.figure else None,
                         Path(options.report) if options.report else None)
    return 0


def _calibrate_recording(bag: str | Path, scenario: Scenario, out: Path, figure: Path | None,
                         page: Path | None) -> Stream:
    """Calibrate a recording, write the result, print its table and return the final state."""
    from starcal_ros import record, report, result, verdict
    from starcal_ros.calibration import predicted_centroid

    for path in (out, figure, page):
        if path is not None:
            _require_writable(path)
    with _progress('reading') as on_progress:
        recording = record.read(bag, on_progress)
    contradictions = list(_contradictions(
        recording.attachments.get(record.CONFIG_ATTACHMENT), scenario))
    for text in contradictions:
        _say(f'warning: {text}')
    with _progress('calibrating') as on_progress:
        stream, history = predicted_centroid.calibrate(
            recording.gyro, recording.frames, scenario, on_progress)
    notices = [*recording.warnings, *stream.take_notices()]
    for text in notices:
        _say(f'warning: {text}')
    outcome = result.result(stream, {
        'version': starcal_ros.__version__, 'config_sha256': scenario.sha256,
        'bag': str(bag), 'bag_sha256': recording.sha256})
    result.write_json(out, outcome)
    attached = recording.attachments.get(record.TRUTH_ATTACHMENT)
    truth = json.loads(attached) if attached else None
    _print(report.table(report.rows(outcome, truth), f'Calibration of {bag}'))
    _print(report.summary(outcome))
    assert stream.belief is not None        # or result.result has told
    judged = verdict.judge(stream.filter, stream.belief, stream.tracking)
    _print(f'Verdict: {judged.summary}')
    if figure is not None:
        report.figure(history, truth, figure)
    if page is not None:
        from starcal_ros.report.page import Calibration, write_page
        write_page(page, Calibration(outcome, truth, history, judged, scenario,
                                     contradictions + notices))
    return stream


def _require_writable(path: Path) -> None:
    """Try it now, not after the work."""
    existed = path.exists()
    try:
        path.open('a').close()
    except OSError as error:
        raise ConfigError(f'{path}: cannot be written: {error.strerror}') from None
    if not existed:
        path.unlink()


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


def _info(options: argparse.Namespace) -> int:
    from starcal_ros import record
    summary = record.summary(options.bag)
    table = Table(title=f'{options.bag}: {summary.duration_s:.2f} s, '
                        f'{summary.n_bytes / 1e6:.1f} MB')
    for column in ('topic', 'type', 'messages', 'rate [Hz]'):
        table.add_column(column, justify='right' if column in ('messages', 'rate [Hz]')
                         else 'left')
    for topic in summary.topics:
        rate = f'{topic.rate_hz:.2f}' if topic.rate_hz == topic.rate_hz else '-'
        table.add_row(topic.topic, topic.type, str(topic.count), rate)
    _print(table)
    for name, size in summary.attachments.items():
        _print(f'attachment {name}, {size} bytes')
    for text in summary.warnings:
        _print(f'warning: {text}')
    return 0


def _play(options: argparse.Namespace) -> int:
    from starcal_ros.demo import node_command
    return subprocess.call(node_command('player', {
        'player.bag': str(options.bag), 'player.rate': options.rate}))


def _demo(options: argparse.Namespace) -> int:
    from starcal_ros import demo
    scenario = _scenario(options, duration_s=options.duration, real_time_factor=options.factor)
    folder = Path(options.out)
    demo.make_room(folder)
    with _progress('live run') as on_progress:
        recording = demo.run_live(scenario, folder, on_progress)
    stream = _calibrate_recording(recording, scenario, folder / demo.RESULT,
                                  folder / demo.FIGURE, folder / demo.REPORT)
    difference = demo.compare(recording, stream)
    _print(f'Live estimator and offline calibration differ by at most {difference:.1e} of the '
           'values.')
    _print(f'In {folder}/: {demo.RECORDING}, {demo.RESULT}, {demo.FIGURE}, {demo.REPORT}')
    return 0 if difference < SAME else 1


def _montecarlo(options: argparse.Namespace) -> int:
    from starcal_ros.evaluation import montecarlo
    study = montecarlo.Study.of(_scenario(options, duration_s=options.duration), options.runs,
                                options.sweep)
    out = Path(options.out)
    _require_writable(out)
    parts = out.with_name(out.name + '.parts')
    with _cluster(options.dask) as backend, _progress('running') as on_progress:
        results = montecarlo.run(study, parts, backend=backend, on_progress=on_progress)
    summary = montecarlo.finish(study, results, out, parts)
    from starcal_ros import report
    for point in summary.get('points', [summary]):
        title = f'{study.key} = {point[study.key]}' if study.key else str(options.config or '')
        _print(report.study(point, title))
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    scenario = _scenario(options, duration_s=options.duration)
    out = Path(options.out)
    _require_writable(out)
    parts = out.with_name(out.name + '.parts')
    outcomes = {}
    for name in published.names() if options.table == 'all' else [options.table]:
        with _progress(name) as on_progress:
            outcomes[name] = published.load(name)(scenario, options.runs, parts, on_progress)
    from starcal_ros import report
    for outcome in outcomes.values():
        _print(report.published(outcome))
    out.write_text(json.dumps({name: outcome.as_dict() for name, outcome in outcomes.items()},
                              indent=1, allow_nan=False) + '\n', encoding='utf-8')
    shutil.rmtree(parts, ignore_errors=True)
    return 0


@contextmanager
def _cluster(address: str | None) -> Iterator[str]:
    """Connect to a Dask cluster where one is named; yield joblib's backend."""
    if address is None:
        yield 'loky'
        return
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--dask: needs pip install 'starcal_ros[dask]'") from None
    try:
        client = Client(address, timeout=10)        # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConfigError(f'--dask: no scheduler answers at {address}: {error}') from None
    with client:
        yield 'dask'


def _print(what: Table | str) -> None:
    """Print on standard output, wide enough for the tables where that is a file or a pipe."""
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console = Console(highlight=False, soft_wrap=True, width=120)
    console.print(what, markup=False) if isinstance(what, str) else console.print(what)


def _say(text: str) -> None:
    """Print a message for the user on standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(text, markup=False)


if __name__ == '__main__':
    sys.exit(main())
