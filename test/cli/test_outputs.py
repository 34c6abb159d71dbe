# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""No command destroys what it reads, or what is there, or leaves half a result."""

import os
import resource
import subprocess
import sys

import pytest

from instruments import CONFIG, TOP
from starcal_ros.cli import main
from starcal_ros.cli.outputs import claim
from starcal_ros.config.parameter import ConfigError


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Return a recording of 20 s."""
    path = tmp_path_factory.mktemp('source') / 'run.mcap'
    assert main(['simulate', '--out', str(path), '--duration', '20']) == 0
    return path


@pytest.fixture
def bag(source, tmp_path):
    """Return a copy of it, with its content."""
    path = tmp_path / 'run.mcap'
    path.write_bytes(source.read_bytes())
    return path


OTHER_NAMES = {'itself': lambda path: path, 'dotted': lambda path: path.parent / '.' / path.name,
               'soft link': lambda path: linked(path, os.symlink),
               'hard link': lambda path: linked(path, os.link)}


def linked(path, link):
    """Return another name of a file."""
    other = path.with_name('other_' + path.name)
    link(path, other)
    return other


@pytest.mark.parametrize('name', OTHER_NAMES)
@pytest.mark.parametrize('words', [
    ['calibrate', 'BAG', '--out', 'IT'],
    ['calibrate', 'BAG', '--out', 'r.json', '--report', 'IT'],
    ['calibrate', 'BAG', '--out', 'r.json', '--figure', 'IT'],
    ['intrinsics', 'BAG', '--out', 'IT'],
    ['bootstrap', 'BAG', '--out', 'IT'],
], ids=' '.join)
def test_no_output_is_the_recording(capsys, bag, monkeypatch, words, name):
    monkeypatch.chdir(bag.parent)
    before, it = bag.read_bytes(), OTHER_NAMES[name](bag)
    words = [str({'BAG': bag, 'IT': it}.get(word, word)) for word in words]
    assert main([*words, '--overwrite']) == 2
    assert f'{it}: would replace {bag}, which is read' in capsys.readouterr().err
    assert bag.read_bytes() == before and not (bag.parent / 'r.json').exists()


@pytest.mark.parametrize('words', [
    ['calibrate', 'BAG'], ['simulate'], ['bootstrap', 'BAG'], ['montecarlo'],
    ['intrinsics', 'BAG'], ['reproduce', 'table3']], ids=' '.join)
def test_no_output_is_the_configuration(capsys, bag, tmp_path, words):
    config = tmp_path / 'my.yaml'
    config.write_text(CONFIG.read_text())
    words = [str(bag) if word == 'BAG' else word for word in words]
    assert main([*words, '--config', str(config), '--out', str(config), '--overwrite']) == 2
    assert 'my.yaml: would replace' in capsys.readouterr().err
    assert config.read_text() == CONFIG.read_text()


def test_the_demo_does_not_run_over_its_configuration(capsys, tmp_path):
    config = tmp_path / 'demo.yaml'
    config.write_text(CONFIG.read_text())
    assert main(['demo', '--config', str(config), '--out', str(tmp_path)]) == 2
    assert 'demo.yaml: would replace' in capsys.readouterr().err
    assert config.read_text() == CONFIG.read_text()


def test_no_output_is_a_file_of_the_bag(capsys, bag, tmp_path):
    (tmp_path / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [run.mcap]}')
    for name in ('run.mcap', 'metadata.yaml'):
        assert main(['calibrate', str(tmp_path), '--out', str(tmp_path / name),
                     '--overwrite']) == 2
        assert 'which is read' in capsys.readouterr().err


def test_no_export_is_the_configuration(capsys, bag, tmp_path):
    config = tmp_path / 'imu.yaml'
    config.write_text(CONFIG.read_text())
    assert main(['calibrate', str(bag), '--config', str(config), '--out',
                 str(tmp_path / 'r.json'), '--export', str(tmp_path), '--overwrite']) == 2
    assert 'imu.yaml: would replace' in capsys.readouterr().err
    assert config.read_text() == CONFIG.read_text()


def test_no_image_and_no_table_is_written_over(capsys, tmp_path):
    (tmp_path / 'a.png').write_text('precious')
    table = tmp_path / 'stars.csv'
    table.write_text('image,u,v,catalog_id\n')
    for words in ([tmp_path, '--stars', tmp_path / 'a.png'], [tmp_path, '--out', table,
                                                              '--report', tmp_path / 'a.png'],
                  ['--centroids', table, '--width', 9, '--height', 9, '--out', table]):
        assert main([str(word) for word in ('intrinsics', *words, '--overwrite')]) == 2
        assert 'which is read' in capsys.readouterr().err
    assert (tmp_path / 'a.png').read_text() == 'precious'


def test_two_outputs_are_two_files(capsys, bag, tmp_path):
    out = tmp_path / 'out'
    assert main(['calibrate', str(bag), '--out', str(out), '--report', str(out)]) == 2
    assert 'out: is to be written twice' in capsys.readouterr().err
    assert not out.exists()


def test_a_folder_that_is_removed_holds_nothing_that_is_read(tmp_path):
    scratch = tmp_path / 'study.json.parts'
    scratch.mkdir()
    config = scratch / 'my.yaml'
    config.touch()
    with pytest.raises(ConfigError, match='is removed in the end and holds'):
        claim([tmp_path / 'study.json'], [config], False, scratch)


@pytest.mark.parametrize('words', [
    ['calibrate', 'BAG'], ['bootstrap', 'BAG'], ['montecarlo'], ['reproduce', 'table3'],
    ['intrinsics', 'BAG']], ids=' '.join)
def test_a_result_that_exists_is_kept_unless_told_otherwise(capsys, bag, tmp_path, words):
    out = tmp_path / 'result.json'
    out.write_text('precious')
    words = [str(bag) if word == 'BAG' else word for word in words]
    assert main([*words, '--out', str(out)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert f'{out} exists; choose another name, or replace it with --overwrite' in line
    assert out.read_text() == 'precious'


def test_each_result_of_a_calibration_is_asked_for_and_then_replaced(capsys, bag, tmp_path):
    names = ['r.json', 'r.html', 'r.png', 'e/camchain.yaml']
    words = ['calibrate', bag, '--out', tmp_path / 'r.json', '--report', tmp_path / 'r.html',
             '--figure', tmp_path / 'r.png', '--export', tmp_path / 'e']
    words = [str(word) for word in words]
    (tmp_path / 'e').mkdir()
    for name in names:
        (tmp_path / name).write_text('precious')
        assert main(words) == 2 and f'{name} exists' in capsys.readouterr().err
        (tmp_path / name).unlink()
    for name in names:
        (tmp_path / name).write_text('precious')
    assert main([*words, '--overwrite']) == 3           # 20 s are not enough
    assert all((tmp_path / name).read_bytes() != b'precious' for name in names)
    assert not list(tmp_path.rglob('.*'))


# Nor would Python's own cache be whole: a module that is new here would be spoilt for all others.
FULL = """
import resource, sys
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
from starcal_ros.cli import main
sys.exit(main(sys.argv[2:]))
"""


def on_a_full_disk(kilobytes, *words):
    """Run a command that can write no file larger than so much; return its status and errors."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] == resource.RLIM_INFINITY
    done = subprocess.run(
        [sys.executable, '-c', FULL, str(kilobytes << 10), *map(str, words)], text=True,
        capture_output=True, env={**os.environ, 'PYTHONPATH': str(TOP)})
    assert 'Traceback' not in done.stderr
    return done.returncode, done.stderr.rstrip().splitlines()[-1]


def test_a_full_disk_ends_a_simulation_in_words_and_leaves_nothing(tmp_path):
    path = tmp_path / 'run.mcap'
    status, line = on_a_full_disk(64, 'simulate', '--out', path, '--duration', 200)
    assert (status, line) == (
        1, f'starcal simulate: error: {path}: cannot be written: File too large')
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize('option, name, kilobytes', [
    ('--out', 'r.json', 1), ('--report', 'r.html', 64), ('--figure', 'r.png', 64),
    ('--export', 'e', 0)])
def test_a_full_disk_ends_a_calibration_in_words_and_leaves_no_half(source, tmp_path, option,
                                                                    name, kilobytes):
    words = [] if option == '--out' else ['--out', '/dev/null' if kilobytes == 0 else
                                          tmp_path / 'r.json']
    status, line = on_a_full_disk(kilobytes, 'calibrate', source, *words, option,
                                  tmp_path / name)
    assert status == 1
    assert line.startswith(f'starcal calibrate: error: {tmp_path / name}')
    assert line.endswith(': cannot be written: File too large')
    left = {path.name for path in tmp_path.rglob('*') if path.is_file()}
    assert left == (set() if kilobytes < 64 else {'r.json'})
