# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What others draw: stars where they are on the image, residuals, numbers at their places."""

import json

import numpy as np
import pytest

from estimated import record_results
from instruments import INTRINSICS, TAN2018
from starcal_ros.cli import main
from starcal_ros.core.camera import Detector
from starcal_ros.core.statistic import Statistic
from starcal_ros.filter import verdict
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.live import display
from starcal_ros.live.display import DRAWN, ENLARGED, LAYOUT, VERDICTS
from starcal_ros.live.heard import Seen
from starcal_ros.live.recorded import moments
from starcal_ros.messages import conventions, topics
from starcal_ros.messages.drawings import LINE_LIST, SPHERE_LIST, Drawings
from starcal_ros.recording.bag import open_bag
from starcal_ros.recording.writer import TYPES, serialize, typestore

SCENARIO = TAN2018.replace({'simulation.duration_s': 20.0})
DRAWINGS = Drawings(TYPES)
STARS = np.dtype([('u', 'f8'), ('v', 'f8'), ('du', 'f8'), ('dv', 'f8'), ('nis', 'f4'),
                  ('accepted', 'u1')])
STAMP_NS = 1_782_993_600_123_456_789
FAILS, PASSES = Statistic('a', 2.0, 0.0, 1.0, 1), Statistic('a', 0.5, 0.0, 1.0, 1)


@pytest.fixture
def seen():
    """Return a moment with three stars, one of them rejected."""
    camera = DRAWINGS.camera_info(STAMP_NS, INTRINSICS, Detector(1000, 800, 0.01), 'o')
    moment = Seen(stars=np.array([(100.0, 200.0, 0.1, -0.2, 1.0, 1), (0.0, 0.0, 0.0, 0.3, 99.0, 1),
                                  (999.0, 799.0, 5.0, 0.0, 99.0, 0)], STARS),
                  stars_ns=STAMP_NS, message='not yet: u0')
    moment.take(topics.CAMERA, camera)
    return moment


def part(name, data):
    """Return the part of `values` whose label begins so."""
    begin = 0
    for label, size in LAYOUT:
        if label.startswith(name):
            return data[begin:begin + size]
        begin += size
    raise AssertionError(name)


def test_markers_are_on_the_image_of_the_calibrated_camera(seen):
    by_name = {each.ns: each for each in display.markers(DRAWINGS, seen).markers}
    assert {each.header.frame_id for each in by_name.values()} == {conventions.CALIBRATED_FRAME}
    stars, lines = by_name['stars'], by_name['residuals']
    assert (stars.type, lines.type) == (SPHERE_LIST, LINE_LIST)
    K = np.array(conventions.camera_info(INTRINSICS, Detector(1000, 800, 0.01)).K).reshape(3, 3)
    for marker, expected in ((stars, [(100, 200), (0, 0), (999, 799)]),
                             (lines, [(100, 200), (100 + 0.1 * ENLARGED, 200 - 0.2 * ENLARGED),
                                      (0, 0), (0, 0.3 * ENLARGED),
                                      (999, 799), (999 + 5.0 * ENLARGED, 799)]),
                             (by_name['detector'], [(-0.5, -0.5), (999.5, -0.5), (999.5, 799.5),
                                                    (-0.5, 799.5), (-0.5, -0.5)])):
        at = np.array([(each.x, each.y, each.z) for each in marker.points])
        np.testing.assert_allclose((at @ K.T)[:, :2], expected, atol=1e-9)
        assert (at[:, 2] == 1.0).all() and len(marker.colors) == len(marker.points)
    stamp = stars.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == STAMP_NS


def test_annotations_count_from_the_corner_of_the_image(seen):
    drawn = display.image_annotations(DRAWINGS, seen)
    assert [(each.position.x, each.position.y) for each in drawn.circles] == [
        (100.5, 200.5), (0.5, 0.5), (999.5, 799.5)]
    lines, = drawn.points
    ends = np.array([(each.x, each.y) for each in lines.points]).reshape(3, 2, 2)
    np.testing.assert_allclose(np.diff(ends, axis=1)[:, 0] / ENLARGED,
                               [(0.1, -0.2), (0.0, 0.3), (5.0, 0.0)])
    assert lines.type == 4 and len(lines.outline_colors) == 3
    assert 'not yet' in drawn.texts[0].text and f'{ENLARGED:.0f}' in drawn.texts[0].text


def test_used_odd_and_rejected_stars_have_colours_of_their_own(seen):
    circles = display.image_annotations(DRAWINGS, seen).circles
    colors = {(each.outline_color.r, each.outline_color.g) for each in circles}
    marked = display.markers(DRAWINGS, seen).markers[1].colors
    assert len(colors) == len({(each.r, each.g) for each in marked}) == 3


def test_before_anything_is_heard_drawings_are_empty_and_numbers_not_known():
    assert display.markers(DRAWINGS, Seen()).markers == []
    drawn = display.image_annotations(DRAWINGS, Seen())
    assert drawn.circles == drawn.points == drawn.texts == []
    data = display.numbers(Seen())
    assert len(data) == sum(size for _, size in LAYOUT)
    assert part('verdict', data) == part('axis', data) == part('failing', data) == [0.0]
    assert np.isnan(part('stamp', data)) and np.isnan(part('sigma', data)).all()


@pytest.mark.parametrize('word', VERDICTS)
def test_the_verdict_is_the_place_of_its_word(word):
    data = display.numbers(Seen(values={'verdict': word}))
    assert VERDICTS[int(part('verdict', data)[0])] == word


def test_every_verdict_has_a_number():
    words = {verdict.word(known, tracking, tests) for known in (False, True)
             for tracking in (False, True) for tests in ((), (FAILS,), (PASSES,))}
    assert words == set(VERDICTS[1:])


@pytest.mark.parametrize('advice, number', [
    ('rotate about Y; as it is 2 h more', 2.0), ('rotate about -Z', -3.0), ('none', 0.0)])
def test_the_axis_is_a_number_with_a_sign(advice, number):
    assert part('axis', display.numbers(Seen(values={'advice': advice}))) == [number]


def test_values_are_those_of_the_calibrator(tmp_path):
    calibrator = record_results(tmp_path / 'run.mcap', SCENARIO)
    last = list(moments(tmp_path / 'run.mcap'))[-1].seen
    data = np.array(display.values(DRAWINGS, last).data)
    sigma = calibrator.belief.sigma[CALIBRATED] / UNIT[CALIBRATED]
    tolerance = calibrator.filter.tolerance / UNIT[CALIBRATED]
    np.testing.assert_allclose(part('sigma ', data), sigma)
    np.testing.assert_allclose(part('tolerance', data), tolerance, rtol=1e-5)
    np.testing.assert_allclose(part('sigma_over', data), sigma / tolerance, rtol=1e-5)
    assert part('stars_used', data) == np.count_nonzero(last.stars['accepted'])
    assert [label.split()[1:] for label, size in LAYOUT if size == 13] == [
        list(STATE_NAMES[CALIBRATED])] * 3


# Of a recording


def test_the_drawings_of_a_recording_are_one_recording_with_it(tmp_path, capsys):
    run, out = tmp_path / 'run.mcap', tmp_path / 'drawn.mcap'
    record_results(run, SCENARIO, '/left')
    assert main(['display', str(run), '--out', str(out), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['frames'] == 40
    bag, states = open_bag(out), open_bag(run).log_times('/left/starcal/state')
    assert {(each.name, each.type, each.count) for each in bag.topics()} == {
        (f'/left{topic.recorded}', topic.type_name, 40) for topic in DRAWN}
    for topic in DRAWN:
        np.testing.assert_array_equal(bag.log_times(f'/left{topic.recorded}'), states)
    whole = list(moments(run, most=1000))
    for name, _, messages, _ in bag.messages([f'/left{topic.recorded}' for topic in DRAWN]):
        topic = next(each for each in DRAWN if name.endswith(each.recorded))
        for start, size, moment in zip(messages.start, messages.size, whole, strict=True):
            cdr = messages.data[start:start + size].tobytes()
            assert cdr == serialize(topic.type_name, DRAWN[topic](DRAWINGS, moment.seen))
            typestore().deserialize_cdr(cdr, topic.type_name)
    assert main(['display', str(run), '--out', str(out)]) == 2
    assert main(['info', str(out), '--check']) == 0
    assert main(['display', str(out), '--out', str(tmp_path / 'more.mcap')]) == 2
    assert 'has no results of an estimator' in ' '.join(capsys.readouterr().err.split())
    assert not (tmp_path / 'more.mcap').exists()
