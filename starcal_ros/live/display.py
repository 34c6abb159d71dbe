# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What was heard of an estimator as messages that the panels of others draw and plot.

`markers` are for RViz and 3D panels: the detector as a plane one metre before the lens, in the
frame of the calibrated camera, so that it lies on the image of that camera. `image_annotations`
are for the image panel of Foxglove and Lichtblick, `values`, numbers at fixed places, for plots.

Residuals are drawn `ENLARGED` times their length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Array
from starcal_ros.core.verdict_words import CONVERGED, INCONSISTENT, LOST, NOT_YET
from starcal_ros.filter.advice import advised_axis
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.live import facts
from starcal_ros.live.heard import Seen
from starcal_ros.messages import topics
from starcal_ros.messages.conventions import CALIBRATED_FRAME
from starcal_ros.messages.drawings import LINE_LIST, LINE_STRIP, SPHERE_LIST, TEXT, Drawings, Rgb

ENLARGED = 500.0
VERDICTS = '', NOT_YET, CONVERGED, INCONSISTENT, LOST
"""The verdict of `values` is the place of its word here; 0 is none yet."""

_NAMES = STATE_NAMES[CALIBRATED]
LAYOUT = (('stamp_s', 1), ('verdict', 1), ('time_to_go_s', 1), ('axis_to_rotate_about', 1),
          ('failing_tests', 1), ('stars_used', 1), ('stars_rejected', 1),
          ('reprojection_rms_u_px reprojection_rms_v_px', 2),
          *((f'{what} {" ".join(_NAMES)}', len(_NAMES))
            for what in ('sigma', 'tolerance', 'sigma_over_tolerance')))
"""Labels and sizes of the parts of `values`, in units of the diagnostics, NaN where not known.

The axis is 1, 2, 3 for X, Y, Z of the gyro, negative the other way round, 0 for none."""

_USED, _LARGER, _ODD, _REJECTED = (
    (0.35, 0.76, 0.47), (0.42, 0.70, 0.96), (0.94, 0.65, 0.29), (1.0, 0.48, 0.45))
_DIM = 0.6, 0.64, 0.69
_STAR, _LINE = 0.006, 0.0015            # sizes on the plane, in focal lengths
_CIRCLE_PX, _STROKE_PX, _TEXT_PX = 14.0, 2.0, 18.0


def markers(drawings: Drawings, seen: Seen) -> Any:
    """Return visualization_msgs/MarkerArray; without camera or stars it is empty."""
    made = []
    if seen.stars is not None and seen.pinhole is not None and seen.size is not None:
        stars, (f, cu, cv) = seen.stars, seen.pinhole
        width, height = seen.size

        def on_plane(uv: Array) -> Array:
            return np.column_stack(((uv - (cu, cv)) / f, np.ones(len(uv))))

        edge = np.array([[u, v] for u, v in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))], np.float64)
        begin, end = _lines(stars)
        colors = _colors(stars)
        both = np.repeat(np.arange(len(stars)), 2)
        rows = [('detector', LINE_STRIP, edge * (width, height) - 0.5, [_DIM] * 5, _LINE, ''),
                ('stars', SPHERE_LIST, begin, colors, _STAR, ''),
                ('residuals', LINE_LIST, np.stack((begin, end), axis=1).reshape(-1, 2),
                 [colors[k] for k in both], _LINE, ''),
                ('scale', TEXT, np.array([[0.5 * width, 1.05 * height]]), [_DIM],
                 6.0 * _STAR, f'residuals × {ENLARGED:.0f}')]
        made = [drawings.marker(seen.stars_ns, CALIBRATED_FRAME, name, kind, on_plane(uv), colours,
                                size, text) for name, kind, uv, colours, size, text in rows]
    return drawings.marker_array(made)


def image_annotations(drawings: Drawings, seen: Seen) -> Any:
    """Return foxglove_msgs/ImageAnnotations; without stars it is empty."""
    circles, lines, texts = [], [], []
    if seen.stars is not None:
        begin, end = _lines(seen.stars)
        colors = _colors(seen.stars)
        circles = [drawings.circle(seen.stars_ns, uv, _CIRCLE_PX, _STROKE_PX, color)
                   for uv, color in zip(begin, colors)]
        lines = [drawings.line_list(seen.stars_ns, np.stack((begin, end), axis=1).reshape(-1, 2),
                                    _STROKE_PX, colors)]
        texts = [drawings.text(seen.stars_ns, np.array([_TEXT_PX, 1.5 * _TEXT_PX]),
                               f'{seen.message.partition(":")[0]}; residuals × {ENLARGED:.0f}',
                               _TEXT_PX, _DIM)]
    return drawings.image_annotations(circles, lines, texts)


def values(drawings: Drawings, seen: Seen) -> Any:
    """Return std_msgs/Float64MultiArray, laid out as LAYOUT says."""
    return drawings.labelled(LAYOUT, numbers(seen))


def numbers(seen: Seen) -> Array:
    """Return the data of `values`."""
    word = seen.values.get('verdict', '')
    axis = advised_axis(facts.advice(seen))
    turn = 0.0 if not axis else ('XYZ'.index(axis[-1]) + 1.0) * (-1.0 if axis[0] == '-' else 1.0)
    used = rejected = np.nan
    if seen.stars is not None:
        used = float(np.count_nonzero(seen.stars['accepted']))
        rejected = len(seen.stars) - used
    stamp_s, sigma = np.nan, np.full(len(_NAMES), np.nan)
    if seen.state is not None:
        stamp_s = seen.state[0]
        sigma = seen.sigma[CALIBRATED] / UNIT[CALIBRATED]
    tolerance = np.array(seen.tolerances())[CALIBRATED]
    rms = facts.reprojection_px(seen)
    return np.concatenate((
        [stamp_s, float(VERDICTS.index(word) if word in VERDICTS else 0),
         facts.remaining_s(seen), turn,
         float(sum(not test.passed for test in facts.tests(seen))), used, rejected],
        np.full(2, np.nan) if rms is None else rms, sigma, tolerance, sigma / tolerance))


def _lines(stars: NDArray[np.void]) -> tuple[Array, Array]:
    """Return where the lines of residuals begin, at the stars, and end, (n, 2) each [px]."""
    begin = np.column_stack((stars['u'], stars['v'])).astype(np.float64)
    return begin, begin + ENLARGED * np.column_stack((stars['du'], stars['dv']))


def _colors(stars: NDArray[np.void]) -> list[Rgb]:
    """Return the colour of each star: by whether it was used, and how odd its residual is."""
    how = np.searchsorted([facts.USUAL, facts.RARE], stars['nis'])
    return [(_USED, _LARGER, _ODD)[k] if used else _REJECTED
            for k, used in zip(how.tolist(), stars['accepted'].tolist())]


DRAWN: Mapping[topics.Topic, Callable[[Drawings, Seen], Any]] = {
    topics.MARKERS: markers, topics.ANNOTATIONS: image_annotations, topics.VALUES: values}
"""What there is to draw, by its topic."""
