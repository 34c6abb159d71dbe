#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Show a recording of the estimator in Rerun: stars, residuals, sigmas and verdict over time.

    pip install 'starcal_ros[rerun]'
    python examples/rerun_recording.py run.mcap                 # opens the viewer
    python examples/rerun_recording.py run.mcap --save run.rrd  # for `rerun run.rrd`

The timeline `stamp` is the stamps of the frames, UTC. Rerun's own reader of MCAP can show the rest
of the recording beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from starcal_ros.core.units import NS
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.live import facts
from starcal_ros.live.display import ENLARGED, VERDICTS
from starcal_ros.live.heard import Seen
from starcal_ros.live.recorded import Moment, moments
from starcal_ros.messages.cdr import RecordError

MOST = 5000             # moments that are shown
CORNER = 0.5            # Rerun counts pixels from the corner of the first, not from its centre
TIMELINE = 'stamp'
COLORS = np.array([[55, 160, 85], [60, 130, 220], [220, 140, 40], [220, 60, 60]], np.uint8)
LEVELS = {'': 'INFO', 'not yet': 'INFO', 'converged': 'INFO', 'inconsistent': 'ERROR',
          'lost': 'ERROR'}


def blueprint(first_ns: int, last_ns: int) -> rrb.Blueprint:
    """Return how the viewer is laid out: charts over the whole recording, from one stamp on."""
    whole = rrb.TimeAxis(view_range=rrb.TimeRange(
        rrb.TimeRangeBoundary.absolute(nanos=first_ns),
        rrb.TimeRangeBoundary.absolute(nanos=last_ns)))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin='camera', name='Stars and residuals'),
                rrb.TextDocumentView(origin='verdict/now', name='Verdict'),
                row_shares=[3, 1]),
            rrb.Vertical(
                rrb.TimeSeriesView(origin='sigma_over_tolerance', axis_x=whole,
                                   name='Sigma over tolerance, log10: done below 0'),
                rrb.TimeSeriesView(origin='residuals_px', axis_x=whole,
                                   name='RMS of the residuals [px]'),
                rrb.TextLogView(origin='verdict/changes', name='What changed'),
                row_shares=[3, 1, 1]),
            column_shares=[2, 3]),
        rrb.TimePanel(state='collapsed'), rrb.SelectionPanel(state='collapsed'))


def show_stars(seen: Seen) -> None:
    """Log the stars of a frame, and their residuals enlarged."""
    stars = seen.stars
    if stars is None or seen.size is None or seen.pinhole is None:
        return
    f, cu, cv = seen.pinhole
    rr.log('camera', rr.Pinhole(resolution=seen.size, focal_length=f,
                                principal_point=(cu + CORNER, cv + CORNER)))
    begin = np.column_stack((stars['u'], stars['v'])) + CORNER
    residual = np.column_stack((stars['du'], stars['dv']))
    used = stars['accepted'].astype(bool)
    how = np.where(used, np.searchsorted([facts.USUAL, facts.RARE], stars['nis']), 3)
    rr.log('camera/stars', rr.Points2D(begin, colors=COLORS[how], radii=4.0))
    rr.log('camera/residuals', rr.Arrows2D(origins=begin, vectors=ENLARGED * residual,
                                           colors=COLORS[how]))
    if used.any():
        for axis, rms in zip('uv', np.sqrt(np.mean(residual[used]**2, axis=0))):
            rr.log(f'residuals_px/{axis}', rr.Scalars(float(rms)))


def show_sigmas(seen: Seen) -> None:
    """Log each sigma over its tolerance, by its logarithm."""
    if seen.state is None:
        return
    sigma = seen.sigma[CALIBRATED] / UNIT[CALIBRATED]
    for name, each, tolerance in zip(STATE_NAMES[CALIBRATED], sigma,
                                     seen.tolerances()[CALIBRATED]):
        if each > 0.0 and tolerance > 0.0:
            rr.log(f'sigma_over_tolerance/{name}', rr.Scalars(float(np.log10(each / tolerance))))


def show_verdict(seen: Seen, before: str) -> str:
    """Log the verdict, and that it is another than the one before; return it."""
    said, word = seen.message or 'none yet', seen.values.get('verdict', '')
    rr.log('verdict/now', rr.TextDocument(said))
    rr.log('verdict/number', rr.Scalars(float(VERDICTS.index(word) if word in VERDICTS else 0)))
    head = said.partition(';')[0]
    if head != before:
        rr.log('verdict/changes', rr.TextLog(said, level=LEVELS.get(word, 'WARN')))
    return head


def show(moment: Moment, before: str) -> str:
    """Log a moment; return the beginning of its verdict."""
    rr.set_time(TIMELINE, timestamp=np.datetime64(moment.stamp_ns, 'ns'))
    show_stars(moment.seen)
    show_sigmas(moment.seen)
    return show_verdict(moment.seen, before)


def main() -> int:
    """Read the command line and log the recording."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('bag', type=Path, help='recording with the results of an estimator')
    parser.add_argument('--save', metavar='FILE', help='write an .rrd file, open no viewer')
    parser.add_argument('--namespace', metavar='NS', help='namespace of the estimator')
    options = parser.parse_args()
    try:
        found = list(moments(options.bag, options.namespace, most=MOST))
    except RecordError as error:
        print(f'error: {error}', file=sys.stderr)
        return 2
    rr.init('starcal', spawn=not options.save)
    layout = blueprint(found[0].stamp_ns, found[-1].stamp_ns)
    if options.save:
        rr.save(options.save, default_blueprint=layout)
    else:
        rr.send_blueprint(layout)
    before = ''
    for moment in found:
        before = show(moment, before)
    print(f'{(found[-1].stamp_ns - found[0].stamp_ns) * NS:.0f} s of {options.bag}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
