# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""W19 Table 2: the star combination models, {sigma2, sigma3}, 19 stars a frame, 0.5 px."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from starcal_ros.calibration.methods import singular_value
from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.wu2019 import GROUPS, TRUTH
from starcal_ros.reproduction.wu2019_study import HEAD, PARAMETERS, Row, Study, notes, rows

RUNS = 40
CHOSEN = (2, 3)
PAPER = {
    1: (-0.0032, 0.0044, -2.6354, 0.9508, -0.4379, -47.4027, 0.852, 0.029),
    2: (0.0005, 0.0044, 0.1126, -0.1315, 1.1205, 32.7026, 1.106, 0.060),
    3: (-0.0012, 0.0050, -0.0599, 0.0940, 0.8043, 15.7377, 4.392, 0.022),
    4: (0.0024, 0.0044, -0.2159, -0.6011, 1.0729, 25.0508, 0.465, 0.038),
}
QUANTITIES = (*PARAMETERS, 'A', 'A over frames', 'A over runs', 'NEES')
MODELS = (
    'Which model is best is a matter of the weighting and of the numbering of the stars. Numbered '
    'at random Model 1 is the best of the published weighting, from the middle outwards Models 1 '
    'and 4 are; with the full weighting Models 3 and 4 reach the bound whatever the numbering.',
    'Model 3 is read as all stars but one, N groups. Read as two groups, 1 to N - 1 and 2 to N, '
    'it has A = 0.6" published and 0.5" full: neither reading gives the 4.4" of the paper.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run each model with both weightings."""
    study = Study(scenario, GROUPS['group2'], runs)
    bound = study.bound()
    table: tuple[Row, ...] = ()
    for model, paper in PAPER.items():
        published, full = (
            study.run(partial(singular_value.measure, model=model, chosen=CHOSEN,
                              full=weighting)).quantities() for weighting in (False, True))
        table += rows(f'Model {model}', QUANTITIES, dict(zip(QUANTITIES, paper)), published, full,
                      bound)
        on_progress(model / len(PAPER))
    own = study.criterion_A(np.array([TRUTH * (1.0 + 0.01 * np.array(paper[:len(PARAMETERS)]))
                                      for paper in PAPER.values()])).mean(axis=-1)
    disagree = ('The table of the paper does not agree with itself: its errors of the parameters '
                f'give A = {", ".join(f"{A:.2f}" for A in own)}" in Models 1 to 4.')
    return Outcome(f'W19 Table 2, {runs} runs, {study.stars:.1f} stars a frame', HEAD, table,
                   (*notes(runs), *MODELS, disagree))
