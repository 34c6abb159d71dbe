# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files of every kind are read as far as they go or refused in one line.

A run of a million is `bench/fuzz.py`.
"""

from pathlib import Path
import tempfile

from hypothesis import HealthCheck, given, settings, strategies as st
import pytest

from fuzzed import WORDS, damage, is_held, kinds

FOLDER = Path(tempfile.mkdtemp(prefix='starcal_fuzz_'))
KINDS = kinds(FOLDER)
EDITS = st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 5), st.integers(0, 255)),
                 min_size=1, max_size=8)


@pytest.fixture(scope='module', autouse=True)
def removed():
    """Remove the files in the end."""
    yield
    for path in FOLDER.iterdir():
        path.unlink()
    FOLDER.rmdir()


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
def test_sound_files_are_read(kind):
    assert is_held(kind, kind.content, FOLDER) == (kind.name == 'metadata.yaml')


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(edits=EDITS)
def test_damaged_files_are_read_or_refused_in_one_line(kind, edits):
    is_held(kind, damage(kind.content, edits), FOLDER)


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(content=st.one_of(st.binary(max_size=200), st.lists(
    st.sampled_from(WORDS), max_size=40).map(b''.join)))
def test_files_of_anything_are_refused_in_one_line_or_empty(kind, content):
    is_held(kind, content, FOLDER)
    is_held(kind, kind.content[:20] + content, FOLDER)
