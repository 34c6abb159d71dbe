# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The names of the topics stand in one module, and what is built on them agrees."""

import ast
from pathlib import Path

import pytest

import starcal_ros
from starcal_ros.messages import topics

PACKAGE = Path(starcal_ros.__file__).parent
NAMES = {name for topic in topics.TOPICS for name in (topic.name, topic.recorded)}


def spelled(package):
    """Return where a module other than `messages.topics` has the name of a topic as a string."""
    return {f'{path.relative_to(package)}:{node.lineno} {node.value}'
            for path in package.rglob('*.py') if path != package / 'messages' / 'topics.py'
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant) and node.value in NAMES}


def test_no_other_module_spells_the_name_of_a_topic():
    assert spelled(PACKAGE) == set()


@pytest.mark.parametrize('text', [
    "x = 'imu/data_raw'", "f('/starcal/state')", "f'{x}diagnostics'"])
def test_a_name_that_is_spelled_is_found(tmp_path, text):
    (tmp_path / 'loose.py').write_text(text)
    assert len(spelled(tmp_path)) == 1


def test_every_topic_of_the_module_is_listed_once():
    constants = [value for value in vars(topics).values() if isinstance(value, topics.Topic)]
    # Simulators tell each other how far they are; nobody records that.
    assert sorted(constants) == sorted((*topics.TOPICS, topics.PROGRESS))
    assert len({topic.name for topic in topics.TOPICS}) == len(topics.TOPICS)
