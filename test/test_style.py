# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Style, types and the direction of imports."""

import ast
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest

TOP = Path(__file__).parents[1]
PACKAGE = TOP / 'starcal_ros'
WINGS = ('core', 'files', 'sky', 'config', 'measurements', 'filter', 'imaging', 'identification',
         'calibration', 'messages', 'recording', 'checks', 'results', 'workflows', 'simulation',
         'evaluation', 'reproduction', 'report', 'live', 'nodes.base', 'nodes', 'cli')
"""Each imports itself and those before it. What estimates stands before the truth."""
ONLY: dict[str, str | tuple[str, ...]] = {
    'rclpy': 'nodes', 'ament_index_python': 'nodes', '_msgs': 'nodes', '_srvs': 'nodes',
    '_interfaces': 'nodes', 'mcap': 'recording', 'rosbags': 'recording',
    'matplotlib': 'report', 'plotly': 'report', 'numba': ('core', 'filter', 'calibration'),
    'aiohttp': 'live'}
"""Endings of the names of libraries that one wing alone imports, or few."""
DISTRIBUTIONS = {'PIL': 'pillow', 'erfa': 'pyerfa', 'yaml': 'pyyaml'}
"""Names on PyPI of the libraries that are imported by another one."""
LICENSED = ('*.py', '*.yaml', '*.xml', '*.cfg', '*.toml', '*.css', '*.js', '*.rviz', '*.cff',
            '.gitignore', 'Makefile', '.ci/run', 'bin/*')
"""Code and configuration: what takes a comment and is no prose."""
FOLDERS = ('.ci', 'bench', 'bin', 'config', 'docs', 'examples', 'launch', 'scripts',
           'starcal_ros', 'test')
LICENSE = ('Copyright 2026 starcal_ros contributors', 'SPDX-License-Identifier: Apache-2.0')


def run(*command: str) -> None:
    """Run a checker of `.venv` on the checkout; its findings are the failure's text."""
    done = subprocess.run([sys.executable, '-m', *command], cwd=TOP, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout


def imports(path: Path, top: Path = TOP) -> set[str]:
    """Return the dotted name of all that a module imports, at any depth of its code.

    `from a.b import c` counts as a.b and as a.b.c, which may be a module as well.
    """
    names = set()
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(top).parts[:-node.level] if node.level else ()
            module = '.'.join([*package, *filter(None, [node.module])])
            names.update([module, *(f'{module}.{alias.name}' for alias in node.names)])
    return names


def test_flake8_is_silent():
    pytest.importorskip('flake8')
    run('flake8')


def test_docstrings_follow_numpydoc():
    pytest.importorskip('pydocstyle')
    run('pydocstyle', 'setup.py', 'launch', 'starcal_ros', 'test')


def test_types_are_strict_outside_the_nodes(tmp_path):
    pytest.importorskip('mypy')
    run('mypy', '--cache-dir', str(tmp_path))


def unlicensed(top: Path) -> list[str]:
    """Return the files of code and configuration that do not begin with the licence."""
    paths = [*top.iterdir(), *(path for folder in FOLDERS for path in (top / folder).rglob('*'))]
    return sorted(
        path.relative_to(top).as_posix() for path in paths
        if path.is_file() and any(path.relative_to(top).match(kind) for kind in LICENSED)
        and not all(line in '\n'.join(path.read_text().splitlines()[:3]) for line in LICENSE))


def test_each_file_of_code_and_configuration_states_its_licence():
    assert not unlicensed(TOP)


@pytest.mark.parametrize('where', ['setup.cfg', 'config/viewers/layout.xml', '.ci/run',
                                   'bin/starcal', 'docs/_static/page.css', 'test/test_new.py'])
def test_a_file_without_its_licence_is_found(tmp_path, where):
    path = tmp_path / where
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'# {LICENSE[0]}\n')
    assert unlicensed(tmp_path) == [where]
    path.write_text('# '.join(['', *(f'{line}\n' for line in LICENSE)]))
    assert unlicensed(tmp_path) == []


def test_imports_are_resolved_to_dotted_names():
    assert 'matplotlib.pyplot' not in imports(Path(__file__))
    assert {'ast', 'pathlib', 'pathlib.Path'} <= imports(Path(__file__))


def misplaced(package: Path) -> list[str]:
    """Return what stands in no wing, or imports what its wing must not."""
    found = set()
    for path in package.rglob('*.py'):
        own = wing(path.relative_to(package).with_suffix('').parts)
        where = path.relative_to(package).as_posix()
        if own < 0:
            found.update([f'{where} is in no wing'] * (where != '__init__.py'))
            continue
        for name in imports(path, package.parent):
            first, *rest = name.split('.')
            if first == package.name and own < wing(tuple(rest)):
                found.add(f'{where} imports {WINGS[wing(tuple(rest))]}')
            if any(first.endswith(library) and not WINGS[own].startswith(home)
                   for library, home in ONLY.items()):
                found.add(f'{where} imports {first}')
    return sorted(found)


def wing(parts: tuple[str, ...]) -> int:
    """Return the place in `WINGS` of a module, given by its parts; -1 where it is in none."""
    places = [k for k, name in enumerate(WINGS) if parts[:name.count('.') + 1] == (
        *name.split('.'),)]
    return min(places, default=-1)


def test_imports_run_down_the_table_of_wings():
    assert not misplaced(PACKAGE)


def test_map_of_the_package_has_the_wings_in_their_order():
    text = ast.get_docstring(ast.parse((PACKAGE / '__init__.py').read_text())) or ''
    table = text.partition('\nThe wings\n')[2].partition('\nFrames\n')[0]
    named = re.findall(r'^    (\w+) {2,}\w', table, re.MULTILINE)
    assert named == [name for name in WINGS if '.' not in name]
    assert {*named, 'data'} == {path.name for path in PACKAGE.iterdir() if path.is_dir()
                                and path.name != '__pycache__'}


def test_no_module_imports_scipy_stats():
    """It takes half a second: `core.distributions` has what is needed of it."""
    assert not [path.name for path in PACKAGE.rglob('*.py') if 'scipy.stats' in imports(path)]


def declared() -> set[str]:
    """Return what setup.py requires or has as an extra, and what package.xml depends on."""
    setup = ast.parse((TOP / 'setup.py').read_text())
    texts = (node.value for keyword in ast.walk(setup) if isinstance(keyword, ast.keyword)
             and keyword.arg in ('install_requires', 'extras_require')
             for node in ast.walk(keyword.value)
             if isinstance(node, ast.Constant) and isinstance(node.value, str))
    manifest = ElementTree.parse(TOP / 'package.xml').iterfind('exec_depend')
    return {*(re.split('[<>=]', text)[0] for text in texts), *(part.text for part in manifest)}


def undeclared(package: Path) -> set[str]:
    """Return the libraries that a package imports and nothing declares."""
    first = {name.split('.')[0] for path in package.rglob('*.py')
             for name in imports(path, package.parent)}
    libraries = first - {package.name} - set(sys.stdlib_module_names)
    return {name for name in libraries if DISTRIBUTIONS.get(name, name) not in declared()}


def test_every_library_that_is_imported_is_declared():
    assert not undeclared(PACKAGE)


def test_a_library_that_nothing_declares_is_found(tmp_path):
    (tmp_path / 'module.py').write_text('import json, erfa, rclpy.node\nfrom pandas import Series')
    assert undeclared(tmp_path) == {'pandas'}


@pytest.mark.parametrize('where, line', [
    ('core/rotation.py', 'from starcal_ros.config import models'),
    ('filter/verdict.py', 'import starcal_ros.calibration.method'),
    ('workflows/bootstrap.py', 'def run():\n    from starcal_ros.simulation import sensors'),
    ('nodes/base/tally.py', 'from .. import estimator'),
    ('simulation/errors/smear.py', 'from starcal_ros.evaluation import bounds'),
    ('loose.py', 'import numpy'),
    ('cli/play.py', 'import rclpy'),
    ('config/models.py', 'from sensor_msgs.msg import Imu'),
    ('messages/cdr.py', 'from mcap.reader import make_reader'),
    ('cli/report.py', 'import matplotlib.pyplot as plt'),
])
def test_an_import_against_the_table_is_found(tmp_path, where, line):
    path = tmp_path / 'starcal_ros' / where
    path.parent.mkdir(parents=True)
    path.write_text(f'import numpy\nfrom starcal_ros.core import units\n{line}\n')
    assert len(misplaced(tmp_path / 'starcal_ros')) == 1


def test_a_class_name_has_one_meaning():
    """But for `Config`, which each error source has by agreement."""
    where = {}
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and node.name != 'Config':
                where.setdefault(node.name, []).append(path.relative_to(PACKAGE).as_posix())
    assert {name: paths for name, paths in where.items() if len(paths) > 1} == {}
