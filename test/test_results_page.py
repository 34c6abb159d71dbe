# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The pages of results hold the numbers of docs/results.json and nothing else."""

import json
from pathlib import Path
import re
import sys

from PIL import Image
import pytest

import instruments
from starcal_ros.reproduction import published
from starcal_ros.reproduction.published import ONE_DRAW

TOP = Path(__file__).parents[1]
DOCS = TOP / 'docs'
RESULTS = json.loads((DOCS / 'results.json').read_text())
PAGES = {str(path.relative_to(DOCS)): path.read_text()
         for path in (DOCS / 'results.md', *(DOCS / 'results').iterdir())}
PAGE = '\n'.join(PAGES.values())
T18 = {'table3', 'table4', 'table5', *(f'fig{k}' for k in range(3, 10))}


@pytest.fixture(scope='module')
def make_results():
    """Return the script that writes the page."""
    return instruments.script('make_results')


def outcome(title, notes=('A note.',), rows=({'state': 'f', 'ours': 0.12345},)):
    return {'title': title, 'notes': list(notes), 'rows': list(rows), 'provenance': {
        'command': f'starcal reproduce {title}', 'version': '1', 'config_sha256': ''}}


def test_pages_are_what_the_script_makes_of_the_stored_numbers(make_results):
    assert make_results.pages(RESULTS) == PAGES


def test_everything_of_T18_is_there_with_a_hundred_runs_a_column():
    assert T18 | {'budget', 'covariance', 'open-loop'} <= set(RESULTS) <= set(published.names())
    for name in ('table4', 'table5', 'covariance'):
        assert RESULTS[name]['provenance']['command'].endswith('--runs 100')


def test_each_study_names_its_command_and_has_its_figure():
    for name, stored in RESULTS.items():
        assert f'`{stored["provenance"]["command"]}`' in PAGE
        assert (f'(../images/results/{name}.png)' in PAGE) == stored['figure']
    pictures = re.findall(r'\]\(\.\./(images/\S+)\)', PAGE)
    assert {DOCS / picture for picture in pictures} == set(
        (DOCS / 'images' / 'results').iterdir())


def test_new_numbers_replace_the_old_of_the_same_name(make_results, tmp_path, monkeypatch):
    docs, new = tmp_path / 'docs', tmp_path / 'new.json'
    docs.mkdir()
    (docs / 'results.json').write_text(json.dumps(
        {name: {**outcome(name), 'figure': False} for name in ('table3', 'fig3')}))
    new.write_text(json.dumps({'fig3': outcome('fig3', rows=[{'state': 'f', 'ours': 9.5}])}))
    Image.new('RGB', (4, 3), 'red').save(tmp_path / 'fig3.png')
    monkeypatch.setattr(sys, 'argv', ['make_results.py', str(new), '--docs', str(docs)])
    make_results.main()
    page = (docs / 'results' / 't18_figures.md').read_text()
    assert '| f | 0.123 |' in (docs / 'results' / 't18_tables.md').read_text()
    assert '| f | 9.5 |' in page
    assert '![fig3](../images/results/fig3.png)' in page
    with Image.open(docs / 'images' / 'results' / 'fig3.png') as image:
        assert image.size == (4, 3)


def joined(pages):
    """Return the pages of sections as one text."""
    return '\n'.join(text for name, text in pages.items() if name != 'results.md')


def test_studies_get_pages_of_their_own_and_a_line_in_the_list(make_results):
    pages = make_results.pages({name: {**outcome(name), 'figure': False}
                                for name in ('w19-table2', 's24-fig3', 'unheard-of', 'table3')})
    assert list(pages) == ['results.md', 'results/t18_tables.md', 'results/w19.md',
                           'results/s24.md', 'results/more.md']
    headings = re.findall(r'^##? (.*)$', joined(pages), re.M)
    assert headings == ['Tables of Tan et al. 2018 (T18)', 'table3', 'Wu et al. 2019 (W19)',
                        'w19-table2', 'Self-calibration of star sensors 2024 (S24)', 's24-fig3',
                        'More', 'unheard-of']
    assert '* [w19-table2](results/w19.md#w19-table2)' in pages['results.md']
    assert 'results/s24\n' in pages['results.md'].partition('{toctree}')[2]


def test_a_bound_of_an_assumed_weight_has_no_ratio():
    for row in RESULTS['table4']['rows']:
        assert (row['ratio'] == '') == next(iter(row.values())).endswith('= 0')
    assert not re.search('honest', json.dumps(RESULTS['table4']))
    for name in ('table4', 'table5'):
        assert ONE_DRAW in RESULTS[name]['notes']


def test_rows_are_grouped_by_their_first_column(make_results):
    rows = [{'column': column, 'state': state, 'ours': 1.0}
            for column in ('sigma = 1', 'sigma = 2') for state in ('u0', 'v0')]
    page = joined(make_results.pages({'x': {**outcome('x', rows=rows), 'figure': False}}))
    assert page.count('| state | ours |\n| --- | ---: |\n| u0 | 1 |\n| v0 | 1 |\n') == 2
    assert 'sigma = 1:\n' in page


def test_a_note_that_studies_share_is_written_once(make_results):
    page = joined(make_results.pages({
        name: {**outcome(name, ('Shared.', f'Of {name}.')), 'figure': False}
        for name in ('table3', 'table4')}))
    assert page.count('Shared.') == 1 and page.count('[^1]') == 3
    assert '* Of table3.' in page and '* Of table4.' in page
