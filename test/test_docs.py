# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The documentation builds without a warning, and its examples give what they show."""

import doctest
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import textwrap

import pytest

from starcal_ros.config import parameter_file

TOP = Path(__file__).parents[1]
PAGES = sorted((TOP / 'docs').rglob('*.md'))
BUILD_S = 300.0


def blocks(page, language):
    """Return the code blocks of a page in a language, as they stand."""
    found = re.findall(rf'^ *```{language}\n(.*?)^ *```', page.read_text(), re.S | re.M)
    return [textwrap.dedent(block) for block in found]


@pytest.mark.parametrize('page', [page for page in PAGES if blocks(page, 'pycon')],
                         ids=lambda page: page.stem)
def test_examples_give_what_they_show(page):
    text = '\n'.join(blocks(page, 'pycon'))
    test = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    report = []
    failed, tried = doctest.DocTestRunner().run(test, out=report.append)
    assert tried and not failed, ''.join(report)


@pytest.mark.parametrize('page', [page for page in PAGES if blocks(page, 'yaml')],
                         ids=lambda page: page.stem)
def test_parameter_files_are_valid(page):
    for text in blocks(page, 'yaml'):
        parameter_file.parse(text, page.name)


@pytest.fixture(scope='module')
def built(tmp_path_factory):
    """Return the pages as HTML; without the theme, which costs as much as all the rest."""
    pytest.importorskip('sphinx')
    folder = tmp_path_factory.mktemp('docs')
    for path in TOP.iterdir():
        if path.name != 'docs' and not path.name.startswith('.'):
            (folder / path.name).symlink_to(path)
    shutil.copytree(TOP / 'docs', folder / 'docs', ignore=shutil.ignore_patterns('api'))
    done = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-W', '--keep-going', '-q', '-D', 'html_theme=basic',
         'docs', 'html'], cwd=folder, env={**os.environ, 'PYTHONPATH': str(TOP)},
        text=True, timeout=BUILD_S, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    return folder / 'html'


@pytest.mark.slow
def test_each_page_and_each_module_has_its_page(built):
    modules = ('.'.join(path.relative_to(TOP).with_suffix('').parts)
               for path in (TOP / 'starcal_ros').rglob('*.py')
               if path.stem not in ('__init__', '__main__'))
    for name in (*(page.relative_to(TOP / 'docs').with_suffix('') for page in PAGES),
                 *(Path('api', module) for module in modules)):
        assert built.joinpath(f'{name}.html').is_file(), name


@pytest.mark.slow
def test_equations_are_mathml_and_nothing_is_loaded_from_the_network(built):
    page = (built / 'models.html').read_text()
    assert page.count('<math') > 20 and '\\frac' not in page
    assert not re.search(r'<(script|link|img)[^>]*(src|href)="(https?:)?//', page)
