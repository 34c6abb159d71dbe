# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The README says what there is: its commands, parameters, files and topics."""

from pathlib import Path
import re
import shlex

import pytest

from starcal_ros import cli, config
from starcal_ros.parameter import Parameter

TOP = Path(__file__).parents[1]
README = (TOP / 'README.md').read_text()
COMMANDS = [line.split('#')[0].strip() for block in re.findall(r'```sh\n(.*?)```', README, re.S)
            for line in block.splitlines() if line.strip()]


def of(program):
    """Return the arguments of each command of a program."""
    return [shlex.split(line)[1:] for line in COMMANDS if line.startswith(program + ' ')]


@pytest.mark.parametrize('words', of('starcal'), ids=' '.join)
def test_starcal_takes_the_command(words):
    cli.parse(words)


def test_make_has_the_targets():
    makefile = (TOP / 'Makefile').read_text()
    targets = [words[0] for words in of('make')]
    assert set(targets) == {'demo', 'test'}
    assert all(re.search(rf'^{target}:', makefile, re.M) for target in targets)


@pytest.mark.parametrize('words', [w for w in of('ros2') if w[0] == 'run'], ids=' '.join)
def test_ros2_run_finds_the_executable_and_its_parameters(words):
    _, package, executable, *rest = words
    assert package == 'starcal_ros'
    assert f"'{executable}': 'starcal_ros.nodes.{executable}:main'" in (
        TOP / 'setup.py').read_text()
    for key, value in (word.split(':=') for word in rest if ':=' in word):
        parameter: Parameter = config.parameters()[key]
        parameter.convert(key, parameter.element(value))
    for word in rest:
        assert not word.endswith('.yaml') or (TOP / word).is_file()


def test_ros2_launch_finds_the_file():
    for _, package, name in (words for words in of('ros2') if words[0] == 'launch'):
        assert package == 'starcal_ros' and (TOP / 'launch' / name).is_file()


def test_linked_files_exist():
    for target in re.findall(r'\]\(([^)]+)\)', README):
        assert (TOP / target).is_file(), target


def test_topic_table_lists_the_topics_of_the_suite():
    topics = pytest.importorskip('starcal_ros.nodes.topics', exc_type=ImportError)
    table = README.split('## Topics')[1].split('##')[0]
    for topic in topics.TOPICS:
        assert f'`{topic.name}`' in table or topic.name.endswith('image_raw'), topic.name
