# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a page of HTML that needs nothing but itself.

Its content security policy forbids the browser to load anything, so that the page stays what it
is wherever it is opened. All text that comes in is escaped.
"""

from __future__ import annotations

from html import escape
from importlib.resources import files

from plotly.offline import get_plotlyjs

from starcal_ros.report.chart import Chart

POLICIES = ("default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
            "img-src data: blob:; base-uri 'none'; form-action 'none'")


def document(title: str, *sections: str) -> str:
    """Return the page."""
    body = '\n'.join((f'<h1>{escape(title)}</h1>', *sections))
    data = files('starcal_ros') / 'data'
    style, script = ((data / name).read_text('utf-8') for name in ('report.css', 'report.js'))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICIES}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
<script>{get_plotlyjs()}</script>
<script>{script}</script>
</body>
</html>
"""


def section(name: str, title: str, *parts: str) -> str:
    """Return a section of finished parts."""
    inside = '\n'.join(parts)
    return f'<section id="{name}">\n<h2>{escape(title)}</h2>\n{inside}\n</section>'


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f'<p>{escape(text)}</p>'


def items(texts: list[str]) -> str:
    """Return a list."""
    return '<ul>' + ''.join(f'<li>{escape(text)}</li>' for text in texts) + '</ul>'


def table(head: list[str], body: list[list[str]]) -> str:
    """Return a table; the first cell of a row is its heading."""
    def line(cells: list[str], tag: str) -> str:
        first, *rest = (escape(cell) for cell in cells)
        return f'<tr><th>{first}</th>' + ''.join(f'<{tag}>{c}</{tag}>' for c in rest) + '</tr>'

    top = f'<thead>{line(head, "th")}</thead>' if head else ''
    return (f'<div class="scroll"><table>{top}<tbody>'
            + '\n'.join(line(cells, 'td') for cells in body) + '</tbody></table></div>')


def charts(figures: list[Chart]) -> str:
    """Return figures side by side; report.js draws them from their data."""
    return '<div class="charts">' + '\n'.join(
        f'<figure{" class=wide" if chart.wide else ""}>'
        f'<figcaption>{escape(chart.title)}</figcaption>'
        f'<div class="chart" style="height:{chart.figure.layout.height}px"></div>'
        f'<script type="application/json">{chart.figure.to_json()}</script></figure>'
        for chart in figures) + '</div>'
