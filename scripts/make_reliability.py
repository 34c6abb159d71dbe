#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Write docs/reliability.md from what the tests and the scripts of bench/ found.

Usage::

    python bench/fuzz.py 1000000 --out docs/reliability/fuzz.json
    python bench/kill.py --out docs/reliability/kill.json
    pytest --junitxml=build/tests.xml $(python scripts/make_reliability.py --list)
    python scripts/make_reliability.py build/tests.xml

The last two are ``make reliability``. ``docs/reliability/faults.yaml`` has faults, promises and
the names of the tests. A report of pytest with a test among them that did not pass is refused;
else their cases, and what they recorded (``record_property('figure', ...)``), go into
``docs/reliability/tests.json``. Without a report the page is written again from what is there.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Mapping
import json
from pathlib import Path
import sys
from typing import Any
from xml.etree import ElementTree

import yaml

DOCS = Path(__file__).parents[1] / 'docs'


def stored(docs: Path) -> dict[str, Any]:
    """Return all that the page is made of, by the name of its file."""
    folder = docs / 'reliability'
    return {'faults': yaml.safe_load((folder / 'faults.yaml').read_text(encoding='utf-8')),
            'page': (folder / 'page.md.in').read_text(encoding='utf-8'),
            **{name: json.loads((folder / f'{name}.json').read_text(encoding='utf-8'))
               for name in ('tests', 'fuzz', 'kill')}}


def named(faults: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the tests that hold the promises, as ``file::name``, each once."""
    return list(dict.fromkeys(test for fault in faults for test in fault.get('tests', ())))


def found(report: Path, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return cases and figures of tests, out of a JUnit report of pytest.

    Raises
    ------
    ValueError
        Where one of them did not pass, was skipped or is not there.
    """
    cases, wrong = Counter[str](), set[str]()
    figures: dict[str, list[str]] = {}
    for case in ElementTree.parse(report).iter('testcase'):
        test = (case.get('classname', '').replace('.', '/') + '.py::'
                + case.get('name', '').partition('[')[0])
        cases[test] += 1
        figures.setdefault(test, []).extend(each.get('value', '') for each in case.iter('property')
                                            if each.get('name') == 'figure')
        if any(each.tag in ('failure', 'error', 'skipped') for each in case):
            wrong.add(test)
    names = list(names)
    if bad := [name for name in names if name in wrong or not cases[name]]:
        raise ValueError(f'{report}: not passed: {", ".join(bad)}')
    return {name: {'cases': cases[name], 'figures': figures[name]} for name in names}


def page(stored: Mapping[str, Any]) -> str:
    """Return the page, Markdown."""
    fuzz, kill = stored['fuzz'], stored['kill']
    rows = [[name, sum(counts.values()), *counts.values()]
            for name, counts in fuzz['kinds'].items()]
    inputs = (f'{fuzz["inputs"]:,} inputs' if fuzz['inputs'] == fuzz['of'] else
              f'{fuzz["inputs"]:,} inputs of the {fuzz["of"]:,} that were wanted')
    parts = {
        'faults': _table(['fault', 'promise', 'test', 'figure'], [
            [fault['fault'], fault['promise'], _tests(fault), _figure(fault, stored['tests'])]
            for fault in stored['faults']]),
        'kill': _table(['factor', 'lost, median [s]', 'lost, most [s]'], [
            [f'{each["factor"]:g}', f'{each["median_s"]:.2f}', f'{each["most_s"]:.2f}']
            for each in kill['runs']]),
        'kill_repeats': str(kill['repeats']),
        'fuzz': _table(['kind', 'inputs', 'read', 'refused in one line', 'failed'], rows),
        'fuzz_summary': f'{inputs} (seed {fuzz["seed"]}) in {fuzz["seconds"] / 60:.0f} min; the '
                        f'longest took {fuzz["longest_s"]:.2f} s, the largest process '
                        f'{fuzz["largest_process_mb"]} MB.'}
    text: str = stored['page']
    for name, part in parts.items():
        text = text.replace(f'{{{name}}}', part)
    return text


def _tests(fault: Mapping[str, Any]) -> str:
    """Return the tests of a fault, those of a file together."""
    files: dict[str, list[str]] = {}
    for test in fault.get('tests', ()):
        file, _, name = test.partition('::')
        files.setdefault(file, []).append(f'`{name}`')
    return '<br>'.join([*(f'`{file}`: {", ".join(names)}' for file, names in files.items()),
                        *([f'`{fault["bench"]}`'] if 'bench' in fault else [])])


def _figure(fault: Mapping[str, Any], tests: Mapping[str, Any]) -> str:
    """Return what was measured of a fault."""
    own = [tests[test] for test in fault.get('tests', ())]
    cases = sum(test['cases'] for test in own)
    texts = [f'{cases} case{"s" if cases > 1 else ""}'] if cases else []
    texts += [figure for test in own for figure in test['figures']]
    texts += [f'[below]({fault["section"]})'] if 'section' in fault else []
    texts += [f'by hand: {fault["by_hand"]}'] if 'by_hand' in fault else []
    return '; '.join(texts)


def _table(head: list[str], rows: Iterable[list[Any]]) -> str:
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join(f'| {" | ".join(map(str, line))} |' for line in lines)


def main() -> int:
    """Take in a report, if there is one, and write the page."""
    parser = argparse.ArgumentParser(description='Write docs/reliability.md.')
    parser.add_argument('report', metavar='TESTS.xml', nargs='?', type=Path,
                        help='what pytest --junitxml wrote')
    parser.add_argument('--list', action='store_true', help='print the tests and do nothing')
    parser.add_argument('--docs', type=Path, default=DOCS, help='folder of the page')
    options = parser.parse_args()
    folder = options.docs / 'reliability'
    names = named(yaml.safe_load((folder / 'faults.yaml').read_text(encoding='utf-8')))
    if options.list:
        print('\n'.join(names))
        return 0
    if options.report:
        try:
            tests = found(options.report, names)
        except ValueError as error:
            print(error, file=sys.stderr)
            return 1
        (folder / 'tests.json').write_text(json.dumps(tests, indent=1, ensure_ascii=False) + '\n',
                                           encoding='utf-8')
    (options.docs / 'reliability.md').write_text(page(stored(options.docs)), encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
