#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Write the pages of results, docs/results.md and docs/results/, from ``starcal reproduce``.

Usage::

    starcal reproduce all --out results/all.json
    python scripts/make_results.py results/all.json

What the files hold replaces what ``docs/results.json`` holds under the same names, so a table can
be made anew alone; the figures beside them go into ``docs/images/results/``. Without a file the
pages are written again from ``docs/results.json``. Every number of theirs is one of that file.
"""

from __future__ import annotations

import argparse
from collections import Counter
from itertools import groupby
import json
from pathlib import Path
import re
from typing import Any

from PIL import Image

DOCS = Path(__file__).parents[1] / 'docs'
FIGURES = 'images/results'
SECTIONS = {
    'covariance': ('Covariance, bound, NEES and NIS', 'covariance'),
    't18_tables': ('Tables of Tan et al. 2018 (T18)', r'table\d'),
    't18_figures': ('Figures of T18', r'fig\d'),
    'budget': ('Error budget', 'budget'),
    'open_loop': ('Open loop and feedback', 'open-loop'),
    'wrong_models': ('Models that are wrong', 'wrong-models|detection-limits|user-mistakes'),
    'w19': ('Wu et al. 2019 (W19)', 'w19-.*'),
    's24': ('Self-calibration of star sensors 2024 (S24)', 's24-.*'),
    'more': ('More', '.*'),
}
"""Page of each section, its heading, and the names of what stands in it."""
HEAD = """# Results

Made by `python scripts/make_results.py` from [results.json](results.json), which
`starcal reproduce` wrote; a test compares the two, so edit neither. Each table names the command
that its numbers come from.

*paper* is the number printed in the paper, *ours* what this package gives, *bound* the Cramér–Rao
bound of the scenario, below which no unbiased estimator comes, and *ratio* ours over the bound.
All runs of a study begin with the same errors, those of the nominal values; the intervals of NEES
count that.
"""
_COLOURS = 256


def pages(results: dict[str, Any]) -> dict[str, str]:
    """Return the pages, Markdown, by their files in docs/: a list of all, and one a section."""
    left, made, lines, hidden = sorted(results), {}, [HEAD], []
    for file, (heading, pattern) in SECTIONS.items():
        names = [name for name in left if re.fullmatch(pattern, name)]
        left = [name for name in left if name not in names]
        if not names:
            continue
        path = f'results/{file}.md'
        made[path] = _page(heading, {name: results[name] for name in names})
        lines += [f'**[{heading}]({path})**\n',
                  *(f'* [{title}]({path}#{_anchor(title)})'
                    for title in (results[name]['title'] for name in names)), '']
        hidden.append(path.removesuffix('.md'))
    lines += ['```{toctree}', ':hidden:', '', *hidden, '```', '']
    return {'results.md': '\n'.join(lines), **made}


def _anchor(title: str) -> str:
    """Return the anchor that a heading has, with MyST as with GitHub."""
    return re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-')


def _page(heading: str, results: dict[str, Any]) -> str:
    shared = [note for note, count in Counter(
        note for outcome in results.values() for note in outcome['notes']).items() if count > 1]
    lines = [f'# {heading}\n',
             'What the columns mean is told [before all results](../results.md).\n']
    for name, outcome in results.items():
        lines += _study(name, outcome, shared)
    lines += [f'[^{k}]: {note}\n' for k, note in enumerate(shared, start=1)]
    return '\n'.join(lines)


def _study(name: str, outcome: dict[str, Any], shared: list[str]) -> list[str]:
    """Return the lines of one outcome: title, figure, tables, notes, command."""
    lines = [f'## {outcome["title"]}\n']
    if outcome['figure']:
        lines.append(f'![{outcome["title"]}](../{FIGURES}/{name}.png)\n')
    rows = outcome['rows']
    first = next(iter(rows[0]))
    groups = [(value, list(group)) for value, group in groupby(rows, lambda row: row[first])]
    if max(len(group) for _, group in groups) == 1:
        groups = [('', rows)]
    for value, group in groups:
        if value:
            lines.append(f'{value}:\n')
            group = [{key: cell for key, cell in row.items() if key != first} for row in group]
        lines += _table(group)
    lines += [f'* {note}' for note in outcome['notes'] if note not in shared]
    marks = [f'[^{shared.index(note) + 1}]' for note in outcome['notes'] if note in shared]
    lines += [f'* Notes that several tables share: {" ".join(marks)}'] if marks else []
    provenance = outcome['provenance']
    return [*lines, f'* `{provenance["command"]}`, starcal_ros {provenance["version"]}\n']


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """Return rows as a table, texts to the left and numbers to the right."""
    texts = {key: all(isinstance(row[key], str) for row in rows) for key in rows[0]}
    lines = [' | '.join(texts), ' | '.join('---' if text else '---:' for text in texts.values())]
    lines += [' | '.join(_cell(cell) for cell in row.values()) for row in rows]
    return [*(f'| {line} |' for line in lines), '']


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f'{value:.3g}'


def gather(paths: list[Path], docs: Path) -> dict[str, Any]:
    """Take new outcomes and their figures into the stored ones; return all."""
    stored = docs / 'results.json'
    results = json.loads(stored.read_text(encoding='utf-8')) if stored.exists() else {}
    (docs / FIGURES).mkdir(parents=True, exist_ok=True)
    for path in paths:
        for name, outcome in json.loads(path.read_text(encoding='utf-8')).items():
            figure = path.with_name(f'{name}.png')
            results[name] = {**outcome, 'figure': figure.exists()}
            if figure.exists():
                # Half the size, and no difference that can be seen.
                with Image.open(figure) as image:
                    image.convert('RGB').quantize(_COLOURS).save(
                        docs / FIGURES / figure.name, optimize=True)
    stored.write_text(json.dumps(results, indent=1, sort_keys=False) + '\n', encoding='utf-8')
    return results


def main() -> None:
    """Gather the files that are given and write the page."""
    parser = argparse.ArgumentParser(description='Write docs/results.md and docs/results/.')
    parser.add_argument('files', metavar='FILE.json', nargs='*', type=Path,
                        help='what starcal reproduce wrote, its figures beside it')
    parser.add_argument('--docs', type=Path, default=DOCS, help='folder of the page')
    options = parser.parse_args()
    results = gather(options.files, options.docs)
    (options.docs / 'results').mkdir(exist_ok=True)
    for name, text in pages(results).items():
        (options.docs / name).write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
