# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The patterns of a range of fields are built once, and then kept."""

import pytest

from starcal_ros.files import cache
from starcal_ros.identification import patterns

FIELDS = (5, 6, 5.0)


@pytest.fixture(autouse=True)
def no_patterns(tmp_path, monkeypatch):
    """Begin without any, as another process does."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    patterns.database.cache_clear()
    yield
    patterns.database.cache_clear()


def test_patterns_are_built_once_for_all_processes(monkeypatch):
    tetra3rs = pytest.importorskip('tetra3rs')
    built = patterns.database(*FIELDS)
    patterns.database.cache_clear()

    class Read:
        load_from_file = staticmethod(tetra3rs.SolverDatabase.load_from_file)

    monkeypatch.setattr(tetra3rs, 'SolverDatabase', Read)      # nothing is generated
    read = patterns.database(*FIELDS)
    assert (read.num_patterns, read.num_stars) == (built.num_patterns, built.num_stars)
    with pytest.raises(AttributeError):
        patterns.database(5, 6, 5.5)                            # another sky


def test_patterns_of_another_build_of_the_library_are_built_anew():
    pytest.importorskip('tetra3rs')
    built = patterns.database(*FIELDS)
    patterns.database.cache_clear()
    name = next(path.name for path in cache.folder().iterdir() if not path.suffix)
    cache.keep(name, lambda draft: draft.write_bytes(b'of a kind that is not known'))
    assert patterns.database(*FIELDS).num_patterns == built.num_patterns
    patterns.database.cache_clear()
    assert cache.find(name).stat().st_size > 1000
