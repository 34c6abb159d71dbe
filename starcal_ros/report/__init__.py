# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a person reads of a calibration.

`states` has the table of the calibrated states, `cameras` those of a camera alone,
`montecarlo_table` that of a Monte Carlo, `reproduction_table` what a paper has beside ours,
`explanations` what would explain data that contradict the model, `convergence` the figure as PNG,
`allan` the noise of a gyro.

A page is made of sections (`markup`): `page` is that of a calibration, with `page_tables` and
`page_charts`, `still_images_page` that of still images. `time_charts` are charts over time,
`statistic_charts` those of the tests of the innovations, `detector_charts` those over the
detector, `projection_charts`, `coverage_charts`, `residual_charts` what they are called.
`write` makes HTML of a page, with charts that zoom or with pictures (`still_chart`), or PDF.
"""

from starcal_ros.report.cameras import camera, chain, still_images, verdict_lines
from starcal_ros.report.convergence import figure
from starcal_ros.report.explanations import explanations_table
from starcal_ros.report.montecarlo_table import study
from starcal_ros.report.reproduction_table import draw, published
from starcal_ros.report.states import rows, summary, symbols, table

__all__ = ['camera', 'chain', 'draw', 'explanations_table', 'figure', 'published', 'rows',
           'still_images', 'study', 'summary', 'symbols', 'table', 'verdict_lines']
