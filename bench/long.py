# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time and memory of long recordings: `python bench/long.py 1 3 6 12 24`, in hours.

Each length is simulated, checked and calibrated, with a report, each command in a process of
its own. Prints seconds of one processor and the largest resident memory of each, and what the
result is worth: the NEES of its 13 calibrated states against the truth of the recording, which
is chi-square, and the least eigenvalue of their correlation, which is positive.

``--light`` takes an instrument of fewer messages, gyros of 20 Hz and frames of 0.5 Hz with some
ten stars, so that a week takes minutes.
"""

import argparse
import json
from pathlib import Path
import subprocess
import sys
import tempfile

from bars import told
import numpy as np
from scipy.stats import chi2

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.core import rotation
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.filter.states import CALIBRATED

LIGHT = {'gyro.rate_hz': 20.0, 'star_tracker.rate_hz': 0.5,
         'star_tracker.limiting_magnitude': 5.5}
MEMORY_AIM_MB, GROWTH_AIM = 500.0, 1.1      # linear, to a tenth
BAND = chi2.ppf((0.025, 0.975), 13)


def run(*arguments: str) -> tuple[float, float]:
    """Run a sub-command of starcal in a process that only waits for it; return [s], [MB]."""
    # The system keeps the maximum over all children of a process: each has a parent of its own.
    measured = subprocess.run(
        [sys.executable, '-c', 'import resource, subprocess, sys\n'
         'code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode\n'
         'used = resource.getrusage(resource.RUSAGE_CHILDREN)\n'
         'print(code, used.ru_utime + used.ru_stime, used.ru_maxrss)',
         sys.executable, '-m', 'starcal_ros.cli', *arguments],
        check=True, capture_output=True, text=True).stdout.split()
    if int(measured[0]) not in (0, 3, 4):
        raise SystemExit(f'{arguments[0]} ended with status {measured[0]}')
    return float(measured[1]), float(measured[2]) / 1024.0


def nees(out: Path, bag: Path) -> tuple[float, float]:
    """Return the NEES of the calibrated states, and the least eigenvalue of their correlation."""
    from starcal_ros.recording.reader import TRUTH_ATTACHMENT
    from starcal_ros.recording.recording_stream import RecordingStream
    result = json.loads(out.read_text())
    truth = json.loads(RecordingStream(bag).attachments[TRUTH_ATTACHMENT])
    C_sg, true_C_sg = (rotation.to_matrix(np.array(side['mounting']['quaternion_xyzw']))
                       for side in (result, truth))
    error = np.concatenate((
        (np.array(result['gyro_bias_deg_h']) - truth['gyro_bias_deg_h']) * DEG_PER_HOUR,
        rotation.log(C_sg @ true_C_sg.T),
        [result['intrinsics'][key] - truth['intrinsics'][key] for key in INTRINSICS_KEYS]))
    P = np.array(result['covariance'])[CALIBRATED, CALIBRATED]
    sigma = np.sqrt(np.diag(P))
    correlation = P / np.outer(sigma, sigma)
    scaled = error / sigma
    return (float(scaled @ np.linalg.solve(correlation, scaled)),
            float(np.linalg.eigvalsh(correlation)[0]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('hours', nargs='+', type=float)
    parser.add_argument('--light', action='store_true')
    options = parser.parse_args()
    tan2018 = parameter_file.load(config_file('tan2018.yaml')).replace(
        LIGHT if options.light else {})
    print(f'NEES of 13 states, 95 % within {BAND[0]:.1f} to {BAND[1]:.1f}')
    print('|   h | simulate s |  MB | check s |  MB | calibrate s |   MB | NEES | eigenvalue |')
    print('|---|---|---|---|---|---|---|---|---|')
    times, most = {}, 0.0
    for hours in options.hours:
        with tempfile.TemporaryDirectory() as folder:
            bag, config, out = (Path(folder, name) for name in (
                'run.mcap', 'config.yaml', 'result.json'))
            config.write_text(parameter_file.dump(
                tan2018.replace({'simulation.duration_s': 3600.0 * hours})))
            cells = [part for command in (
                ('simulate', '--config', str(config), '--out', str(bag)),
                ('check', str(bag), '--config', str(config)),
                ('calibrate', str(bag), '--config', str(config), '--out', str(out), '--no-check',
                 '--report', str(Path(folder, 'report.html')))) for part in run(*command)]
            worth, least = nees(out, bag)
        times[hours], most = cells[4], max(most, *cells[1::2])
        print(f'| {hours:3g} | {cells[0]:10.1f} | {cells[1]:3.0f} | {cells[2]:7.1f} | '
              f'{cells[3]:3.0f} | {cells[4]:11.1f} | {cells[5]:4.0f} | {worth:4.1f} | '
              f'{least:10.2g} |', flush=True)
    hours = sorted(times)
    if len(hours) > 2:          # what it takes to start is the same for all
        first, *_, last = np.diff([times[each] for each in hours]) / np.diff(hours)
        told(f'calibrating a further hour, up to {hours[-1]:g} h over up to {hours[1]:g} h',
             last / first, GROWTH_AIM, 'times')
    told(f'largest memory up to {hours[-1]:g} h', most, MEMORY_AIM_MB, 'MB')


if __name__ == '__main__':
    main()
