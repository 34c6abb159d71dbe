"""Style, types and the direction of imports."""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

TOP = Path(__file__).parents[1]
PACKAGE = TOP / 'starcal_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))


def run(*command: str) -> None:
    """Run a checker of `.venv` on the checkout; its findings are the failure's text."""
    done = subprocess.run([sys.executable, '-m', *command], cwd=TOP, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout


def imports(path: Path) -> set[str]:
    """Return the dotted name of all that a module imports, at any depth of its code.

    `from a.b import c` counts as a.b and as a.b.c, which may be a module as well.
    """
    names = set()
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(TOP).parts[:-node.level] if node.level else ()
            module = '.'.join([*package, *filter(None, [node.module])])
            names.update([module, *(f'{module}.{alias.name}' for alias in node.names)])
    return names


def importers(*targets: str) -> set[str]:
    """Return where in the package something of the targets is imported: folder or file."""
    return {path.relative_to(PACKAGE).parts[0] for path in MODULES
            if any(f'{name}.'.startswith(f'{target}.')
                   for name in imports(path) for target in targets)}


def test_flake8_is_silent():
    pytest.importorskip('flake8')
    run('flake8')


def test_docstrings_follow_numpydoc():
    pytest.importorskip('pydocstyle')
    run('pydocstyle', 'setup.py', 'launch', 'starcal_ros', 'test')


def test_types_are_strict_outside_the_nodes(tmp_path):
    pytest.importorskip('mypy')
    run('mypy', '--cache-dir', str(tmp_path))


def test_imports_are_resolved_to_dotted_names():
    assert 'matplotlib.pyplot' not in imports(Path(__file__))
    assert {'ast', 'pathlib', 'pathlib.Path'} <= imports(Path(__file__))


def test_only_the_nodes_know_ros():
    messages = {name.split('.')[0] for path in MODULES for name in imports(path)
                if name.split('.')[0].endswith(('_msgs', '_interfaces', '_srvs'))}
    assert importers('rclpy', 'ament_index_python', *messages) <= {'nodes'}


def test_only_the_recording_modules_open_recordings():
    assert not [name for name in importers('mcap', 'rosbags')
                if name != 'recording']


def test_only_the_report_plots():
    assert importers('matplotlib', 'plotly') <= {'report'}


def test_the_truth_is_hidden_from_the_estimator():
    assert importers('starcal_ros.simulation') <= {
        'simulation', 'evaluation', 'reproduction', 'cli', 'nodes'}


def test_the_core_stands_below_report_nodes_and_command_line():
    assert importers('starcal_ros.report', 'starcal_ros.nodes', 'starcal_ros.cli') <= {
        'report', 'nodes', 'cli'}
