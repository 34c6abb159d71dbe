# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What those who look on cost the estimator: `python bench/viewers.py 0 1 30`.

Simulators and estimator at real time, and `starcal serve` with so many viewers, at first without
it. Prints the part of a core that the estimator takes and that of the server. Processor time
hardly depends on what else the machine does.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile
import threading
import time
from urllib.request import urlopen

from live import processor_s, start

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.workflows.live_run import isolated

SETTLE_S, LENGTH_S = 10.0, 40.0


def look_on(address: str) -> None:
    """Take all events of a page."""
    with urlopen(address + 'events') as events:
        try:
            for _ in events:
                pass
        except OSError:
            pass


def measure(folder: Path, viewers: int | None) -> None:
    """Print a line for so many viewers, None for no server."""
    with ExitStack() as stack:
        def ended(process: subprocess.Popen[str]) -> subprocess.Popen[str]:
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process
        server = None
        if viewers is not None:
            server = ended(subprocess.Popen(
                [sys.executable, '-m', 'starcal_ros.cli', 'serve', '--port', '0'], text=True,
                stderr=subprocess.PIPE, env={**os.environ, **isolated()}))
            assert server.stderr is not None
            found = re.search(r'http\S+', server.stderr.readline())
            assert found is not None
            for _ in range(viewers):
                threading.Thread(target=look_on, args=[found[0]], daemon=True).start()
        nodes = {name: ended(start(name, folder))
                 for name in ('estimator', 'star_tracker_sim', 'gyro_sim')}
        time.sleep(SETTLE_S)
        timed = [nodes['estimator'], *([server] if server else [])]
        before, began_s = [processor_s(each) for each in timed], time.monotonic()
        time.sleep(LENGTH_S)
        elapsed_s = time.monotonic() - began_s
        parts = [100.0 * (processor_s(each) - used) / elapsed_s
                 for each, used in zip(timed, before)]
        what = 'no server' if viewers is None else f'{viewers} viewers'
        print(f'{what:>11}: estimator {parts[0]:5.1f} %'
              + ''.join(f', server {part:.1f} %' for part in parts[1:]), flush=True)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('viewers', type=int, nargs='+')
    options = parser.parse_args()
    scenario = parameter_file.load(config_file('tan2018.yaml')).replace({
        'simulation.duration_s': 2.0 * (SETTLE_S + LENGTH_S), 'simulation.real_time_factor': 1.0,
        'simulation.wait_for_subscribers': 1, 'simulation.wait_for_simulators': 1})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'config.yaml').write_text(parameter_file.dump(scenario))
        for viewers in (None, *options.viewers):
            measure(folder, viewers)
    return 0


if __name__ == '__main__':
    sys.exit(main())
