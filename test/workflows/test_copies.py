# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pictures that are in a folder, or a table, twice."""

import csv
import json

from PIL import Image
from eye import FOV, Camera, save
import numpy as np
import pytest

from starcal_ros.cli import main

pytest.importorskip('tetra3rs')


def calibrated(out, *words):
    main(['intrinsics', '--out', str(out), '--overwrite', *map(str, words)])
    return json.loads(out.read_text())


@pytest.fixture
def images(tmp_path):
    """Two exposures of one field, and two of others."""
    folder, eye = tmp_path / 'sky', Camera()
    folder.mkdir()
    places = [eye.stars_towards() for _ in range(3)]
    for k, (uv, magnitude) in enumerate([places[0], *places]):
        save(folder / f'{k}.png', eye.counts(uv, magnitude))
    return folder


def as_8_bits(path, curve=1.0):
    counts = np.asarray(Image.open(path)).astype(float)
    part = (counts - counts.min()) / (np.percentile(counts, 99.9) - counts.min())
    return Image.fromarray((255.0 * np.clip(part, 0.0, 1.0)**curve).astype(np.uint8))


def test_exposures_of_one_field_are_no_copies_but_copies_are(images, tmp_path, capsys):
    alone = calibrated(tmp_path / 'a.json', images, '--fov', FOV)
    assert alone['left_out'] == {} and alone['counts']['images'] == 4
    (images / 'copy.png').write_bytes((images / '1.png').read_bytes())
    as_8_bits(images / '2.png').save(images / 'small.jpg', quality=80)
    as_8_bits(images / '3.png', 0.5).save(images / 'curve.png')
    found = calibrated(tmp_path / 'b.json', images, '--fov', FOV)
    assert {name: why[:24] for name, why in found['left_out'].items()} == {
        'copy.png': 'the same picture as 1.pn', 'small.jpg': 'the same picture as 2.pn',
        'curve.png': 'the same picture as 3.pn'}
    assert (found['f_px'], found['sigma']) == (alone['f_px'], alone['sigma'])
    assert 'copy.png left out: the same picture as 1.png: its stars are' in capsys.readouterr().err


def test_copies_in_a_table_count_once(images, tmp_path, capsys):
    calibrated(tmp_path / 'a.json', images, '--fov', FOV, '--stars', tmp_path / 'stars.csv')
    with (tmp_path / 'stars.csv').open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    with (tmp_path / 'twice.csv').open('w', newline='') as stream:
        table = csv.DictWriter(stream, ['image', 'u', 'v', 'catalog_id'], extrasaction='ignore')
        table.writeheader()
        table.writerows(rows)
        table.writerows({**row, 'image': 'again'} for row in rows if row['image'] == '2.png')
    found = calibrated(tmp_path / 'b.json', '--centroids', tmp_path / 'twice.csv',
                       '--width', 640, '--height', 480)
    assert list(found['left_out']) == ['again'] and found['counts']['images'] == 4
    assert 'again left out: the same picture as 2.png' in capsys.readouterr().err
