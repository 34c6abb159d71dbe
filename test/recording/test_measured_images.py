# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that hold images and no centroids: read, and calibrated from nothing else."""

from dataclasses import replace
import json
import shutil

from compressed_images import compressed
from mcap.reader import make_reader
import numpy as np
import pytest
from scipy.stats import chi2

from instruments import CONFIG, REAL_SKY
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.utc import unix_ns
from starcal_ros.imaging.files import load
from starcal_ros.measurements.samples import Frames
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_image import COMPRESSED_TYPE, IMAGE_TYPE, decode_image, encode_image
from starcal_ros.messages.cdr_pointcloud import encode_centroids
from starcal_ros.recording import reader
from starcal_ros.recording.measured_images import ImageMeter
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.recording.topic_choice import TopicChoice
from starcal_ros.recording.writer import Writer, centroids_batch
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.simulation.write_recording import simulate

# T18's field and lens on few, large pixels, hardly at rest; the focal length believed 10 % less.
SCENARIO = Scenario().replace({
    'simulation.duration_s': 150.0, 'camera.width': 384, 'camera.height': 384,
    'camera.pixel_pitch_mm': 0.0172, 'camera.focal_length_mm': 23.04,
    'truth.camera.focal_length_mm': 25.6, 'truth.camera.principal_point_px': (3.0, -2.0),
    'truth.camera.distortion': (2e-4, -1e-6, 2e-5, 2e-5),
    'truth.gyro.bias_deg_h': (0.01, -0.02, 0.015), 'motion.dwell_s': 5.0,
    'simulation.images': True, 'image.limiting_magnitude': 6.6, 'image.full_well_electrons': 6e4})
TRUTH = Truth.from_scenario(SCENARIO)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return ten images."""
    path = tmp_path_factory.mktemp('bag') / 'images.mcap'
    simulate(SCENARIO.replace({'simulation.duration_s': 5.0}), path)
    return path


def test_simulated_images_are_those_of_the_node_and_the_centroids_are_truth(bag):
    renderer, tracker = sensors.images(SCENARIO), sensors.star_tracker(SCENARIO)
    frames = tracker.next(10)
    expected = [encode_image(stamp_ns, renderer.image(stamp_ns))
                for stamp_ns in frames.stamp_ns.tolist()]
    with bag.open('rb') as stream:
        written = [(channel.topic, message.data) for _, channel, message in
                   make_reader(stream).iter_messages(['/star_tracker/image_raw',
                                                      '/star_tracker/centroids'])]
    assert written == [('/star_tracker/image_raw', image) for image in expected]
    with bag.open('rb') as stream:
        truth = [message.data for _, _, message in
                 make_reader(stream).iter_messages(['/truth/centroids'])]
    assert truth == encode_centroids(frames)


def test_frames_are_those_of_the_images(bag):
    with pytest.raises(RecordError, match='no topic /star_tracker/centroids'):
        reader.read(bag)
    recording = reader.read(bag, measure=ImageMeter(SCENARIO))
    frames = recording.frames
    assert recording.frames_topic == '/star_tracker/image_raw' and len(frames) == 10
    assert (np.diff(frames.stamp_ns) == 500_000_000).all() and not recording.warnings
    assert frames.star_counts.min() > 20 and not frames.catalog_id.any()
    assert 0.01 < np.median(frames.sigma) < 0.3


def test_compressed_images_give_what_images_give(bag, tmp_path):
    """PNG keeps all 16 bits; where both are there, the images that are not compressed are read."""
    images = []
    with bag.open('rb') as stream:
        for _, _, message in make_reader(stream).iter_messages(['/star_tracker/image_raw']):
            image = decode_image(message.data)
            images.append((message.data, image.stamp_ns, compressed(
                image.pixels, 'PNG', 'mono16; png compressed ', image.stamp_ns)))
    expected = reader.read(bag, measure=ImageMeter(SCENARIO)).frames
    path = tmp_path / 'compressed.mcap'
    with Writer(path) as writer:
        for _, stamp_ns, data in images:
            writer.write('/star_tracker/image_raw/compressed', COMPRESSED_TYPE, data, stamp_ns)
    recording = reader.read(path, needs_gyro=False, measure=ImageMeter(SCENARIO))
    assert recording.frames_topic == '/star_tracker/image_raw/compressed'
    np.testing.assert_array_equal(recording.frames.uv_raster, expected.uv_raster)
    np.testing.assert_array_equal(recording.frames.stamp_ns, expected.stamp_ns)

    path = tmp_path / 'both.mcap'
    with Writer(path) as writer:
        for raw, stamp_ns, data in images[:2]:
            writer.write('/camera/image_raw', IMAGE_TYPE, raw, stamp_ns)
            writer.write('/camera/image_raw/compressed', COMPRESSED_TYPE, data, stamp_ns)
    recording = reader.read(path, needs_gyro=False, measure=ImageMeter(SCENARIO))
    assert recording.frames_topic == '/camera/image_raw' and len(recording.frames) == 2
    recording = reader.read(path, needs_gyro=False, measure=ImageMeter(SCENARIO),
                            choice=TopicChoice(images='/camera/image_raw/compressed'))
    np.testing.assert_array_equal(recording.frames.uv_raster,
                                  expected.take(np.arange(len(expected)) < 2).uv_raster)


def test_images_are_measured_where_there_are_centroids_only_when_asked_for(tmp_path):
    tracker, eye = sensors.star_tracker(SCENARIO), ImageMeter(SCENARIO)
    path = tmp_path / 'both.mcap'
    with Writer(path) as writer:
        writer.write_centroids('/star_tracker/centroids', tracker.next(2))
        writer.write('/star_tracker/image_raw', IMAGE_TYPE,
                     encode_image(1_500_000_000, np.full((384, 384), 100, np.uint16)),
                     1_500_000_000)
    for first, topic, count in ((False, '/star_tracker/centroids', 2),
                                (True, '/star_tracker/image_raw', 1)):
        recording = reader.read(path, needs_gyro=False, measure=eye, images_first=first)
        assert recording.frames_topic == topic and len(recording.frames) == count


def test_one_of_two_cameras_is_chosen(tmp_path):
    path, data = tmp_path / 'two.mcap', encode_image(1, np.zeros((384, 384), np.uint16))
    with Writer(path) as writer:
        for topic, count in (('/left/image', 1), ('/right/image', 2)):
            for k in range(count):
                writer.write(topic, IMAGE_TYPE, data, k)
        writer.write_centroids('/star_tracker/centroids', sensors.star_tracker(SCENARIO).next(3))
    eye = ImageMeter(SCENARIO)
    with pytest.raises(RecordError, match='/left/image .*, /right/image .*--image-topic chooses'):
        reader.read(path, needs_gyro=False, measure=eye, images_first=True)
    recording = reader.read(path, needs_gyro=False, measure=eye,
                            choice=TopicChoice(images='/right/image'))
    assert len(recording.frames) == 2 and recording.warnings == ()
    recording = reader.read(path, needs_gyro=False, measure=eye, choice=TopicChoice(
        frames='/star_tracker/centroids', images='/right/image'))
    assert len(recording.frames) == 3


def test_images_that_are_asked_for_and_missing_are_named(tmp_path, capsys):
    path = tmp_path / 'stars.mcap'
    with Writer(path) as writer:
        writer.write_centroids('/star_tracker/centroids', sensors.star_tracker(SCENARIO).next(2))
        writer.write_imu('/imu/data_raw', sensors.gyro(SCENARIO).next(2))
    assert main(['bootstrap', str(path), '--config', str(CONFIG), '--images']) == 2
    assert 'has no topic /star_tracker/image_raw' in capsys.readouterr().err


def test_an_image_that_can_not_be_used_is_named(tmp_path):
    path = tmp_path / 'odd.mcap'
    data = encode_image(1, np.zeros((384, 384), np.uint16)).replace(b'mono16', b'yuv422')
    with Writer(path) as writer:
        writer.write('/star_tracker/image_raw', IMAGE_TYPE, data, 1)
    with pytest.raises(RecordError, match="image_raw: unsupported encoding: 'yuv422'"):
        reader.read(path, needs_gyro=False, measure=ImageMeter(SCENARIO))


def test_images_of_another_size_than_the_camera_are_named(bag, capsys):
    assert main(['bootstrap', str(bag), '--config', str(CONFIG)]) == 2
    assert ('384 x 384 pixels, the camera has 1024 x 1024 (camera.width, camera.height)'
            in capsys.readouterr().err)


@pytest.mark.slow
def test_bootstrap_from_images_alone(tmp_path, capsys):
    """A focal length that is 10 % wrong, no name of a star, no centroid: to the 16 states."""
    pytest.importorskip('tetra3rs')
    out, config = tmp_path / 'result.json', tmp_path / 'config.yaml'
    bag = tmp_path / 'images.mcap'
    simulate(SCENARIO, bag)
    config.write_text(parameter_file.dump(SCENARIO))
    assert main(['bootstrap', str(bag), '--config',
                str(config), '--out', str(out)]) == 3  # not yet
    steps = {step['step']: step for step in json.loads(out.read_text())['steps']}
    assert list(steps)[-3:] == ['bundle of the spots', 'angular distances', '16 states']
    for name, step in steps.items():
        error = np.array([step['intrinsics'][key] for key in INTRINSICS_KEYS]) - TRUTH.intrinsics
        assert error @ np.linalg.solve(step['covariance'], error) < chi2.ppf(0.9999, 7), name
    assert steps['16 states']['intrinsics_sigma']['f_mm'] < 1e-3
    assert 'spots identified' in capsys.readouterr().out


def test_numbers_of_images_are_right_and_stay_with_them(bag):
    """Also where the focal length is more wrong than was said."""
    pytest.importorskip('tetra3rs')
    truth = sensors.star_tracker(SCENARIO).next(10)
    meter = ImageMeter(SCENARIO)
    recording = RecordingStream(bag, measure=meter)
    numbered = meter.identify(recording)
    assert any('no star is identified; with 20% they are' in text for text in numbered.notices)
    again = Frames.concatenate([batch.frames for batch in recording.batches()])
    np.testing.assert_array_equal(again.catalog_id, numbered.frames.catalog_id)
    for k in range(10):
        mine, true = again[k:k + 1], truth[k:k + 1]
        place = dict(zip(true.catalog_id.tolist(), true.uv_raster))
        known = [row for row, star in enumerate(mine.catalog_id.tolist()) if star in place]
        assert len(known) > 15
        off = [mine.uv_raster[row] - place[int(mine.catalog_id[row])] for row in known]
        assert np.abs(off).max() < 1.0


def test_calibrate_identifies_the_stars_of_images(bag, tmp_path):
    pytest.importorskip('tetra3rs')
    out, config = tmp_path / 'result.json', tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO.replace({'camera.focal_length_mm': 25.55})))
    assert main(['calibrate', str(bag), '--config', str(config), '--out', str(out)]) == 3
    result = json.loads(out.read_text())
    assert result['counts']['frames'] == 10 and result['counts']['stars'] > 150
    error = np.array([result['intrinsics'][key] for key in INTRINSICS_KEYS]) - TRUTH.intrinsics
    covariance = np.array(result['covariance'])[9:, 9:]
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.9999, 7)
    assert result['intrinsics_sigma']['f_mm'] < 0.02


def test_images_in_a_recording_give_the_camera_of_a_folder(tmp_path):
    """Six stills of a real sky, with nothing but the camera stated."""
    pytest.importorskip('tetra3rs')
    if not REAL_SKY.is_dir():
        pytest.skip(f'{REAL_SKY} is not there')
    folder, path, config = tmp_path / 'six', tmp_path / 'six.mcap', tmp_path / 'config.yaml'
    folder.mkdir()
    with Writer(path) as writer:
        for k, file in enumerate(sorted(REAL_SKY.glob('tomc16/*.png'))[:6]):
            shutil.copy(file, folder)
            stamp_ns = unix_ns('2020-01-01') + k * 10**9
            writer.write('/star_tracker/image_raw', IMAGE_TYPE, encode_image(
                stamp_ns, load(file).counts.astype(np.uint16)), stamp_ns)
    config.write_text(parameter_file.dump(Scenario().replace({
        'camera.width': 808, 'camera.height': 608, 'camera.pixel_pitch_mm': 0.016,
        'camera.focal_length_mm': 52.0, 'estimator.initial_sigma.focal_length_mm': 2.0,
        'observer.velocity': 'barycentre'})))
    bagged, stills = tmp_path / 'bag.json', tmp_path / 'stills.json'
    assert main(['intrinsics', str(path), '--config', str(config), '--method', 'bundle',
                 '--out', str(bagged)]) == 4
    assert main(['intrinsics', str(folder), '--fov', '14.3', '--out', str(stills)]) == 4
    one, other = json.loads(bagged.read_text()), json.loads(stills.read_text())
    # The same spots with the same sigmas; here saturated and blended ones take part as well.
    assert one['intrinsics']['f_mm'] / 0.016 == pytest.approx(
        other['f_px'], abs=other['sigma']['f_px'])
    assert one['intrinsics_sigma']['f_mm'] * one['variance_factor']['f_mm']**0.5 < 0.006
    assert one['counts']['stars'] == pytest.approx(other['counts']['stars'], rel=0.05)
    assert one['assumed'] == []
    for name, parts in one['residual_trends'].items():
        mean, sigma, stills_mean = (
            np.array([part[key] for part in which]) for which, key in (
                (parts, 'mean_px'), (parts, 'sigma_of_mean_px'),
                (other['residual_trends'][name], 'mean_px')))
        assert np.abs(mean - stills_mean).max() < 4.0 * sigma.max(), name
    along_u = [part['mean_px'][0] for part in one['residual_trends']['pixel_u']]
    assert max(along_u) > 0.05 > -0.05 > min(along_u), 'its pixels draw the centroids'
    # Without a word on the camera they are such a folder.
    alone, page = tmp_path / 'alone.json', tmp_path / 'page.html'
    assert main(['intrinsics', str(path), '--fov', '14.3', '--out', str(alone), '--report',
                 str(page)]) == 4
    same = json.loads(alone.read_text())
    assert same['f_px'] == pytest.approx(other['f_px'], rel=1e-8)
    assert [image['image'] for image in same['images']] == [f'six.mcap[{k}]' for k in range(6)]
    assert same['images'][1]['utc'] == '2020-01-01T00:00:01'
    assert 'src="data:image/jpeg' in page.read_text()


def test_a_still_image_that_is_damaged_is_left_out_by_its_place(tmp_path, capsys):
    path, sky = tmp_path / 'two.mcap', np.full((384, 384), 100, np.uint16)
    with Writer(path) as writer:
        for k, data in enumerate((encode_image(1, sky), encode_image(2, sky)[:200])):
            writer.write('/star_tracker/image_raw', IMAGE_TYPE, data, k)
    assert main(['intrinsics', str(path), '--fov', '15']) == 1
    said = capsys.readouterr().err
    assert 'two.mcap[0]: not identified: too few spots' in said and 'two.mcap[1]: image: ' in said


def test_an_estimate_that_is_the_prior_is_said_to_be(tmp_path, capsys):
    """Spots without numbers on a camera at rest tell nothing, however wide the tolerances are."""
    path, config, out = tmp_path / 'rest.mcap', tmp_path / 'config.yaml', tmp_path / 'camera.json'
    scenario = Scenario().replace({
        'simulation.duration_s': 20.0, 'motion.dwell_s': 30.0,
        'estimator.tolerance.principal_point_px': 50.0, 'estimator.tolerance.focal_length_mm': 1.0,
        **{f'estimator.tolerance.{name}': 1.0 for name in ('k1', 'k2', 'p1', 'p2')}})
    tracker = sensors.star_tracker(scenario)
    frames = tracker.next(tracker.count)
    with Writer(path) as writer:
        writer.write_batches(centroids_batch('/star_tracker/centroids', replace(
            frames, catalog_id=np.zeros_like(frames.catalog_id))))
    config.write_text(parameter_file.dump(scenario))
    assert main(['intrinsics', str(path), '--config', str(config), '--method', 'bundle',
                 '--out', str(out)]) == 3
    result = json.loads(out.read_text())
    assert 'f_mm' in result['assumed'] and result['verdict'] == 'not yet'
    assert 'the estimate is what was assumed before the data' in capsys.readouterr().out


def test_images_without_a_star_that_is_known_say_so(tmp_path, capsys):
    pytest.importorskip('tetra3rs')
    rng = np.random.default_rng(1)
    path, config = tmp_path / 'noise.mcap', tmp_path / 'config.yaml'
    with Writer(path) as writer:
        for k in range(3):
            pixels = rng.normal(200.0, 5.0, (384, 384))
            for v, u in rng.integers(5, 379, (12, 2)):
                pixels[v - 1:v + 2, u - 1:u + 2] += 100.0
            writer.write('/star_tracker/image_raw', IMAGE_TYPE, encode_image(
                unix_ns('2020-01-01') + k * 10**9, pixels.astype(np.uint16)), k)
    config.write_text(parameter_file.dump(SCENARIO))
    assert main(['intrinsics', str(path), '--config', str(config), '--method', 'bundle']) == 1
    said = capsys.readouterr().err
    assert 'no star is identified' in said and 'match no stars of a field of' in said


def test_intrinsics_reads_images_too(bag, tmp_path, capsys):
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO))
    assert main(['intrinsics', str(bag), '--config', str(config), '--method', 'interstar']) == 1
    assert 'no camera from 10 frames with' in capsys.readouterr().err
