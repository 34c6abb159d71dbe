# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A page of HTML that needs nothing but itself, made of parts that say nothing of its form.

There are two forms of a page: one with charts that zoom and tell their values, of some megabytes
of script, and a light one with charts that are pictures (`still_chart`), without any script. Both
have a content security policy that forbids the browser to load anything, so that a page stays what
it is wherever it is opened. All text that comes in is escaped.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import NamedTuple

from starcal_ros.report import still_chart
from starcal_ros.report.chart import ROLES, Chart

POLICIES = ("default-src 'none'; {script}style-src 'unsafe-inline'; "
            "img-src data: blob:; base-uri 'none'; form-action 'none'")


class Charts(NamedTuple):
    """Figures side by side."""

    figures: tuple[Chart, ...]


Part = str | Charts
"""Of a section: finished HTML, or charts."""


class PageSection(NamedTuple):
    """A section: its name in links, its heading, and finished HTML or charts."""

    name: str
    title: str
    parts: tuple[Part, ...]


class Page(NamedTuple):
    """A page: its heading, what stands at the top as names and values, and its sections."""

    title: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[PageSection, ...]


def document(page: Page, light: bool = False, printed: bool = False) -> str:
    """Return a page as HTML.

    Parameters
    ----------
    page : Page
    light : bool
        With pictures in place of charts that are drawn by a script.
    printed : bool
        Likewise, for paper: the pictures in colours of their own.
    """
    light = light or printed
    body = '\n'.join((
        f'<h1>{escape(page.title)}</h1>', _facts(page.facts), _contents(page.sections),
        *(_section(each, light, printed) for each in page.sections)))
    script = '' if light else "script-src 'unsafe-inline'; "
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICIES.format(script=script)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>{escape(page.title)}</title>
<style>{_data('report.css')}</style>
</head>
<body>
<main>
{body}
</main>
{'' if light else _scripts()}</body>
</html>
"""


def section(name: str, title: str, *parts: Part) -> PageSection:
    """Return a section of finished parts."""
    return PageSection(name, title, parts)


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f'<p>{escape(text)}</p>'


def items(texts: Sequence[str]) -> str:
    """Return a list."""
    return '<ul>' + ''.join(f'<li>{escape(text)}</li>' for text in texts) + '</ul>'


def key(entries: Sequence[tuple[str, str]]) -> str:
    """Return a legend: kinds of lines, bands and bars (classes of report.css), and their words."""
    return '<p class="key">' + ''.join(
        f'<span><i class="{kind}"></i> {escape(text)}</span>' for kind, text in entries) + '</p>'


def table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return a table; the first cell of a row is its heading."""
    def line(cells: Sequence[str], tag: str) -> str:
        first, *rest = (escape(cell) for cell in cells)
        return f'<tr><th>{first}</th>' + ''.join(f'<{tag}>{c}</{tag}>' for c in rest) + '</tr>'

    top = f'<thead>{line(head, "th")}</thead>' if head else ''
    # What is wider than the screen scrolls, by keys as well.
    return (f'<div class="scroll" tabindex="0"><table>{top}<tbody>'
            + '\n'.join(line(cells, 'td') for cells in body) + '</tbody></table></div>')


def charts(figures: Sequence[Chart]) -> Charts:
    """Return figures side by side."""
    return Charts(tuple(figures))


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    return '<dl class="facts">' + ''.join(
        f'<dt>{escape(name)}</dt><dd>{escape(value)}</dd>' for name, value in facts) + '</dl>'


def _contents(sections: Sequence[PageSection]) -> str:
    return '<nav aria-label="Contents"><ul>' + ''.join(
        f'<li><a href="#{each.name}">{escape(each.title)}</a></li>' for each in sections
    ) + '</ul></nav>'


def _section(each: PageSection, light: bool, printed: bool) -> str:
    inside = '\n'.join(part if isinstance(part, str) else _charts(part, light, printed)
                       for part in each.parts)
    return f'<section id="{each.name}">\n<h2>{escape(each.title)}</h2>\n{inside}\n</section>'


def _charts(part: Charts, light: bool, printed: bool) -> str:
    def inside(chart: Chart) -> str:
        return (still_chart.svg(chart) if printed else _still(chart) if light else _drawn(chart))

    return '<div class="charts">' + '\n'.join(
        f'<figure{" class=wide" if chart.wide else ""}>'
        f'<figcaption>{escape(chart.title)}</figcaption>'
        f'{inside(chart)}</figure>'
        for chart in part.figures) + '</div>'


def _drawn(chart: Chart) -> str:
    """Return a chart that report.js draws from its data."""
    return (f'<div class="chart" style="height:{chart.figure.layout.height}px"></div>'
            f'<script type="application/json">{chart.figure.to_json()}</script>')


def _still(chart: Chart) -> str:
    """Return a chart as a picture in the colours of the page."""
    picture = still_chart.svg(chart)
    for colour, role in ROLES.items():
        picture = picture.replace(f':{colour}', f':var(--{role},{colour})')
    return picture


def _scripts() -> str:
    from plotly.offline import get_plotlyjs
    roles = ', '.join(f"'{colour}': '--{role}'" for colour, role in ROLES.items())
    return (f'<script>{get_plotlyjs()}</script>\n'
            f"<script>const roles = {{ {roles} }};\n{_data('report.js')}</script>\n")


def _data(name: str) -> str:
    return (files('starcal_ros') / 'data' / name).read_text('utf-8')
