# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The whole suite in one go: four ROS 2 processes, a recording, and its calibration.

No rclpy here: the nodes are processes of their own, started and ended as a user would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import os
from pathlib import Path
import signal
import subprocess
import time
from typing import Any

import numpy as np

from starcal_ros.config import middleware, parameter_file
from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core.units import NS
from starcal_ros.files.output import write_text
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import N_STATES
from starcal_ros.messages import conventions, topics
from starcal_ros.recording.bag import open_bag
from starcal_ros.recording.mcap_tail import McapTail
from starcal_ros.recording.writer import typestore
from starcal_ros.workflows.node_program import NodeError, node_command

RECORDING, RESULT, FIGURE, REPORT, PARAMETERS = (
    'run.mcap', 'result.json', 'convergence.png', 'report.html', 'demo.yaml')
FILES = (RECORDING, RESULT, FIGURE, REPORT, PARAMETERS)
_SIMULATORS = ('star_tracker_sim', 'gyro_sim')
_QUIET = ('--log-level', 'gyro_sim:=warn')     # its percentages, beside our progress
_END_S = 60.0           # time that a node may take to end


def run_live(scenario: Scenario, folder: Path,
             on_progress: Callable[[float], None] = lambda part: None) -> Path:
    """Simulate, estimate and record over ROS 2 and return the recording.

    Parameters
    ----------
    scenario : Scenario
        What to run.
    folder : Path
        Gets the recording and the parameter file of the run; must exist.
    on_progress : callable
        Called with the part of the run that is over, 0 to 1.

    Raises
    ------
    NodeError
        Where a node fails.
    """
    recording = folder / RECORDING
    scenario = scenario.replace({'recorder.output': str(recording),
                                 'estimator.wait_for_subscribers': 1,
                                 'simulation.wait_for_subscribers': 2,
                                 'simulation.wait_for_simulators': 1})
    params_file = folder / PARAMETERS
    write_text(params_file, parameter_file.dump(scenario))
    nodes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in ('recorder', 'estimator', *_SIMULATORS):
            nodes[name] = subprocess.Popen(
                [*node_command(name, {}, params_file), *_QUIET],
                env={**os.environ, **isolated('fastdds_demo')})
        for newest_ns in _until_simulated(nodes, McapTail(recording)):
            on_progress(part_over(newest_ns, scenario))
        on_progress(1.0)
        # Nothing is lost at the beginning: the simulators wait for each other, recorder and
        # estimator, and that for the recorder. Nor at the end: the simulators end when all they
        # sent has arrived, the estimator uses up what waits, and then the recorder.
        for name in ('estimator', 'recorder'):
            nodes[name].send_signal(signal.SIGINT)
            _expect_end(name, nodes[name])
    finally:
        for process in nodes.values():
            if process.poll() is None:
                process.kill()
                process.wait()
    return recording


def part_over(newest_ns: int, scenario: Scenario) -> float:
    """Return the part of a run that is over at a stamp, 0 to 1; a stamp of 0 is none yet."""
    start_ns = stamp_ns('simulation.start_utc', scenario.simulation.start_utc)
    return min(max(newest_ns - start_ns, 0) * NS / scenario.simulation.duration_s, 1.0)


def isolated(profile: str = 'fastdds_loopback') -> dict[str, str]:
    """Return environment variables with which nodes meet only each other, and quickly."""
    return {'ROS_DOMAIN_ID': str(1 + os.getpid() % 100),   # above 101: Linux's ephemeral ports
            **middleware.loopback(profile)}


def _until_simulated(nodes: Mapping[str, subprocess.Popen[bytes]], recording: McapTail
                     ) -> Iterator[int]:
    """Yield the newest stamp that is recorded, until the simulators have ended."""
    while any(nodes[name].poll() is None for name in _SIMULATORS):
        for name, process in nodes.items():
            status = process.poll()
            if status is not None and (status != 0 or name not in _SIMULATORS):
                raise NodeError(f'{name} ended with status {status} before the run was over')
        yield recording.newest_ns()
        time.sleep(0.05)


def _expect_end(name: str, process: subprocess.Popen[bytes]) -> None:
    try:
        status = process.wait(_END_S)
    except subprocess.TimeoutExpired:
        raise NodeError(f'{name} did not end within {_END_S:.0f} s of SIGINT') from None
    if status != 0:
        raise NodeError(f'{name} ended with status {status}')


def make_room(folder: Path) -> None:
    """Remove what an earlier demo left in a folder."""
    for name in FILES:
        (folder / name).unlink(missing_ok=True)


def compare(recording: Path, calibrator: Calibrator) -> float:
    """Return how much the last state published live differs from an offline one.

    Parameters
    ----------
    recording : Path
        With ``starcal/state``.
    calibrator : Calibrator
        After the calibration of the same recording.

    Returns
    -------
    difference : float
        Largest difference of the 16 values, relative to each value, and of the covariance,
        relative to the sigmas of its row and column; infinite where there is nothing to compare.
    """
    live = last_state(recording)
    if live is None or calibrator.belief is None:
        return float('inf')
    offline = conventions.state_vector(calibrator.stamp_ns, calibrator.belief)
    sigma = calibrator.belief.sigma
    scale = np.concatenate((np.abs(offline[:1 + N_STATES]), np.outer(sigma, sigma).ravel()))
    return float(np.max(np.abs(live - offline) / scale))


def last_state(recording: Path) -> Any:
    """Return the data of the last ``starcal/state`` of a recording, None where there is none."""
    message = _last(recording, topics.STATE)
    return None if message is None else message.data


def last_verdict(recording: Path) -> str:
    """Return the word of the last ``diagnostics`` of a recording, '' where there is none."""
    message = _last(recording, topics.DIAGNOSTICS)
    values = {} if message is None else {
        value.key: value.value for status in message.status for value in status.values}
    return str(values.get('verdict', ''))


def _last(recording: Path, topic: topics.Topic) -> Any:
    """Return the last message of a topic, None where there is none."""
    last, bag = None, open_bag(recording)
    for _, _, messages, _ in bag.messages([topic.recorded]):
        last = messages
    if last is None:
        return None
    begin, size = int(last.start[-1]), int(last.size[-1])
    cdr = last.data[begin:begin + size].tobytes()
    return typestore().deserialize_cdr(cdr, topic.type_name)
