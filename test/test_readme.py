# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""README and documentation say what there is: commands, parameters, files and topics."""

from itertools import pairwise
from pathlib import Path
import re
import shlex

import pytest

from starcal_ros import cli
from starcal_ros.config.parameter import Parameter
from starcal_ros.config.scenario import parameters

TOP = Path(__file__).parents[1]
PAGES = {str(path.relative_to(TOP)): path.read_text()
         for path in (TOP / 'README.md', *sorted((TOP / 'docs').rglob('*.md')))}
COMMANDS = [line.split(' #')[0].strip() for page in PAGES.values()
            for block in re.findall(r'^ *```sh\n(.*?)```', page, re.S | re.M)
            for line in block.splitlines() if line.strip()]


def of(program):
    """Return the arguments of each command of a program, each once."""
    return [shlex.split(line)[1:] for line in dict.fromkeys(COMMANDS)
            if line.startswith(program + ' ')]


@pytest.mark.parametrize('words', of('starcal'), ids=' '.join)
def test_starcal_takes_the_command(words):
    cli.parse(words)


def test_make_has_the_targets():
    makefile = (TOP / 'Makefile').read_text()
    targets = {words[0] for words in of('make')}
    assert {'demo', 'test'} <= targets
    assert all(re.search(rf'^{target}:', makefile, re.M) for target in targets)


@pytest.mark.parametrize('words', [w for w in of('ros2') if w[0] == 'run'], ids=' '.join)
def test_ros2_run_finds_the_executable_and_its_parameters(words):
    _, package, executable, *rest = words
    assert package == 'starcal_ros'
    assert f"'{executable}': 'starcal_ros.nodes.programs:{executable}'" in (
        TOP / 'setup.py').read_text()
    for option, word in pairwise(rest):
        if option == '-p':
            key, value = word.split(':=')
            parameter: Parameter = parameters()[key]
            parameter.convert(key, parameter.element(value))
        assert not word.startswith('config/') or (TOP / word).is_file()


def test_ros2_launch_finds_the_file_and_its_arguments():
    for _, package, name, *arguments in (words for words in of('ros2') if words[0] == 'launch'):
        assert package == 'starcal_ros'
        text = (TOP / 'launch' / name).read_text()
        for argument in arguments:
            assert re.search(rf"DeclareLaunchArgument\(\s*'{argument.split(':=')[0]}'", text)


@pytest.mark.parametrize('page', PAGES)
def test_linked_files_exist(page):
    for target in re.findall(r'\]\(([^)#]+)(?:#[^)]*)?\)', PAGES[page]):
        assert target.startswith('https://') or (TOP / page).parent.joinpath(target).is_file(), (
            target)


NAMED = [(page, path) for page, text in PAGES.items() if '/add_' not in page
         for path in re.findall(r'`([\w.-]+(?:/[\w.-]+)+\.(?:py|md|yaml|xml|json))`', text)]
"""Files that pages name; those on how to add something name what is not there yet."""


@pytest.mark.parametrize('page, path', NAMED)
def test_named_files_exist(page, path):
    assert (TOP / path).is_file() or (TOP / 'starcal_ros' / path).is_file()


def test_readme_is_one_screen_and_one_figure():
    text = PAGES['README.md']
    assert len(text.splitlines()) <= 70 and text.count('![') == 1
