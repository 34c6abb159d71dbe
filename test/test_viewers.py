# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The layouts for other people's viewers name topics, fields and indices that there are."""

import json
import re
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
from rosbags.interfaces import Nodetype
import yaml

from instruments import TAN2018, TOP
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import CALIBRATED, N_STATES, STATE_NAMES
from starcal_ros.live.display import LAYOUT
from starcal_ros.messages import topics
from starcal_ros.messages.conventions import CALIBRATED_FRAME, GYRO_FRAME, STATE_LAYOUT
from starcal_ros.recording.writer import typestore

VIEWERS = TOP / 'config' / 'viewers'
TOPICS = {'/' + topic.name.lstrip('/'): topic for topic in topics.TOPICS}
RVIZ_TYPES = {'MarkerArray': topics.MARKERS.type_name,
              'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
              'Image': 'sensor_msgs/msg/Image'}
COVARIANCE = 1 + N_STATES       # its first element in the data of starcal/state


def field_type(name, path):
    """Return the description of a field of a message type, along a path such as pose.k[3]."""
    kind = Nodetype.NAME, name
    for word, index in re.findall(r'(\w+)(?:\[(\d+)\])?', path):
        kind = dict(typestore().fielddefs[kind[1]][1])[word]
        if index:
            assert kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE), path
            kind, length = kind[1]
            assert int(index) < length or not length, path      # 0 is of any length
    return kind


def assert_plottable(topic, path):
    """Check that a topic has a field, and that it is a number or a text."""
    assert field_type(TOPICS[topic].type_name, path)[0] == Nodetype.BASE, (topic, path)


def calibration_status():
    """Return the diagnostics that an estimator without a namespace publishes."""
    from rclpy.clock import Clock

    from starcal_ros.nodes.estimator_diagnostics import Diagnostics
    node = SimpleNamespace(get_namespace=lambda: '/', get_clock=Clock)
    return Diagnostics(node, []).message(Calibrator(TAN2018), enabled=True).status[0]


def state_of(index):
    """Return the name of the state whose value or variance `starcal/state` has at an index."""
    assert 0 < index < sum(size for _, size in STATE_LAYOUT)
    if index < COVARIANCE:
        return STATE_NAMES[index - 1], False
    row, column = divmod(index - COVARIANCE, N_STATES)
    assert row == column, 'a covariance, not a variance'
    return STATE_NAMES[row], True


# Foxglove, Lichtblick


@pytest.fixture(scope='module')
def foxglove():
    return json.loads((VIEWERS / 'foxglove.json').read_text())


def paths(layout):
    """Return topic, field, function and panel title of each path of a layout."""
    for panel in layout['configById'].values():
        for path in panel.get('paths', []):
            if re.fullmatch(r'[\d.]+', path['value']):     # a line at a number
                continue
            plain = re.sub(r'\[:\]\{.*\}', '[0]', path['value'])       # one that is picked
            topic, field, function = re.fullmatch(
                r'(/[\w/]+)\.([\w.\[\]]+?)(?:\.@(\w+))?', plain).groups()
            yield topic, field, function, path['label'], panel.get('title', '')


def test_foxglove_layout_shows_each_of_its_panels_once(foxglove):
    def leaves(node):
        if isinstance(node, str):
            return [node]
        assert node['direction'] in ('row', 'column') and 0 < node['splitPercentage'] < 100
        return leaves(node['first']) + leaves(node['second'])
    assert sorted(leaves(foxglove['layout'])) == sorted(foxglove['configById'])


@pytest.fixture(scope='module')
def schema():
    return json.loads((TOP / 'test' / 'foxglove_layout.schema.json').read_text())


def test_foxglove_layout_is_what_its_panels_take(foxglove, schema):
    jsonschema = pytest.importorskip('jsonschema')
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(foxglove, schema)


@pytest.mark.parametrize('spoil', [
    lambda panels: panels['Plot!rate']['paths'][0].pop('enabled'),
    lambda panels: panels['Plot!rate'].update(xAxisVal='time'),
    lambda panels: panels['Plot!rate'].update(minY=0),
    lambda panels: panels['Image!stars']['imageMode'].update(image='/star_tracker/image_raw'),
    lambda panels: panels['3D!stars']['cameraState'].update(target=[0, 0]),
    lambda panels: panels['3D!stars'].update(topics=['/starcal/display/markers']),
    lambda panels: panels['DiagnosticStatusPanel!verdict'].pop('topicToRender'),
    lambda panels: panels.update({'Plots!rate': {}})])
def test_what_a_foxglove_panel_does_not_take_is_found(foxglove, schema, spoil):
    jsonschema = pytest.importorskip('jsonschema')
    spoilt = json.loads(json.dumps(foxglove))
    spoil(spoilt['configById'])
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(spoilt, schema)


def test_foxglove_draws_topics_of_the_types_that_its_panels_draw(foxglove):
    image, scene = (foxglove['configById'][name] for name in ('Image!stars', '3D!stars'))
    mode = image['imageMode']
    assert TOPICS[mode['imageTopic']] == topics.IMAGES
    assert TOPICS[mode['calibrationTopic']] == topics.CAMERA
    assert [TOPICS[name] for name in mode['annotations']] == [topics.ANNOTATIONS]
    assert [TOPICS[name] for name in scene['topics']] == [topics.MARKERS]
    assert scene['followTf'] == CALIBRATED_FRAME


def test_foxglove_plots_of_values_are_what_their_labels_say(foxglove):
    names = [f'{words[0]} {name}' if size > 2 else name for words, size in (
        (label.split(), size) for label, size in LAYOUT)
             for name in (words[1:] if size > 2 else words)]
    shown = {}
    for topic, field, _, label, _ in paths(foxglove):
        if TOPICS[topic] == topics.VALUES:
            shown[label] = names[int(re.fullmatch(r'data\[(\d+)\]', field)[1])]
    assert shown == {'verdict': 'verdict', 'failing_tests': 'failing_tests', **{
        name: f'sigma_over_tolerance {name}' for name in STATE_NAMES[CALIBRATED]}}


def test_foxglove_paths_are_fields_of_topics(foxglove):
    for topic, field, _, _, _ in paths(foxglove):
        assert_plottable(topic, field)


def test_foxglove_state_paths_are_the_states_of_their_labels(foxglove):
    found = set()
    for topic, field, function, label, title in paths(foxglove):
        if topic == '/starcal/state':
            name, is_variance = state_of(int(re.fullmatch(r'data\[(\d+)\]', field)[1]))
            assert name in (label, f'psi_{label}')
            assert is_variance == (function == 'sqrt') == title.startswith('Sigma')
            found.add((name, is_variance))
    assert found >= {(name, sigma) for name in ('u0', 'v0', 'f') for sigma in (False, True)}


def test_foxglove_shows_the_diagnostics_that_the_estimator_publishes(foxglove):
    status = calibration_status()
    panel = foxglove['configById']['DiagnosticStatusPanel!verdict']
    assert panel == {'topicToRender': '/diagnostics', 'selectedHardwareId': status.hardware_id,
                     'selectedName': status.name}
    # Other nodes publish diagnostics, too: their messages are no verdicts.
    verdict, = foxglove['configById']['StateTransitions!verdict']['paths']
    assert verdict['value'] == f'/diagnostics.status[:]{{name=="{status.name}"}}.message'


# PlotJuggler


@pytest.fixture(scope='module')
def plotjuggler():
    return ElementTree.parse(VIEWERS / 'plotjuggler.xml').getroot()


def assert_series(name):
    """Check a series as PlotJuggler names it: the topic and the path to the field, by slashes."""
    if name.startswith('/diagnostics/'):
        status = calibration_status()
        values = {item.key: item.value for item in status.values}
        prefix, key = name.rsplit('/', 1)
        assert prefix == f'/diagnostics/{status.hardware_id}/{status.name}'
        float(values[key])
    else:
        topic = max((topic for topic in TOPICS if name.startswith(topic + '/')), key=len)
        assert_plottable(topic, name[len(topic) + 1:].replace('/', '.'))


def test_plotjuggler_curves_are_fields_of_topics_or_equations_of_such(plotjuggler):
    equations = {snippet.get('name') for snippet in plotjuggler.iter('snippet')}
    curves = {curve.get('name') for curve in plotjuggler.iter('curve')}
    assert equations < curves
    for name in curves - equations:
        assert_series(name)
    for snippet in plotjuggler.iter('snippet'):
        sources = snippet.findtext('linked_source'), snippet.findtext('additional_sources/v1')
        for source in filter(None, sources):
            assert_series(source)


def test_plotjuggler_equations_take_the_states_of_their_names(plotjuggler):
    """`u0 + 3 sigma [px]` takes the value and the variance of u0, `sigma psi_x` a variance."""
    for snippet in plotjuggler.iter('snippet'):
        name, function = snippet.get('name'), snippet.findtext('function')
        first, *more = [state_of(int(re.fullmatch(r'/starcal/state/data\[(\d+)\]', text)[1]))
                        for text in (snippet.findtext('linked_source'),
                                     snippet.findtext('additional_sources/v1')) if text]
        state = first[0].replace('psi_', 'fixed angle ') if 'angle' in name else first[0]
        assert re.search(rf'\b{state}\b', name)
        assert first[1] == name.startswith('sigma') == ('sqrt(value)' in function)
        assert ('3 sigma' in name) == ('sqrt(v1)' in function)
        assert more == ([(first[0], True)] if '3 sigma' in name else [])


def test_plotjuggler_splits_add_up(plotjuggler):
    for split in plotjuggler.iter('DockSplitter'):
        sizes = [float(size) for size in split.get('sizes').split(';')]
        assert len(split) == int(split.get('count')) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)


# RViz


def test_rviz_displays_show_topics_of_their_type_with_matching_durability():
    manager = yaml.safe_load((VIEWERS / 'starcal.rviz').read_text())['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == GYRO_FRAME
    shown = [display for display in manager['Displays'] if 'Topic' in display]
    assert {display['Class'].split('/')[1] for display in shown} == {*RVIZ_TYPES}
    for display in shown:
        topic = TOPICS[display['Topic']['Value']]
        assert topic.type_name == RVIZ_TYPES[display['Class'].split('/')[1]]
        assert display['Topic']['Durability Policy'] == (
            'Transient Local' if topic.latched else 'Volatile')
