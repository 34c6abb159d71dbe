# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a command says of wrong input."""

from instruments import CONFIG

NOT_YET = 3             # after the 20 s of these recordings


def assert_refused(done, command, *culprits, status=2):
    """Check the exit status and the one line of complaint."""
    assert done.status == status, done.err
    lines = [line for line in done.err.splitlines()
             if line.startswith(f'starcal {command}: error: ')]
    assert len(lines) == 1
    assert done.err.rstrip().splitlines()[-1] == lines[0]
    for culprit in culprits:
        assert str(culprit) in lines[0]


def altered(folder, old, new):
    """Return a parameter file that differs from the shipped one in one place."""
    text = CONFIG.read_text()
    assert text.count(old) == 1
    path = folder / 'other.yaml'
    path.write_text(text.replace(old, new))
    return path
