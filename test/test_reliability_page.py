# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The page of promises agrees with what was measured, and each test that it names exists."""

import ast
from pathlib import Path
import re
import subprocess
import sys

import pytest

import instruments

TOP = Path(__file__).parents[1]
PAGE = (TOP / 'docs' / 'reliability.md').read_text()


@pytest.fixture(scope='module')
def script():
    """Return the script that writes the page."""
    return instruments.script('make_reliability')


@pytest.fixture(scope='module')
def stored(script):
    """Return what it is made of."""
    return script.stored(TOP / 'docs')


def test_page_is_what_the_script_makes_of_the_stored_figures(script, stored):
    assert script.page(stored) == PAGE


def test_each_test_that_is_named_exists_and_each_fault_has_one_or_was_measured(script, stored):
    for fault in stored['faults']:
        assert fault.get('tests') or fault.get('by_hand'), fault['fault']
    names = script.named(stored['faults'])
    assert set(stored['tests']) == set(names) and len(names) > 50
    for file in {name.partition('::')[0] for name in names}:
        defined = {node.name for node in ast.parse((TOP / file).read_text()).body
                   if isinstance(node, ast.FunctionDef)}
        assert {name.partition('::')[2] for name in names if name.startswith(f'{file}::')
                } <= defined, file
    for bench in re.findall(r'`(bench/\w+\.py)`', PAGE):
        assert (TOP / bench).is_file()


def test_no_damaged_file_failed(stored):
    fuzz = stored['fuzz']
    assert sum(sum(counts.values()) for counts in fuzz['kinds'].values()) == fuzz['inputs']
    assert not any(counts['failed'] for counts in fuzz['kinds'].values())


REPORT = """<testsuites><testsuite>
<testcase classname="test.a.test_b" name="test_c[1]"><properties>
<property name="figure" value="3 of 3"/></properties></testcase>
<testcase classname="test.a.test_b" name="test_c[2]">{}</testcase>
<testcase classname="test.a.test_b" name="test_other"><failure/></testcase>
</testsuite></testsuites>"""


def test_cases_and_figures_are_those_of_the_report(script, tmp_path):
    report = tmp_path / 'tests.xml'
    report.write_text(REPORT.format(''))
    assert script.found(report, ['test/a/test_b.py::test_c']) == {
        'test/a/test_b.py::test_c': {'cases': 2, 'figures': ['3 of 3']}}
    for names in (['test/a/test_b.py::test_other'], ['test/a/test_b.py::test_gone']):
        with pytest.raises(ValueError, match=f'not passed: {names[0]}'):
            script.found(report, names)
    for end in ('failure', 'error', 'skipped'):
        report.write_text(REPORT.format(f'<{end}/>'))
        with pytest.raises(ValueError, match='not passed: test/a/test_b.py::test_c'):
            script.found(report, ['test/a/test_b.py::test_c'])


def test_the_list_is_what_pytest_takes(script, stored):
    done = subprocess.run([sys.executable, script.__file__, '--list'], capture_output=True,
                          text=True, check=True)
    assert done.stdout.split() == script.named(stored['faults'])
