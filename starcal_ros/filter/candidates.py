# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Extensions of the model that a user could add, and which of them failing tests point to.

A candidate is a set of parameters: an optional state, random walks of some states, other noise
levels. The bank of `hypotheses` has followed already what each effect alone would explain: one
that explains less than `_POINTS` of what the best does points nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.statistic import Statistic
from starcal_ros.filter.hypotheses import (CHANGING, HYPOTHESES, MISALIGNMENTS, PHASE_U, PHASE_V,
                                           SCALE_FACTORS, TIME)
from starcal_ros.filter.innovation_tests import NOISE_TESTS
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.noise_levels import CENTROIDS, GYRO

_WALK, ADAPT = 'estimator.process_noise.', 'estimator.adapt'
_TIME_S, _MATRIX_PPM = 0.01, 500.0      # initial sigmas, at least
_PHASE_PX = 0.1         # initial sigma: a pixel has no larger error of that kind
_WIDE = 3.0                             # sigma over the size that the bank has found
_POINTS = 0.25                          # of the best gain of the bank, for one to point
_TURNS = ('mean of the turns', 'turns along the rate')


class Candidate(NamedTuple):
    """An extension that may be tried.

    Attributes
    ----------
    name : str
        What it is called.
    values : mapping
        Parameters to add.
    numbers : int
        Numbers that it adds to the model.
    sought : tuple of str
        Parameters among them, or noise levels, whose value the data are to tell.
    """

    name: str
    values: Mapping[str, Any]
    numbers: int
    sought: tuple[str, ...] = ()

    @property
    def is_cause(self) -> bool:
        """Whether it says what happens, and not only how much is unexplained."""
        return not self.sought


def pointed(statistics: Sequence[Statistic], scenario: Scenario, tests: ModelTests
            ) -> Iterator[Candidate]:
    """Yield the extensions that the failing tests may mean and that are not yet there."""
    failed = [each for each in statistics if not each.passed]
    most = max((each.gain for each in failed), default=0.0)
    failing = {each.name for each in failed if not 0.0 < each.gain < _POINTS * most}
    names = [each.name for each in HYPOTHESES]
    augment = scenario.estimator.augment

    def points(*to: str) -> bool:
        return bool(failing & set(to))

    if augment.time_offset_sigma_s is None and points(names[TIME], *_TURNS):
        sigma_s = max(_TIME_S, _WIDE * 1e-3 * tests.size(TIME))
        yield Candidate('time offset of the star tracker', {
            'estimator.augment.time_offset_sigma_s': min(rounded(sigma_s), 1.0)}, 1)
    if augment.gyro_matrix_sigma_ppm is None and points(
            names[SCALE_FACTORS], names[MISALIGNMENTS], *_TURNS):
        sigma_ppm = max(_MATRIX_PPM, _WIDE * max(tests.size(SCALE_FACTORS),
                                                 tests.size(MISALIGNMENTS)))
        yield Candidate('scale factors and misalignments of the gyros', {
            'estimator.augment.gyro_matrix_sigma_ppm': min(rounded(sigma_ppm), 1e4)}, 9)
    if augment.pixel_phase_sigma_px is None and points(names[PHASE_U], names[PHASE_V]):
        yield Candidate('pixel phase', {'estimator.augment.pixel_phase_sigma_px': _PHASE_PX}, 4)
    for name, key, to in (
            ('random walk of the gyro bias', 'gyro_bias_deg_h_sqrt_h', CHANGING[:1]),
            ('random walk of the fixed angles', 'fixed_angles_arcsec_sqrt_h', CHANGING[1:3]),
            ('random walk of the focal length', 'focal_length_mm_sqrt_h', CHANGING[3:]),
            ('random walk of the principal point', 'principal_point_px_sqrt_h', CHANGING[3:])):
        if points(*(f'{kind} of the {each}' for each in to for kind in ('drift', 'step')),
                  *(_TURNS if to == CHANGING[:1] else ())):
            yield Candidate(name, {}, 1, (_WALK + key,))
    of_stars = any(name.endswith('rest') for name in failing & set(NOISE_TESTS))
    of_turns = any('turn' in name for name in failing & set(NOISE_TESTS))
    noises: tuple[tuple[str, bool, tuple[str, ...]], ...] = (
        ('other noise of the centroids', of_stars, (CENTROIDS,)),
        ('other noise of the gyros', of_turns, (GYRO,)),
        ('other noise of centroids and gyros', of_stars and of_turns, (CENTROIDS, GYRO)))
    for name, points_there, keys in noises:
        if points_there and not set(keys) & set(scenario.estimator.adapt):
            yield Candidate(name, {ADAPT: (*scenario.estimator.adapt, *keys)},
                            len(keys), keys)


def rounded(value: float) -> float:
    """Return a number to two digits: what is put into a parameter file."""
    return float(f'{value:.2g}')
