# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images of stars give their camera: simulated ones the true one, real ones small residuals.

The real ones are of ``../shared/data/real_sky``, whose README has a reference fit.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from instruments import REAL_SKY
from starcal_ros.cli import main
from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.utc import unix_ns
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.messages.conventions import from_camera_info
from starcal_ros.results.document import CalibrationError
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places
from starcal_ros.sky.refraction import Site
from starcal_ros.workflows.still_images import calibration, opencv_camera, pipeline, table

EPOCH = '2018-01-01T00:00:00'
WIDTH, HEIGHT = 1280, 960
TRUE = dict(zip(opencv_camera.KEYS, (2657.9, 657.2, 431.2, -0.032, 0.6, -7e-4, -1.1e-3)))
SCENARIO = calibration.scenario_of(WIDTH, HEIGHT, 2600.0, 'bundle')
PIXELS = detector(SCENARIO.camera)


def intrinsics(f_px, u0_px, v0_px, k1, k2, p1, p2):
    """Return the project's camera of OpenCV's."""
    return from_camera_info(np.array([f_px, 0, u0_px, 0, f_px, v0_px, 0, 0, 1]),
                            np.array([k1, k2, p1, p2, 0]), PIXELS)


def write(path, images, sigma=0.1, seed=1, held=(), wrong=0.0):
    """Write the stars of random looks at the sky, so many of them under numbers of others."""
    rng = np.random.default_rng(seed)
    stars = catalog.load(6.5)
    u_i = apparent_places(stars, np.arange(len(stars)), np.array([unix_ns(EPOCH)]),
                          np.array([len(stars)]), Observer(velocity='barycentre'))
    with path.open('w', newline='') as stream:
        table = csv.writer(stream)
        table.writerow(['image', 'catalog_id', 'u', 'v', 'split'])
        for k in range(images):
            r_s = u_i @ rotation.exp(3.0 * rng.standard_normal(3)).T
            ahead = r_s[:, 2] > 0.9
            uv = camera.project(r_s[ahead], intrinsics(**TRUE), PIXELS.pitch_mm)
            uv += sigma * rng.standard_normal(uv.shape)
            hips = stars.hip[ahead]
            mixed = rng.random(len(hips)) < wrong
            hips = np.where(mixed, rng.choice(stars.hip, len(hips)), hips)
            for hip, place in zip(hips, uv):
                if PIXELS.contains(place):
                    table.writerow([f'{k}.png', hip, *(place + PIXELS.centre_raster).tolist(),
                                    'heldout' if k in held else 'fit'])
    return path


@pytest.fixture(scope='module')
def calibrated(tmp_path_factory):
    """Return what the bundle makes of twelve images, two held out."""
    path = write(tmp_path_factory.mktemp('plates') / 'stars.csv', 12, held=(3, 7))
    images = table.read_centroids(path, EPOCH)
    f_px = calibration.focal_length_px(images, WIDTH, HEIGHT)
    assert f_px == pytest.approx(TRUE['f_px'], rel=0.05)
    scenario = calibration.scenario_of(WIDTH, HEIGHT, f_px, 'bundle')
    return calibration.calibrate(images, scenario)


@pytest.fixture(scope='module')
def found(calibrated):
    return calibrated.as_dict()


def test_the_true_camera_is_found_within_its_sigma(found):
    error = np.array([found[key] - TRUE[key] for key in opencv_camera.KEYS])
    covariance = np.array(found['covariance'])
    assert error @ np.linalg.solve(covariance, error) < 24.3        # 0.999 of chi-square, 7
    assert np.sqrt(np.diag(covariance)) == pytest.approx(list(found['sigma'].values()))


@pytest.mark.parametrize('method', ['angular_distance', 'singular_value', 'interstar'])
def test_methods_without_an_attitude_take_a_table_as_a_spreadsheet_writes_it(
        method, tmp_path, capsys):
    """Byte order mark and carriage returns."""
    path, out = write(tmp_path / 'stars.csv', 12), tmp_path / 'camera.json'
    path.write_bytes(b'\xef\xbb\xbf' + path.read_bytes())
    assert b'\r\n' in path.read_bytes()
    assert main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH), '--height',
                 str(HEIGHT), '--method', method, '--out', str(out)]) == 0
    camera_ = json.loads(out.read_text())
    for key in ('f_px', 'u0_px', 'v0_px'):
        assert abs(camera_[key] - TRUE[key]) < 4.0 * camera_['sigma'][key]


@pytest.mark.slow
@pytest.mark.parametrize('method', ['bundle', 'angular_distance', 'singular_value', 'interstar'])
def test_a_fifth_of_wrong_numbers_is_let_go(method, tmp_path):
    images = table.read_centroids(write(tmp_path / 'stars.csv', 12, wrong=0.2), EPOCH)
    f_px = calibration.focal_length_px(images, WIDTH, HEIGHT)
    found = calibration.calibrate(images, calibration.scenario_of(
        WIDTH, HEIGHT, f_px, method)).as_dict()
    error = np.array([found[key] - TRUE[key] for key in opencv_camera.KEYS])
    assert error @ np.linalg.solve(np.array(found['covariance']), error) < 24.3
    assert found['counts']['images'] == 12


def test_a_table_in_two_calls_is_the_camera_of_the_command(tmp_path):
    path, out = write(tmp_path / 'stars.csv', 8, held=(3,)), tmp_path / 'camera.json'
    assert main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH), '--height',
                 str(HEIGHT), '--estimate', 'f', 'k1', '--out', str(out)]) == 4
    outcome = pipeline.calibrate(pipeline.of_table(path, WIDTH, HEIGHT), parameters={
        'intrinsics.estimate': ('f', 'k1')}).outcome
    assert json.loads(json.dumps(outcome)) == json.loads(out.read_text())


def test_what_can_not_be_calibrated_is_said(tmp_path):
    path = write(tmp_path / 'stars.csv', 3)
    source = pipeline.of_table(path, WIDTH, HEIGHT)
    with pytest.raises(CalibrationError, match='no camera from 3 images .* needs a gyro'):
        pipeline.calibrate(source, 'predicted_centroid')
    with pytest.raises(ConfigError, match='needs the epoch'):
        pipeline.of_table(path, WIDTH, HEIGHT, pipeline.Conditions(site=Site(47.0, 8.5)))


def test_directions_of_the_stars_are_found_once_a_round_beside_the_method(tmp_path, monkeypatch):
    looked = []

    class Counting(StarDirections):
        def of(self, frames):
            looked.append(len(frames))
            return super().of(frames)

    monkeypatch.setattr(calibration, 'StarDirections', Counting)
    images = table.read_centroids(write(tmp_path / 'stars.csv', 6, held=(2,)), EPOCH)
    assert calibration.calibrate(images, SCENARIO) is not None
    assert looked == 2 * [6]


def statistics(outcome):
    return {each['name']: each for each in outcome['consistency']}


def test_a_right_camera_is_consistent_and_an_unstated_sigma_is_not_judged(found):
    assert found['verdict'] == 'consistent' and found['converged'] and not found['advice']
    tests = statistics(found)
    assert {'lens beyond the model', 'mean over the pixel', 'mean over the detector',
            'held-out images against fitted ones', 'share of rejected stars'} <= {*tests}
    assert 'NIS of the centroids' not in tests
    assert found['variance_factor'] == {
        'centroids': None, **dict.fromkeys(opencv_camera.KEYS, 1.0)}
    assert 'tolerance' not in found


@pytest.mark.parametrize('stated, word', [(0.1, 'consistent'), (0.05, 'inconsistent'),
                                          (0.2, 'inconsistent')])
def test_a_stated_sigma_is_held_against_the_residuals(stated, word, tmp_path):
    path = write(tmp_path / 'stars.csv', 8)
    head, *rows = path.read_text().splitlines()
    path.write_text('\n'.join([f'{head},sigma', *(f'{row},{stated}' for row in rows)]))
    outcome = pipeline.calibrate(pipeline.of_table(path, WIDTH, HEIGHT)).outcome
    assert outcome['verdict'] == word
    level = statistics(outcome)['NIS of the centroids']
    assert level['value'] == pytest.approx((0.1 / stated)**2, rel=0.15)
    assert level['passed'] == (word == 'consistent')
    # The sigmas of the result are already those of the residuals.
    assert outcome['variance_factor']['f_px'] == pytest.approx(1.0, abs=0.05)
    assert outcome['variance_factor']['centroids'] == level['value']


@pytest.mark.parametrize('factor, is_told', [(1.0, False), (2.5, True)])
def test_stars_that_scatter_more_than_their_sigma_says_are_told(factor, is_told, tmp_path):
    """A quarter, the bright ones say: the camera hangs on them, the mean square does not."""
    path, rng = write(tmp_path / 'stars.csv', 8), np.random.default_rng(6)
    head, *rows = path.read_text().splitlines()
    stated = np.where(rng.random(len(rows)) < 0.25, 0.1 / factor, 0.1)
    path.write_text('\n'.join([f'{head},sigma', *(
        f'{row},{sigma}' for row, sigma in zip(rows, stated))]))
    outcome = pipeline.calibrate(pipeline.of_table(path, WIDTH, HEIGHT)).outcome
    test = statistics(outcome)['scatter over the stated sigma'] if is_told else None
    assert ('scatter over the stated sigma' in statistics(outcome)) == is_told
    if is_told:
        assert not test['passed'] and outcome['verdict'] == 'inconsistent'
        assert 'more than their sigmas say' in outcome['advice']
        assert 3.0 < outcome['variance_factor']['f_px'] < 8.0
    else:
        assert outcome['verdict'] == 'consistent'


def test_images_of_too_few_stars_are_not_called_consistent(tmp_path, capsys):
    path, out = write(tmp_path / 'stars.csv', 2), tmp_path / 'camera.json'
    head, *rows = path.read_text().splitlines()
    some = [row for k in '01' for row in [row for row in rows if row.startswith(k)][:9]]
    path.write_text('\n'.join([head, *some]))
    assert main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH), '--height',
                 str(HEIGHT), '--out', str(out)]) == 3
    outcome = json.loads(out.read_text())
    assert outcome['verdict'] == 'not yet' and outcome['consistency'] == []
    assert '30 are needed for a test' in outcome['advice']
    assert 'Verdict: not yet' in capsys.readouterr().out


def test_a_lens_that_moves_between_images_is_noticed(tmp_path):
    path = write(tmp_path / 'stars.csv', 8)
    head, *rows = path.read_text().splitlines()
    moved = []
    for row in rows:
        image, hip, u, v, split = row.split(',')
        factor = 1.0 + 3e-4 * (-1.0)**int(image[0])
        moved.append(f'{image},{hip},{TRUE["u0_px"] + factor * (float(u) - TRUE["u0_px"])},'
                     f'{TRUE["v0_px"] + factor * (float(v) - TRUE["v0_px"])},{split}')
    path.write_text('\n'.join([head, *moved]))
    outcome = pipeline.calibrate(pipeline.of_table(path, WIDTH, HEIGHT)).outcome
    assert outcome['verdict'] == 'inconsistent'
    assert not statistics(outcome)['camera from frame to frame']['passed']
    assert 'focus' in outcome['advice'] and outcome['variance_factor']['f_px'] > 4.0


def test_residuals_are_the_noise_of_the_centroids(found):
    assert found['centroid_sigma_px'] == pytest.approx(0.1, rel=0.05)
    assert found['fit_rms_px'] == pytest.approx(0.1, rel=0.08)
    assert found['heldout_rms_px'] == pytest.approx(0.1, rel=0.15)
    assert found['counts']['images'] == 10 and found['counts']['heldout_stars'] > 50


def test_noise_is_shared_by_what_camera_and_attitudes_leave_free(calibrated):
    """The unbiased variance: the squares over 2 n less the rank of all that was fitted."""
    spots, adjusted = calibrated.fit.spots, calibrated.fit.adjusted
    frame, used = spots.frame, adjusted.used
    r_s = (adjusted.C_si[frame] @ spots.u_i[..., None])[..., 0]
    _, by_rotation, by_camera = camera.linearize(r_s, adjusted.intrinsics, PIXELS.pitch_mm)
    of_image = np.eye(len(adjusted.C_si))[frame]
    J = np.concatenate(((of_image[:, None, :, None] * by_rotation[:, :, None, :]).reshape(
        len(frame), 2, -1), by_camera), axis=-1)[used].reshape(2 * used.sum(), -1)
    freedom = len(J) - np.linalg.matrix_rank(J / np.linalg.norm(J, axis=0))
    assert calibrated.sigma_px == pytest.approx(
        np.sqrt(np.sum(adjusted.residual[used]**2) / freedom), rel=1e-12)


def test_page_shows_each_image_and_escapes_its_name(tmp_path):
    path = write(tmp_path / 'stars.csv', 4, held=(2,))
    path.write_text(path.read_text().replace('1.png', '<b>.png'))
    page = tmp_path / 'page.html'
    assert main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH), '--height',
                 str(HEIGHT), '--report', str(page)]) == 0
    text = page.read_text()
    assert '&lt;b&gt;.png' in text and '<b>.png' not in text
    assert all(f'<section id="{name}">' in text for name in (
        'verdict', 'camera', 'fit', 'heldout', 'distortion', 'coupling', 'notices'))
    assert '<p class="verdict yes">Verdict: consistent' in text and 'mean over the pixel' in text
    # Projection and coverage, and of fitted and held-out images eleven each.
    assert text.count('<figure') == 28


def test_covariance_goes_over_to_opencv_as_differences_say():
    rng = np.random.default_rng(2)
    values = intrinsics(**TRUE)
    root = rng.standard_normal((7, 7)) * [0.1, 0.1, 1e-3, 1e-6, 1e-8, 1e-6, 1e-6]
    _, covariance = opencv_camera.from_estimate(
        CameraEstimate(values, root.T @ root, 1, 1), SCENARIO)
    step = np.array([1e-3, 1e-3, 1e-4, 1e-7, 1e-9, 1e-7, 1e-7])

    def converted(x):
        return opencv_camera.from_estimate(CameraEstimate(x, np.eye(7), 1, 1), SCENARIO)[0]

    J = np.stack([(converted(values + h * e) - converted(values - h * e)) / (2 * h)
                  for h, e in zip(step, np.eye(7))], axis=1)
    expected = J @ root.T @ root @ J.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(covariance / scale, expected / scale, atol=1e-6)


def test_keys_are_opencvs(found):
    assert intrinsics(**{key: found[key] for key in opencv_camera.KEYS})[2] == pytest.approx(
        found['f_px'] * calibration.PITCH_MM)
    uv = np.array([[300.0, -200.0]])
    r_s = camera.unproject(uv, intrinsics(**TRUE), PIXELS.pitch_mm)[0]
    x, y = -r_s[:2] / r_s[2]                            # optical axes
    rr, t = x * x + y * y, TRUE
    radial = 1 + t['k1'] * rr + t['k2'] * rr**2
    expected = [t['u0_px'] + t['f_px'] * (x * radial + 2 * t['p1'] * x * y
                                          + t['p2'] * (rr + 2 * x * x)),
                t['v0_px'] + t['f_px'] * (y * radial + t['p1'] * (rr + 2 * y * y)
                                          + 2 * t['p2'] * x * y)]
    np.testing.assert_allclose(uv[0] + PIXELS.centre_raster, expected, atol=1e-9)


@pytest.mark.parametrize('name, width, height, limit, culprit, reference', [
    ('tomc16', 808, 608, 0.10, 'mean over the pixel',
     (3230.22, 404.18, 310.87, 0.0907, -0.339, -3.2e-4, 2.3e-4)),
    ('granasat', 1280, 960, 0.14, 'lens beyond the model',
     (2657.86, 657.24, 431.17, -0.0314, 0.596, -7.4e-4, -1.1e-3)),
])
def test_real_sky(name, width, height, limit, culprit, reference, tmp_path, capsys):
    """Held-out images: at most the limits set, and the camera is the reference's within 4 sigma.

    The reference is a fit of the same stars by others; the difference is far less than chance.
    """
    table = REAL_SKY / name / 'stars.csv'
    if not table.is_file():
        pytest.skip(f'{table.parent} is not there')
    out = tmp_path / 'camera.json'
    assert main(['intrinsics', '--centroids', str(table), '--width', str(width), '--height',
                 str(height), '--out', str(out)]) == 4
    camera_ = json.loads(out.read_text())
    assert culprit in {each['name'] for each in camera_['consistency'] if not each['passed']}
    assert camera_['heldout_rms_px'] <= limit and camera_['fit_rms_px'] < 0.15
    for key, value in zip(opencv_camera.KEYS, reference):
        assert abs(camera_[key] - value) < 4.0 * camera_['sigma'][key], key
    assert 'held-out' in capsys.readouterr().out


@pytest.mark.parametrize('text, culprit', [
    ('image,u,v\n', 'no column catalog_id'),
    ('image,u,v,catalog_id\na,1,x,3\n', "line 2: got '1', 'x', '3'"),
    ('image,u,v,catalog_id,split\na,1,2,3,test\n', "split 'test', needs fit or heldout"),
    ('image,u,v,catalog_id,split\na,1,2,3,fit\na,1,2,3,heldout\n', 'the same for all stars'),
])
def test_wrong_tables_are_named(text, culprit, tmp_path):
    path = tmp_path / 'stars.csv'
    path.write_text(text)
    with pytest.raises(ConfigError, match=culprit):
        table.read_centroids(path, EPOCH)


@pytest.mark.parametrize('words, status, culprit', [
    ([], 2, 'a recording, a folder of images, or --centroids'),
    (['--centroids', 'stars.csv'], 2, '--width and --height'),
    (['--centroids', 'stars.csv', '--width', '9', '--height', '900'], 2, 'camera.width: got 9'),
    (['--centroids', 'none.csv', '--width', '900', '--height', '900'], 2, 'none.csv'),
    (['--centroids', 'stars.csv', '--width', '900', '--height', '900', '--fov', '20', '--method',
      'guess'], 2,
     "got 'guess', allowed are"),
    (['--centroids', 'stars.csv', '--width', '900', '--height', '900'], 2, 'two identified'),
])
def test_command_says_what_is_wrong(words, status, culprit, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('stars.csv').write_text('image,u,v,catalog_id\na,1,2,677\nb,1,2,677\n')
    assert main(['intrinsics', *words]) == status
    assert culprit in capsys.readouterr().err
