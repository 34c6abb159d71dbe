# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a command and a node import, which is most of the time that they take to start.

How long it takes is measured by bench/start.py, and asserted nowhere.
"""

import ast
import subprocess
import sys

import pytest

from instruments import TAN2018, TOP
from starcal_ros.cli import COMMANDS
from starcal_ros.simulation.write_recording import simulate

RUN = """
import sys
before = set(sys.modules)
from starcal_ros.cli import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(sorted(set(sys.modules) - before), file=sys.stderr)
"""
IMPORT = """
import sys
before = set(sys.modules)
for name in sys.argv[1:]:
    __import__(name)
print(sorted(set(sys.modules) - before), file=sys.stderr)
"""


def imported(script, *words):
    """Return what a process of its own imports."""
    done = subprocess.run([sys.executable, '-c', script, *words], text=True, capture_output=True,
                          check=True, env={'PYTHONPATH': str(TOP)})
    return ast.literal_eval(done.stderr.splitlines()[-1])


def libraries(modules):
    """Return the libraries of others among modules."""
    return {name.partition('.')[0] for name in modules
            if not name.startswith('_')} - {
                'starcal_ros', 'cython_runtime', *sys.stdlib_module_names}


def test_the_help_imports_no_library_and_no_command():
    modules = imported(RUN, '--help')
    assert not libraries(modules)
    assert [name for name in modules if name.startswith('starcal_ros')] == [
        'starcal_ros', 'starcal_ros.cli']


def test_a_command_seldom_looks_for_garbage():
    script = ("import gc; from starcal_ros.cli import main; main(['config', 'schema']); "
              'print(gc.get_threshold()[0])')
    done = subprocess.run([sys.executable, '-c', script], text=True, capture_output=True,
                          check=True, env={'PYTHONPATH': str(TOP)})
    assert int(done.stdout.split()[-1]) >= 10_000


def test_each_command_is_imported_alone():
    modules = imported(RUN, 'watch', '--help')
    assert not libraries(modules)
    assert {name.rpartition('.')[2] for name in modules} & COMMANDS.keys() == {'watch'}


def test_info_imports_what_reads_recordings(tmp_path):
    path = tmp_path / 'run.mcap'
    simulate(TAN2018.replace({'simulation.duration_s': 20.0}), path)
    assert libraries(imported(RUN, 'info', str(path))) == {
        'lz4', 'mcap', 'numpy', 'rich', 'zstandard'}


def test_images_do_without_the_filter():
    modules = imported(IMPORT, 'starcal_ros.workflows.still_images.pipeline', 'starcal_ros.report',
                       'starcal_ros.calibration.methods.bundle')
    assert 'numba' not in libraries(modules)


@pytest.mark.slow
def test_nodes_import_nothing_that_they_do_not_run():
    """And scipy when they first need it, which those that simulate and play never do."""
    pytest.importorskip('rclpy')
    names = ('estimator', 'intrinsics_estimator', 'gyro_sim', 'star_tracker_sim', 'player')
    modules = imported(IMPORT, *(f'starcal_ros.nodes.{name}' for name in names))
    found = libraries(modules)
    assert {'rclpy', 'numpy', 'mcap'} <= found
    assert not found & {'PIL', 'astropy', 'joblib', 'matplotlib', 'plotly', 'rich', 'rosbags'}
    # numba, which the filter is compiled by, brings scipy's linear algebra.
    assert not {name for name in modules if name.startswith('scipy.')} & {
        f'scipy.{part}' for part in ('optimize', 'special', 'spatial', 'stats')}


def test_nodes_that_only_simulate_or_play_do_without_the_filter():
    pytest.importorskip('rclpy')
    modules = imported(IMPORT, *(f'starcal_ros.nodes.{name}' for name in (
        'gyro_sim', 'star_tracker_sim', 'player')))
    assert not libraries(modules) & {'numba', 'scipy'}
