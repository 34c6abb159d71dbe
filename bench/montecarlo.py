# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a Monte Carlo of T18's scenario takes: `python bench/montecarlo.py`.

100 runs of two hours by `starcal montecarlo`, in a process of its own, on all cores that there
are: the seconds from its start to its end. What is aimed at is meant for two cores.
"""

from pathlib import Path
import subprocess
import sys
import tempfile
import time

from bars import told

AIM_S = 45.0


def main() -> int:
    """Measure it."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        subprocess.run([sys.executable, '-m', 'starcal_ros.cli', 'montecarlo', '--runs', '100',
                        '--out', str(Path(folder, 'summary.json'))], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        took = time.monotonic() - begin
    print(f'100 runs of 2 h: {took:.1f} s')
    return 0 if told('Monte Carlo, 100 runs of 2 h', took, AIM_S, 's') else 1


if __name__ == '__main__':
    sys.exit(main())
