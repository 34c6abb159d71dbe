# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The description of the interfaces speaks of what there is, and leaves nothing out."""

import ast
from pathlib import Path
import re

from starcal_ros.config.scenario import parameters
from starcal_ros.core.statistic import Statistic
from starcal_ros.filter.changes import ModelChange
from starcal_ros.filter.frame_result import Counts
from starcal_ros.messages.topics import TOPICS

TOP = Path(__file__).parents[1]
NODES = TOP / 'starcal_ros' / 'nodes'
TEXT = (TOP / 'docs' / 'interfaces.md').read_text()


def strings(path):
    """Return all strings in a module."""
    return {node.value for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def test_every_parameter_that_is_named_exists():
    named = set(re.findall(r'`((?:estimator|player|recorder|simulation)\.[a-z_.]+)(?:\*)?`', TEXT))
    assert len(named) > 10
    for name in named:
        assert any(key == name or name.endswith('.') and key.startswith(name)
                   for key in parameters()), name


def test_every_parameter_that_may_change_is_named():
    for key, parameter in parameters().items():
        if parameter.spec.changeable:
            assert f'`{key}`' in TEXT or f'`{key.rpartition(".")[0]}.*`' in TEXT, key


def test_every_topic_and_service_is_named():
    topics = {topic.name for topic in TOPICS}
    assert len(topics) >= 14
    for topic in topics:
        assert f'`{topic}`' in TEXT, topic
    for name in ('estimator', 'player'):
        for service in strings(NODES / f'{name}.py'):
            if service.startswith('~/'):
                assert f'`{name}/{service[2:]}`' in TEXT, service


def test_every_key_of_a_result_is_explained():
    """Those of the dictionaries that are written, and the fields of what is written whole."""
    table = TEXT.partition('### RESULT.json')[2]
    rows = dict(re.findall(r'^\| (`[^|]*`) \| (.*) \|$', table, re.MULTILINE))
    explained = {key: row for keys, row in rows.items() for key in re.findall(r'`(\w+)`', keys)}
    module = ast.parse((TOP / 'starcal_ros' / 'results' / 'result.py').read_text())
    function = next(node for node in module.body if getattr(node, 'name', '') == 'result')
    values = next(node.value for node in ast.walk(function) if isinstance(node, ast.Assign)
                  and isinstance(node.value, ast.Dict))
    written = {key.value: value for key, value in zip(values.keys, values.values)}
    assert set(explained) == {*written, 'explanations', 'augmented'}
    for key, value in written.items():
        for name in (each.value for part in ast.walk(value) if isinstance(part, ast.Dict)
                     for each in part.keys if each is not None):
            assert f'`{name}`' in explained[key], (key, name)
    for key, kind in (('counts', Counts.__dataclass_fields__), ('changes', ModelChange._fields),
                      ('consistency', Statistic._fields)):
        for name in kind:
            assert f'`{name}`' in explained[key], (key, name)
    for name in ('name', 'parameters', 'lines', 'numbers', 'gain', 'score', 'beyond_chance',
                 'to_adopt', 'tried', 'sentence', 'stretch_s'):
        assert f'`{name}`' in explained['explanations'], name
