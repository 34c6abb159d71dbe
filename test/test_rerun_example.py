# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The loader for Rerun: what it logs is what the recording says, at the stamps of the frames."""

from collections import defaultdict
from importlib.util import module_from_spec, spec_from_file_location
import os
import subprocess
import sys

import numpy as np
import pytest

rerun_chunk = pytest.importorskip('rerun.chunk')

from estimated import record_results  # noqa: E402
from instruments import TAN2018, TOP  # noqa: E402
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT  # noqa: E402
from starcal_ros.live.display import ENLARGED  # noqa: E402
from starcal_ros.live.recorded import moments  # noqa: E402

SCENARIO = TAN2018.replace({'simulation.duration_s': 20.0})
PATIENCE_S = 100.0


def load(*words):
    """Run the loader, without anything that asks the network."""
    return subprocess.run(
        [sys.executable, TOP / 'examples' / 'rerun_recording.py', *map(str, words)], text=True,
        capture_output=True, timeout=PATIENCE_S, env={**os.environ, 'RERUN_ANALYTICS': 'false'})


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """Return the moments of a recording, and what was logged: {entity: {stamp: {name: value}}}."""
    folder = tmp_path_factory.mktemp('rerun')
    record_results(folder / 'run.mcap', SCENARIO)
    done = load(folder / 'run.mcap', '--save', folder / 'run.rrd')
    assert (done.returncode, done.stdout) == (0, f'20 s of {folder / "run.mcap"}\n'), done.stderr
    logged = defaultdict(dict)
    for chunk in rerun_chunk.RrdReader(folder / 'run.rrd').stream():
        batch = chunk.to_record_batch()
        if 'stamp' in batch.schema.names:
            stamps = batch.column('stamp').to_numpy(zero_copy_only=False).astype(np.int64)
            for name in batch.schema.names:
                if ':' in name:
                    for stamp_ns, value in zip(stamps.tolist(), batch.column(name).to_pylist()):
                        logged[chunk.entity_path].setdefault(stamp_ns, {})[name] = value
    return list(moments(folder / 'run.mcap')), logged


def test_stars_and_residuals_of_each_frame_are_there(run):
    found, logged = run
    for moment in found:
        stars = moment.seen.stars
        drawn = logged['/camera/stars'][moment.stamp_ns]['Points2D:positions']
        np.testing.assert_allclose(
            drawn, np.column_stack((stars['u'], stars['v'])) + 0.5, rtol=1e-6)
        lines = logged['/camera/residuals'][moment.stamp_ns]['Arrows2D:vectors']
        np.testing.assert_allclose(
            lines, ENLARGED * np.column_stack((stars['du'], stars['dv'])), rtol=1e-5, atol=1e-5)
    assert len(logged['/camera/stars']) == len(found) == 40


def test_sigmas_are_logarithms_over_the_tolerances(run):
    found, logged = run
    for name in STATE_NAMES[CALIBRATED]:
        k = STATE_NAMES.index(name)
        series = logged[f'/sigma_over_tolerance/{name}']
        assert len(series) == 40
        for moment in (found[0], found[-1]):
            ratio = moment.seen.sigma[k] / UNIT[k] / moment.seen.tolerances()[k]
            assert series[moment.stamp_ns]['Scalars:scalars'] == [
                pytest.approx(np.log10(ratio))]


def test_the_verdict_is_there_at_each_frame_and_where_it_changed(run):
    found, logged = run
    for moment in found:
        assert logged['/verdict/now'][moment.stamp_ns]['TextDocument:text'] == [
            moment.seen.message]
        assert logged['/verdict/number'][moment.stamp_ns]['Scalars:scalars'] == [1.0]
    changes = logged['/verdict/changes']
    heads = [each.seen.message.partition(';')[0] for each in found]
    assert len(changes) == 1 + sum(a != b for a, b in zip(heads, heads[1:]))


def test_charts_begin_with_the_whole_recording():
    """Rerun would begin with the half minute about the first stamp."""
    spec = spec_from_file_location('rerun_recording', TOP / 'examples' / 'rerun_recording.py')
    loader = module_from_spec(spec)
    spec.loader.exec_module(loader)
    charts = [view for view in loader.blueprint(10, 20).root_container.contents[1].contents
              if view.class_identifier == 'TimeSeries']
    assert len(charts) == 2
    for chart in charts:
        view, = chart.properties['TimeAxis'].view_range.as_arrow_array().to_pylist()
        assert view == {'start': 10, 'end': 20}


def test_what_can_not_be_shown_is_said_in_a_line(tmp_path):
    done = load(tmp_path / 'missing.mcap', '--save', tmp_path / 'run.rrd')
    assert done.returncode == 2 and 'Traceback' not in done.stderr
    assert done.stderr.splitlines()[-1].startswith('error: ') and 'missing.mcap' in done.stderr
    assert not (tmp_path / 'run.rrd').exists()
