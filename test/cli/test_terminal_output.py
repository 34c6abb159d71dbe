# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the command says on the terminal."""

import pytest

from starcal_ros.cli.terminal import progress


@pytest.mark.parametrize('fails', [False, True])
def test_what_is_done_is_shown_as_done(capsys, fails):
    """Whatever part was told last; what failed stays where it was."""
    try:
        with progress('reading') as on_progress:
            on_progress(0.98)
            if fails:
                raise ValueError
    except ValueError:
        pass
    assert ('98%' if fails else '100%') in capsys.readouterr().err
