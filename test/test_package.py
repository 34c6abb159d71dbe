# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The package installs: into a ROS 2 workspace with colcon, and anywhere with pip."""

from importlib.metadata import PathDistribution
import importlib.util
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tarfile
import venv
from xml.etree import ElementTree

from packaging.requirements import Requirement
import pytest
import yaml

import starcal_ros

TOP = Path(__file__).parents[1]
PARTS = ['package.xml', 'pyproject.toml', 'setup.py', 'setup.cfg', 'LICENSE', 'README.md',
         'MANIFEST.in', 'CHANGELOG.rst', 'CITATION.cff', 'CONTRIBUTING.md', 'Makefile',
         'bin', 'resource', 'config', 'launch', 'starcal_ros']
EXECUTABLES = ['starcal', 'star_tracker_sim', 'gyro_sim', 'estimator', 'intrinsics_estimator',
               'centroid_extractor', 'star_identifier', 'recorder', 'player', 'serve', 'display',
               'watch',
               'composed']
LAUNCH_FILES = sorted((TOP / 'launch').glob('*.launch.py'))
MARKER = 'share/ament_index/resource_index/packages/starcal_ros'


def run(*command: object, cwd: Path) -> str:
    """Run a command and return what it prints, which is the failure's text if it fails."""
    done = subprocess.run([str(word) for word in command], cwd=cwd, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope='module')
def copy(tmp_path_factory):
    """Return a copy of all that is installed, so that nothing is built in the checkout."""
    folder = tmp_path_factory.mktemp('workspace') / 'starcal_ros'
    folder.mkdir()
    for part in PARTS:
        if (TOP / part).is_dir():
            shutil.copytree(TOP / part, folder / part,
                            ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy(TOP / part, folder)
    return folder


@pytest.fixture(scope='module')
def colcon(copy):
    """Return a function that runs colcon beside the copy."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    if not (command := shutil.which('colcon', path=path)):
        pytest.skip('colcon is not installed')
    return lambda verb, *words: run(command, '--log-base', 'log', verb, '--base-paths', copy,
                                    *words, cwd=copy.parent)


@pytest.fixture(scope='module')
def wheel(copy, tmp_path_factory):
    """Return the wheel that pip builds."""
    pytest.importorskip('wheel')
    folder = tmp_path_factory.mktemp('wheel')
    run(sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--no-index', '--no-build-isolation',
        '--wheel-dir', folder, copy, cwd=folder)
    return next(folder.glob('*.whl'))


def assert_share_is_complete(prefix: Path) -> None:
    """Check the marker, the manifest and every scenario and launch file under a prefix."""
    assert (prefix / MARKER).is_file()
    share = prefix / 'share' / 'starcal_ros'
    wanted = {'package.xml', *(f'launch/{path.name}' for path in LAUNCH_FILES),
              *(str(path.relative_to(TOP)) for path in (TOP / 'config').rglob('*')
                if path.is_file())}
    found = {str(path.relative_to(share)) for path in share.rglob('*') if path.is_file()}
    made = re.compile(r'hook/|package\.(dsv|ps1|sh|bash|zsh)|launch/__pycache__/')
    assert {name for name in found if not made.match(name)} == wanted


def test_manifest_is_valid():
    parse = pytest.importorskip('catkin_pkg.package').parse_package
    warnings: list[str] = []
    package = parse(str(TOP), warnings=warnings)
    package.validate(warnings=warnings)
    assert package.get_build_type() == 'ament_python'
    assert not warnings


def test_versions_agree():
    version = starcal_ros.__version__
    assert ElementTree.parse(TOP / 'package.xml').findtext('version') == version
    newest = re.search(r'^(\d+\.\d+\.\d+) \(', (TOP / 'CHANGELOG.rst').read_text(), re.MULTILINE)
    assert newest and newest.group(1) == version
    assert run(sys.executable, 'setup.py', '--version', cwd=TOP).splitlines()[-1] == version
    citation = yaml.safe_load((TOP / 'CITATION.cff').read_text())
    assert citation['version'] == version
    assert f'{version} ({citation["date-released"]})' in (TOP / 'CHANGELOG.rst').read_text()


def test_manifest_and_setup_name_the_same_places(copy):
    urls = {url.get('type'): url.text
            for url in ElementTree.parse(TOP / 'package.xml').findall('url')}
    assert set(urls) == {'website', 'repository', 'bugtracker'}
    told = run(sys.executable, 'setup.py', '--url', '--classifiers', '--license',
               '--long-description', cwd=copy)
    assert urls['website'] in told and 'License :: OSI Approved :: Apache' in told
    assert (TOP / 'README.md').read_text().strip() in told


def test_source_distribution_has_what_it_is_built_of_and_the_changelog(copy, tmp_path):
    source = tmp_path / 'copy'
    shutil.copytree(copy, source)
    run(sys.executable, 'setup.py', '-q', 'sdist', '--dist-dir', tmp_path, cwd=source)
    archive, = tmp_path.glob('*.tar.gz')
    with tarfile.open(archive) as opened:
        names = {name.partition('/')[2] for name in opened.getnames()}
        opened.extractall(tmp_path / 'out', filter='data')
    assert {'CHANGELOG.rst', 'README.md', 'LICENSE', 'package.xml', 'bin/starcal',
            'config/tan2018.yaml', 'launch/simulate.launch.py',
            'starcal_ros/data/hipparcos2_hp8.npy'} <= names
    # It builds of what it has.
    built, = (tmp_path / 'out').iterdir()
    run(sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--no-index', '--no-build-isolation',
        '--wheel-dir', tmp_path, built, cwd=tmp_path)
    assert list(tmp_path.glob('*.whl'))


def test_container_takes_the_libraries_that_no_distribution_has():
    text = (TOP / 'docker' / 'Dockerfile').read_text()
    setup = (TOP / 'setup.py').read_text()
    for name in ('mcap', 'plotly', 'rosbags', 'tetra3rs', 'allantools', 'weasyprint'):
        wanted, = {word for word in re.findall(r"'([^' ]+)'", setup)
                   if re.match(rf'{name}\b', word)}
        assert f"'{wanted}'" in text
    # numpy is the distribution's before pip looks for it.
    assert text.index('rosdep install') < text.index('pip install')
    assert 'python3-venv' in text and '--system-site-packages' in text
    folder = json.loads(''.join(
        line for line in (TOP / '.devcontainer' / 'devcontainer.json').open()
        if not line.lstrip().startswith('//')))
    assert folder['image'].startswith('ros:')


def test_what_is_installed_has_what_the_commands_need(tmp_path):
    """By the README: with pip the extra `all`, in a workspace what no distribution has."""
    run(sys.executable, 'setup.py', '-q', 'egg_info', '--egg-base', tmp_path, cwd=TOP)
    about = PathDistribution(tmp_path / 'starcal_ros.egg-info')
    extras = {extra: {Requirement(text).name for text in about.requires
                      if Requirement(text).marker and Requirement(text).marker.evaluate(
                          {'extra': extra})}
              for extra in about.metadata.get_all('Provides-Extra')}
    apart = {'all', 'ros', 'test', 'docs'}
    assert extras['all'] == set().union(*(extras[name] for name in set(extras) - apart))
    readme = (TOP / 'README.md').read_text()
    assert "pip install '.[ros,all]'" in readme
    for name in ('mcap', 'plotly', 'rosbags', *extras['identify'], *extras['allan']):
        assert re.search(rf'^pip install .*\b{name}\b', readme, re.MULTILINE)


def test_the_audit_asks_for_what_pip_brought_and_not_for_the_checkout():
    spec = importlib.util.spec_from_file_location('audit', TOP / 'scripts' / 'audit.py')
    audit = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(audit)
    names = {line.partition('==')[0].lower().replace('_', '-') for line in audit.installed()}
    assert 'mcap' in names and 'starcal-ros' not in names


def test_colcon_recognizes_a_ros_package(colcon):
    assert re.search(r'^starcal_ros\t.*\t\(ros\.ament_python\)$', colcon('list'), re.MULTILINE)


@pytest.mark.parametrize('options', [(), ('--symlink-install',)], ids=['copied', 'linked'])
def test_colcon_builds_what_ros2_run_and_launch_look_for(colcon, tmp_path, options):
    colcon('build', '--build-base', tmp_path / 'build', '--install-base', tmp_path / 'install',
           *options)
    prefix = tmp_path / 'install' / 'starcal_ros'
    assert sorted(path.name for path in (prefix / 'lib' / 'starcal_ros').iterdir()
                  if os.access(path, os.X_OK)) == sorted(EXECUTABLES)
    assert_share_is_complete(prefix)
    if not options:         # linked ones belong to the interpreter that links them
        script = (prefix / 'lib' / 'starcal_ros' / 'estimator').read_text()
        assert script.startswith('#!/usr/bin/env python3\n')
    shell = f'. {tmp_path}/install/local_setup.sh && starcal --help'
    assert 'calibrate' in run('sh', '-c', shell, cwd=tmp_path)


def test_wheel_installs_what_ros2_run_and_launch_look_for(wheel, tmp_path):
    venv.create(tmp_path, symlinks=True)
    python = tmp_path / 'bin' / 'python'
    # A workspace, as of colcon test, has the package on the path already.
    run(sys.executable, '-m', 'pip', '--python', python, 'install', '--no-deps', '--no-index',
        '--ignore-installed', wheel, cwd=tmp_path)
    assert_share_is_complete(tmp_path)
    shims = sorted((tmp_path / 'lib' / 'starcal_ros').iterdir())
    assert [shim.name for shim in shims] == sorted(EXECUTABLES)
    for shim in shims:
        assert os.access(shim, os.X_OK)
        assert f'/../../bin/{shim.name}"' in shim.read_text()
        assert os.access(tmp_path / 'bin' / shim.name, os.X_OK)
    # The dependencies are those of the environment that runs this test.
    packages = next(tmp_path.glob('lib/python*/site-packages'))
    (packages / 'outside.pth').write_text('\n'.join(
        path for path in sys.path if os.path.isdir(path) and path != str(TOP)))
    assert 'calibrate' in run(tmp_path / 'lib' / 'starcal_ros' / 'starcal', '--help', cwd=tmp_path)


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_compiles(path):
    compile(path.read_text(), str(path), 'exec')


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_loads(path):
    pytest.importorskip('launch_ros')
    spec = importlib.util.spec_from_file_location(path.name.split('.')[0], path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    names = {entity.node_executable for entity in module.generate_launch_description().entities
             if hasattr(entity, 'node_executable')}
    assert 'estimator' in names <= set(EXECUTABLES)


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((TOP / 'CITATION.cff').read_text())
    assert citation['cff-version'] == '1.2.0' and citation['message'] and citation['authors']
    assert citation['version'] == starcal_ros.__version__
    assert citation['license'] == ElementTree.parse(TOP / 'package.xml').findtext('license')
    released = re.search(rf"^{re.escape(citation['version'])} \((\S+)\)",
                         (TOP / 'CHANGELOG.rst').read_text(), re.MULTILINE)
    assert str(citation['date-released']) == released[1]
