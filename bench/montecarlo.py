# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a Monte Carlo of T18's scenario takes: `python bench/montecarlo.py`.

100 runs of two hours by `starcal montecarlo`, in a process of its own, on all cores that there
are: the seconds from its start to its end, beside what is aimed at on two.
"""

from pathlib import Path
import subprocess
import sys
import tempfile
import time

AIM_S = 45.0


def main() -> int:
    """Measure it."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        subprocess.run([sys.executable, '-m', 'starcal_ros.cli', 'montecarlo', '--runs', '100',
                        '--out', str(Path(folder, 'summary.json'))], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        took = time.monotonic() - begin
    print(f'100 runs of 2 h: {took:.1f} s of {AIM_S:.0f} aimed at')
    return 0 if took <= AIM_S else 1


if __name__ == '__main__':
    sys.exit(main())
