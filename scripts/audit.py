#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Ask PyPI whether what is installed has known vulnerabilities: ``make audit``.

pip-audit gets an environment of its own and the versions that pip has installed here. The exit
status is 1 where something is known, and where a package could not be asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
import subprocess
import sys
import tempfile
import venv


def installed() -> Iterator[str]:
    """Yield the packages that pip brought, as ``name==version``.

    Not the checkout, and not what lies inside of another package, as parts of ROS 2 do.
    """
    for package in metadata.distributions():
        by_pip = (package.read_text('INSTALLER') or '').strip() == 'pip'
        if by_pip and package.metadata['Name'].replace('-', '_') != 'starcal_ros':
            yield f'{package.metadata["Name"]}=={package.version}'


def main() -> int:
    """Run pip-audit; return its exit status."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        versions = folder / 'installed.txt'
        versions.write_text('\n'.join(sorted({*installed()})) + '\n', encoding='utf-8')
        venv.create(folder / 'venv', with_pip=True)
        programs = folder / 'venv' / 'bin'
        subprocess.run([programs / 'pip', 'install', '--quiet', 'pip-audit'], check=True)
        return subprocess.run([programs / 'pip-audit', '--strict', '--no-deps', '--disable-pip',
                               '--requirement', versions]).returncode


if __name__ == '__main__':
    sys.exit(main())
