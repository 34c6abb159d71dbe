# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reports as files: a page of HTML, a light one, or PDF.

PDF is made of the light page by WeasyPrint, which needs no browser: it breaks pages where the
page's own style lets it, numbers them and fills the table of contents in.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.output import whole, write_text
from starcal_ros.report.markup import Page, document

KINDS = ('.html', '.htm', '.pdf')
"""Endings of reports."""


def check(reports: Sequence[str | Path]) -> None:
    """See to it that reports can be made.

    Raises
    ------
    ConfigError
        For an ending that is none of KINDS, or where what makes PDF is missing.
    """
    for path in map(Path, reports):
        if path.suffix and path.suffix.lower() not in KINDS:
            raise ConfigError(f'{path}: a report ends in .html or .pdf')
        if is_pdf(path):
            try:
                import weasyprint  # noqa: F401
            except (ImportError, OSError) as error:
                what = ('pip install starcal_ros[pdf]' if isinstance(error, ImportError) else
                        'apt-get install libpango-1.0-0 libpangoft2-1.0-0')
                raise ConfigError(f'{path}: PDF needs WeasyPrint, which can not be loaded: '
                                  f'{what}') from None


def is_pdf(path: str | Path) -> bool:
    """Tell whether a report is to be PDF."""
    return Path(path).suffix.lower() == '.pdf'


def write(page: Page, reports: Sequence[str | Path], light: str | Path | None = None) -> None:
    """Write a page as it is asked for.

    Parameters
    ----------
    page : Page
    reports : sequence of path
        Of HTML with charts that zoom, or of PDF, by their endings.
    light : path, optional
        HTML without any script.
    """
    for path in reports:
        if is_pdf(path):
            _write_pdf(page, path)
        else:
            write_text(path, document(page))
    if light is not None:
        write_text(light, document(page, light=True))


def _write_pdf(page: Page, path: str | Path) -> None:
    import weasyprint
    text = document(page, printed=True)
    with whole(path) as draft, draft.open('wb') as stream:
        weasyprint.HTML(string=text).write_pdf(stream)
