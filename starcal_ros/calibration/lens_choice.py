# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which lens model fits stars best, by cross-validation.

Each model is fitted to four parts of five and predicts the fifth: images where there are enough of
them, else stars; the attitudes of what is predicted are fitted, the camera is held. A star counts
by its squared residual, up to the gate of the best model, so that wrong stars, and those that a
model can not explain at all, count alike for all. A model whose very fit is twice as bad as the
best is not asked for predictions: its fit stands for them.

A model of more parameters has to be better beyond the standard error of its advantage, star by
star (the rule of one standard error; Hastie, Tibshirani and Friedman, *The Elements of Statistical
Learning*, Sec. 7.10): of those as good as the best, the one of fewest parameters is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.calibration import lens_bundle
from starcal_ros.calibration.bundle_adjustment import Adjusted, adjust
from starcal_ros.calibration.bundle_problem import MIN_STARS, Observations
from starcal_ros.calibration.bundle_start import attitudes
from starcal_ros.calibration.lens_bundle import LensStart
from starcal_ros.core import robust
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.lenses.fisheye import EquidistantLens, KannalaBrandtLens
from starcal_ros.core.statistic import Statistic

FOLDS, STARS = 5, 1500
"""Parts, and stars that are looked at, at most."""
OTHERS = 'prediction against that of the best lens model'

_STANDARD_ERRORS = 1.0
_HOPELESS = 2.0         # RMS over that of the best, from which a fit is not cross-validated
_MARGIN = 1.1           # of the RMS, by which another model may predict better
_UNHEARD = partial(np.errstate, all='ignore')     # a lens that can not fit may run away
_FISHEYES = (EquidistantLens.name, KannalaBrandtLens.name)


class LensScore(NamedTuple):
    """How well a lens model does.

    Attributes
    ----------
    name : str
    free : int
        Parameters that are estimated.
    rms_px : float
        RMS residual of an axis, of the stars inside the gate, fitted to all [px].
    refused : float
        Share of the stars outside the gate.
    predicted_px : float
        RMS of an axis where stars are predicted, each counted up to the gate of the best [px].
    """

    name: str
    free: int
    rms_px: float
    refused: float
    predicted_px: float

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {'lens': self.name, 'parameters': self.free, 'rms_px': self.rms_px,
                'refused': self.refused, 'predicted_rms_px': self.predicted_px}


class LensChoice(NamedTuple):
    """The lens models in the order of their predictions, the best first, and the one to take."""

    scores: tuple[LensScore, ...]
    chosen: LensScore

    def of(self, name: str) -> LensScore | None:
        """Return the score of a lens model; None where it fits nothing."""
        return next((each for each in self.scores if each.name == name), None)

    def test(self, name: str) -> Statistic:
        """Return how much worse than the chosen lens model another predicts, RMS over RMS."""
        own, best = self.of(name), self.chosen
        ratio = own.predicted_px / max(best.predicted_px, 1e-9) if own else np.inf
        return Statistic(OTHERS, float(max(ratio, 1.0)), 0.0, _MARGIN, len(self.scores),
                         fits='' if best.name == name else best.name)

    def sentence(self, name: str, refused: float, rms_px: float) -> str:
        """Return what this says of a calibration with a lens model.

        Parameters
        ----------
        name : str
            The lens model.
        refused : float
            Share of the stars outside the gate.
        rms_px : float
            RMS residual of an axis, of the others [px].
        """
        best, own = self.chosen, self.of(name)
        left = (f'{refused:.0%} of the stars refused' if refused >= 0.005 else
                f'RMS {rms_px:.2g} px')
        if best.name != name and own and self.test(name).passed:     # what fails may be name's own
            return (f'{left}: no lens model predicts much better than {name}; {best.name} does '
                    f'about as well, RMS {best.predicted_px:.3g} px against '
                    f'{own.predicted_px:.3g} px (--lens {best.name})')
        if self.test(name).passed:
            return f'{left}: no lens model fits, none predicts much better than {name}'
        said = f'{name} is not what this lens does'
        if (name in _FISHEYES) != (best.name in _FISHEYES):
            said = f'this is no {"fisheye" if name in _FISHEYES else "pinhole"}'
        return (f'{left}: {said}; {best.name} fits with RMS {best.rms_px:.2g} px '
                f'(--lens {best.name})')


def choose(spots: Observations, starts: Sequence[LensStart], gate: float) -> LensChoice | None:
    """Compare lens models; None where none can be fitted.

    Parameters
    ----------
    spots : Observations
        Of known direction.
    starts : sequence of LensStart
        The models, and where each begins.
    gate : float
        As for `bundle_adjustment.adjust`.
    """
    if len(spots.frame) > STARS:
        rows = np.linspace(0, len(spots.frame) - 1, STARS).astype(int)
        spots = _part(spots, _enough(spots, np.isin(np.arange(len(spots.frame)), rows)))
    fold = _folds(spots.frame)
    tried: list[tuple[LensStart, Adjusted]] = []
    for start in starts:
        with suppress(np.linalg.LinAlgError), _UNHEARD():
            tried.append((start, lens_bundle.fit(spots, start, gate)))
    if not tried:
        return None
    lengths = [np.linalg.norm(fitted.residual, axis=-1) for _, fitted in tried]
    scale = max(min(robust.scale_of(length / spots.sigma) for length in lengths), 1e-9)
    limit = gate * (scale * spots.sigma)**2
    fits = [float(np.minimum(length**2, limit).mean()) for length in lengths]
    for k, (start, fitted) in enumerate(tried):
        if fits[k] <= _HOPELESS**2 * min(fits):
            with suppress(np.linalg.LinAlgError), _UNHEARD():
                lengths[k] = _predicted(spots, fold, start, fitted, gate)
    usable = np.logical_and.reduce([np.isfinite(length) for length in lengths])
    if not usable.any():
        return None
    squares = [np.minimum(length**2, limit)[usable] for length in lengths]
    scores = [_score(*each, spots, float(np.sqrt(0.5 * square.mean())))
              for each, square in zip(tried, squares)]
    order = sorted(range(len(scores)), key=lambda k: scores[k].predicted_px)
    best = squares[order[0]]

    def as_good(k: int) -> bool:
        worse = squares[k] - best
        error = float(worse.std()) / np.sqrt(len(worse))
        return bool(worse.mean() <= _STANDARD_ERRORS * error)

    chosen = min((k for k in order if as_good(k)), key=lambda k: scores[k].free)
    return LensChoice(tuple(scores[k] for k in order), scores[chosen])


def _score(start: LensStart, fitted: Adjusted, spots: Observations, predicted_px: float
           ) -> LensScore:
    rms_px = float(np.sqrt(np.mean(fitted.residual[fitted.used]**2)))
    return LensScore(start.lens.name, start.free, rms_px, float(np.mean(~fitted.used)),
                     predicted_px)


def _folds(frame: Ints) -> Ints:
    """Return the fold of each star: that of its image, or of its own where images are few."""
    number = np.unique(frame, return_inverse=True)[1]
    if number.max() + 1 >= FOLDS:
        return np.asarray(number % FOLDS)
    # stars of a table are often in some order: chance breaks it, the same for all models
    return np.random.default_rng(len(frame)).permutation(len(frame)) % FOLDS


def _predicted(spots: Observations, fold: Ints, start: LensStart, fitted: Adjusted, gate: float
               ) -> Array:
    """Return the length of the residual of each star, predicted by others [px].

    The fit to all is where that to the others begins, which no minimum remembers. NaN where an
    image has too few stars of a fold.
    """
    length = np.full(len(spots.frame), np.nan)
    for k in range(FOLDS):
        rest, mine = (_enough(spots, part) for part in (fold != k, fold == k))
        if not rest.any() or not mine.any():
            continue
        C_si = fitted.C_si[np.unique(spots.frame[rest])]
        camera = lens_bundle.finish(_part(spots, rest), fitted.intrinsics, C_si, start,
                                    gate).intrinsics
        seen = _part(spots, mine)
        C_si = attitudes(seen, start.lens.unproject(seen.uv, camera))
        held = adjust(seen, camera, C_si, np.empty((0, 3)), start.lens,
                      np.zeros((len(camera),) * 2), gate, start.own_f_sigma)
        length[mine] = np.linalg.norm(held.residual, axis=-1)
    return length


def _enough(spots: Observations, part: Mask) -> Mask:
    """Leave out images of which too few stars are in a part for an attitude and a residual."""
    count = np.bincount(spots.frame, part)
    return np.asarray(part & (count[spots.frame] > MIN_STARS))


def _part(spots: Observations, part: Mask) -> Observations:
    return Observations(np.unique(spots.frame[part], return_inverse=True)[1], spots.uv[part],
                        spots.sigma[part], spots.u_i[part], spots.point[part])
