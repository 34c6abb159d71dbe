# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: one page."""

from __future__ import annotations

from starcal_ros.report import page_charts, page_tables
from starcal_ros.report.calibration import Calibration, called, facts
from starcal_ros.report.markup import Page

_SECTIONS = (
    page_tables.verdict, page_tables.states, page_tables.change, page_tables.noise,
    page_tables.tried, page_tables.steps, page_charts.convergence, page_charts.projection,
    page_charts.coverage, page_charts.residuals, page_charts.consistency, page_charts.distortion,
    page_charts.coupling, page_tables.counts, page_tables.provenance)


def page(calibration: Calibration) -> Page:
    """Return the report of a calibration."""
    title = f'Calibration of {called(calibration.outcome["provenance"]["bag"])}'
    return Page(title, tuple(facts(calibration)), tuple(
        each for section in _SECTIONS for each in section(calibration)))
