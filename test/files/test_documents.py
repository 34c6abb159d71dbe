# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON that are made to fill the memory, or to have no end."""

import time

import pytest

from instruments import TAN2018
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.documents import DocumentError, load_json, load_yaml
from starcal_ros.files.limits import CHUNK, NESTING, LimitError

BOMB = 'a0: &a0 [x, x]\n' + ''.join(f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 9)}]\n'
                                    for k in range(1, 30))
MERGES = 'a0: &a0 {x: 1}\n' + ''.join(f'a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n'
                                      for k in range(1, 40))


@pytest.mark.parametrize('text, message', [
    (BOMB, 'values, repeated ones counted'),
    (MERGES, 'values, repeated ones counted'),
    ('a: &a [*a]', r'the alias \*a stands in what it repeats'),
    ('a: &a {b: {c: *a}}', 'stands in what it repeats'),
    ('[' * 100_000, f'more than {NESTING} levels'),
    ('{a: ' * 100_000, f'more than {NESTING} levels'),
    ('- ' * 100_000, f'more than {NESTING} levels'),
    ('[' * 70 + ']' * 70, f'more than {NESTING} levels'),
    ('a: *gone', 'not YAML: found undefined alias'),
    ('a: ' + '9' * 10_000, 'not YAML: ValueError'),
    ('a: 2026-13-45', 'not YAML: ValueError'),
    ('a: !!timestamp x', 'not YAML: '), ('a: !!bool x', 'not YAML: '),
    ('a: !!python/object:os.system x', 'not YAML: could not determine'),
    ('a: "\x00"', 'not YAML: '),
    ('#' * 9_000_000, 'a text of 9 MB, at most 8 are read .STARCAL_MAX_DOCUMENT_MB.')],
    ids=range(16))
def test_what_has_no_end_is_refused_at_once(text, message):
    begin = time.perf_counter()
    with pytest.raises(DocumentError, match=message) as caught:
        load_yaml(text)
    assert '\n' not in str(caught.value)
    assert time.perf_counter() - begin < 5.0


def test_what_is_repeated_within_bounds_is_read():
    assert load_yaml('a: &a [1, 2]\nb: [*a, *a]\nc: {<<: {d: *a}}') == {
        'a': [1, 2], 'b': [[1, 2], [1, 2]], 'c': {'d': [1, 2]}}
    assert load_yaml('[' * NESTING + ']' * NESTING)


@pytest.mark.parametrize('text', [BOMB, 'a: &a [*a]', '[' * 100_000, 'a: 2026-13-45'])
def test_a_parameter_file_without_end_is_named(text):
    with pytest.raises(ConfigError, match='^mine.yaml'):
        parameter_file.parse(text, 'mine.yaml')


def test_a_parameter_file_with_aliases_in_place_of_a_group_is_named():
    """A bomb below the bounds is still no scenario."""
    with pytest.raises(ConfigError, match='^mine.yaml: '):
        parameter_file.parse(
            '/**: &a\n  ros__parameters:\n    camera: {x: [1, [2, [3]]]}', 'mine.yaml')
    assert parameter_file.parse(parameter_file.dump(TAN2018), 'x') == TAN2018


@pytest.mark.parametrize('text, message', [
    ('[' * 100_000, 'nested too deep'), ('{"a":' * 100_000, 'nested too deep'),
    ('9' * 5000, 'not JSON: ValueError'), (b'\xff', 'not JSON: Unicode'), ('', 'not JSON: '),
    (b' ' * 9_000_000, 'at most 8 are read')])
def test_json_without_end_is_refused(text, message):
    with pytest.raises(DocumentError, match=message) as caught:
        load_json(text)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('given', ['much', '', '-1', '0', 'nan', 'inf'])
def test_a_limit_that_is_none_is_named(monkeypatch, given):
    monkeypatch.setenv(CHUNK.variable, given)
    with pytest.raises(LimitError, match=f'STARCAL_MAX_CHUNK_MB: got {given!r}, needs a number'):
        CHUNK.check(1, 'data')
