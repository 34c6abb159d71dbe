# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files: what the shipped one holds, the round trip, and each refusal."""

import re

import numpy as np
import pytest
import yaml

from instruments import EXTERNAL
from starcal_ros.config import models, parameter_file, rcl_yaml
from starcal_ros.config.instrument import CameraConfig, MotionConfig, MountingConfig
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, from_flat, parameters, stamp_ns
from starcal_ros.config.shipped import config_file
from starcal_ros.config.truth import TrueCameraConfig
from starcal_ros.core import rotation
from starcal_ros.core.units import ARCSEC

HEAD = '/**:\n  ros__parameters:\n'


@pytest.fixture(scope='module')
def tan2018():
    return parameter_file.load(config_file('tan2018.yaml'))


def changed(tan2018):
    """Return a scenario that differs from the defaults in values of every type."""
    return tan2018.replace({'estimator.feedback': False, 'simulation.seed': 2**53,
                            'recorder.topics': ('imu/data_raw',), 'recorder.output': 'no',
                            'motion.rate_deg_s': 1e-3, 'camera.distortion': (1e-4, -1e-7, 0., 0.),
                            'estimator.initial_sigma.k2': 1e-12})


# The scenario of T18

@pytest.mark.parametrize('key, value', [
    ('camera.width', 1024), ('camera.height', 1024), ('camera.pixel_pitch_mm', 6.45e-3),
    ('truth.camera.principal_point_px', (5.0, 10.0)), ('truth.camera.focal_length_mm', 25.6),
    ('truth.camera.distortion', (2e-4, -1e-6, 2e-5, 2e-5)),
    ('star_tracker.centroid_sigma_px', 0.05), ('star_tracker.exposure_s', 0.18),
    ('star_tracker.rate_hz', 2.0), ('gyro.rate_hz', 100.0), ('gyro.arw_deg_sqrt_h', 0.001),
    ('truth.gyro.bias_deg_h', (0.01, 0.01, 0.01)),
    ('truth.mounting.fixed_angles_deg', (-0.1, 30.0, 359.8)),
])
def test_shipped_scenario_holds_table_1_of_T18(tan2018, key, value):
    assert tan2018.flat()[key] == value


def test_shipped_scenario_holds_table_2_of_T18(tan2018):
    assert tan2018.motion.axes == ('x', 'y', 'z', 'z', 'y', 'x')
    assert tan2018.motion.angles_deg == (30.0, 30.0, 30.0, -30.0, -30.0, -30.0)


def test_nominal_mounting_is_the_truth_turned_by_table_1s_fixed_angle_errors(tan2018):
    """T18 Eq. 8, estimate = (I + [Psi x]) truth, with [100, 200, 300] arcsec."""
    C_nominal = models.mounting_matrix(tan2018.mounting)
    C_true = models.mounting_matrix(tan2018.truth.mounting)
    np.testing.assert_allclose(rotation.log(C_nominal @ C_true.T) / ARCSEC, [100.0, 200.0, 300.0],
                               atol=1e-3)


def test_shipped_files_are_read_alike_by_ros(tan2018):
    """ROS 2 reads a bare y or n as a bool, PyYAML as a string: nowhere may one stand."""
    for text in (config_file('tan2018.yaml').read_text(), parameter_file.dump(tan2018)):
        bare = [event.value for event in yaml.parse(text)
                if isinstance(event, yaml.ScalarEvent) and event.style is None]
        assert '1024' in bare
        assert not {'y', 'Y', 'n', 'N'} & set(bare)


@pytest.mark.parametrize('shipped', [True, False], ids=['shipped', 'dumped'])
def test_ros_reads_a_parameter_file(tan2018, tmp_path, shipped):
    rclpy = pytest.importorskip('rclpy')
    path = tmp_path / 'scenario.yaml'
    path.write_text(config_file('tan2018.yaml').read_text() if shipped
                    else parameter_file.dump(changed(tan2018)))
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    context.shutdown()


@pytest.mark.skipif(not EXTERNAL.exists(), reason='the recording of others is not here')
def test_the_configuration_of_another_recording_is_read():
    external = parameter_file.load(EXTERNAL / 'config.yaml')
    assert external.mounting.quaternion_xyzw[3] == -0.9660380223439142
    assert external.motion == MotionConfig()


# Reading and writing

def test_what_is_dumped_is_parsed_to_the_same_scenario(tan2018):
    written = changed(tan2018)
    again = parameter_file.parse(parameter_file.dump(written), 'x')
    assert again == written
    assert again.sha256 == written.sha256


def test_what_is_left_out_takes_its_default():
    assert parameter_file.parse(HEAD + '    camera: {width: 640}', 'x') == (
        Scenario(camera=CameraConfig(width=640)))


@pytest.mark.parametrize('text, value', [
    ('1.0e-3', 1e-3), ('.5', 0.5), ('2.', 2.0), ('1e-3', 1e-3), ('5e1', 50.0)])
def test_a_number_that_ros_takes_for_a_double_is_a_float(text, value):
    """The forms of YAML 1.2 and of ROS 2's own reader."""
    read = parameter_file.parse(f'{HEAD}    gyro: {{arw_deg_sqrt_h: {text}}}', 'x')
    assert read.gyro.arw_deg_sqrt_h == value


def test_one_value_changes_the_hash(tan2018):
    assert tan2018.replace({'simulation.seed': 2}).sha256 != tan2018.sha256
    assert tan2018.replace({'simulation.seed': 1}).sha256 == tan2018.sha256


def test_every_parameter_is_explained():
    for key, parameter in parameters().items():
        assert len(parameter.spec.text) > 3, key
        assert parameter.spec.text[0].isupper(), key


def test_every_number_has_a_range_that_its_default_lies_in():
    for key, parameter in parameters().items():
        if parameter.element in (int, float):
            assert np.isfinite([parameter.spec.low, parameter.spec.high]).all(), key
        parameter.check(key, parameter.default)


def test_numbers_of_numpy_are_numbers(tan2018):
    given = {'gyro.rate_hz': np.float64(200.0), 'simulation.seed': np.int64(3),
             'gyro.bias_deg_h': np.array([1.0, 2.0, 3.0]), 'motion.angles_deg': [
                 np.float64(value) for value in tan2018.motion.angles_deg]}
    found = tan2018.replace(given)
    assert type(found.gyro.rate_hz) is float and type(found.simulation.seed) is int
    assert found.gyro.bias_deg_h == (1.0, 2.0, 3.0) and found == tan2018.replace({
        'gyro.rate_hz': 200.0, 'simulation.seed': 3, 'gyro.bias_deg_h': (1.0, 2.0, 3.0)})
    assert {type(value) for value in found.motion.angles_deg} == {float}
    with pytest.raises(ConfigError, match='needs a int'):
        tan2018.replace({'simulation.seed': np.float64(3.0)})


def test_a_dotted_name_is_the_path_to_its_field(tan2018):
    for key, value in tan2018.flat().items():
        field = tan2018
        for name in key.split('.'):
            field = getattr(field, name)
        assert field == value


# What is refused

@pytest.mark.parametrize('lines, message', [
    ('camera: {focal_lenght_mm: 25.0}',
     'camera.focal_lenght_mm: unknown parameter; did you mean camera.focal_length_mm?'),
    ('qwertyuiop: 1', 'qwertyuiop: unknown parameter'),
    ('centroid_sigma_px: 0.1', 'centroid_sigma_px: unknown parameter; did you mean '
     'star_tracker.centroid_sigma_px or truth.star_tracker.centroid_sigma_px?'),
    ('trackr: {centroid_sigma_px: 0.1}',
     'trackr.centroid_sigma_px: unknown parameter; did you mean '
     'star_tracker.centroid_sigma_px?'),
    ('camera: 5', 'camera: unknown parameter'),
    ('gyro: {rate_hz: 100}', 'gyro.rate_hz: got 100 (int), needs a float; write 100.0'),
    ('camera: {width: 1024.0}', 'camera.width: got 1024.0 (float), needs a int'),
    ('camera: {width: true}', 'camera.width: got True (bool), needs a int'),
    ('estimator: {feedback: 1}', 'estimator.feedback: got 1 (int), needs a bool'),
    ('gyro: {rate_hz: fast}', "gyro.rate_hz: got 'fast' (str), needs a float"),
    ('gyro: {rate_hz: [100.0]}', 'gyro.rate_hz: got [100.0] (list), needs a float'),
    ('gyro: {rate_hz: null}', "gyro.rate_hz: got 'null' (str), needs a float"),
    ('camera: {distortion: 0.0}', 'camera.distortion: got 0.0, needs a list of float'),
    ('camera: {distortion: [0, 0, 0, 0]}',
     'camera.distortion: got 0 (int), needs a float; write 0.0'),
    ('camera: {distortion: [0.0]}', 'camera.distortion: got 1 values, needs 4'),
    ('camera: {distortion: [0.0, 0.0, 2.0, 0.0]}',
     'camera.distortion: got 2.0, allowed is -1 to 1 mm^-2, mm^-4, mm^-1, mm^-1'),
    ('camera: {width: 8}', 'camera.width: got 8, allowed is 16 to 65536 px'),
    ('gyro: {rate_hz: .nan}', 'gyro.rate_hz: got nan, allowed is 1 to 10000 Hz'),
    ('gyro: {rate_hz: .inf}', 'gyro.rate_hz: got inf, allowed is 1 to 10000 Hz'),
    ('truth: {gyro: {bias_deg_h: [.nan, 0.0, 0.0]}}',
     'truth.gyro.bias_deg_h: got nan, allowed is -1e+06 to 1e+06 deg/h'),
    ('observer: {velocity: moon}', "observer.velocity: got 'moon', allowed are 'barycentre', "
     "'geocentre', 'orbit'"),
    ("motion: {axes: ['x', 'w'], angles_deg: [1.0, 1.0]}",
     "motion.axes: got 'w', allowed are 'x', 'y', 'z'"),
    ("motion: {axes: ['x'], angles_deg: [1.0, 1.0]}",
     'motion.angles_deg: got 2 angles for 1 axes, needs as many, and at least one'),
    ('motion: {axes: []}', 'motion.axes: an empty list has no type in ROS 2, leave it out'),
    ('gyro: {rate_hz: }', 'gyro.rate_hz: no value in line 3'),
    ('gyro: {rate_hz: 1:40.0}', "gyro.rate_hz: got '1:40.0' (str), needs a float"),
    ('gyro: {rate_hz: 1_00.0}', "gyro.rate_hz: got '1_00.0' (str), needs a float"),
    ('mounting: {quaternion_xyzw: [0.0, 0.0, 0.0, 0.9]}',
     'mounting.quaternion_xyzw: got norm 0.9, a quaternion has norm 1'),
    ('truth: {mounting: {quaternion_xyzw: [0.0, 0.0, 0.0, 0.0]}}',
     'truth.mounting.quaternion_xyzw: got norm 0, a quaternion has norm 1'),
    ('motion: {initial_quaternion_xyzw: [1.0, 0.0, 0.0, 1.0]}',
     'motion.initial_quaternion_xyzw: got norm 1.41421356, a quaternion has norm 1'),
    ('mounting: {quaternion_xyzw: [0.0, 0.0, 0.0, 1.0], fixed_angles_deg: [0.0, 0.0, 0.0]}',
     'mounting: fixed_angles_deg and quaternion_xyzw are both given, one is allowed'),
    ("simulation: {start_utc: '2 July 2026'}",
     "simulation.start_utc: got '2 July 2026', needs an ISO 8601 time such as "
     '2026-07-02T12:00:00'),
    ("observer: {epoch_utc: ''}", "observer.epoch_utc: got '', needs an ISO 8601 time such as"),
])
def test_an_error_names_the_source_the_key_the_value_and_what_is_allowed(lines, message):
    with pytest.raises(ConfigError) as error:
        parameter_file.parse(f'{HEAD}    {lines}', 'my.yaml')
    assert str(error.value).startswith(f'my.yaml: {message}')


def test_a_motion_that_takes_no_time_is_refused():
    with pytest.raises(ConfigError, match='motion'):
        parameter_file.parse(
            HEAD + "    motion: {axes: ['x'], angles_deg: [0.0], dwell_s: 0.0}", 'x')


@pytest.mark.parametrize('text', ['', 'a: 1', '[1, 2]', '3', '/**: {}', '/**: [1]',
                                  '/**:\n  ros__parameters:', '/**:\n  ros__parameters: 3'])
def test_a_file_of_another_kind_is_named(text):
    with pytest.raises(ConfigError, match='^my.yaml: not a ROS 2 parameter file, needs "/'):
        parameter_file.parse(text, 'my.yaml')


def test_broken_yaml_is_named_with_its_line():
    with pytest.raises(ConfigError, match='^my.yaml, line 3: not YAML: '):
        parameter_file.parse(HEAD + ' - 1\n', 'my.yaml')


def test_a_missing_file_is_named(tmp_path):
    path = tmp_path / 'none.yaml'
    with pytest.raises(ConfigError) as error:
        parameter_file.load(path)
    assert str(error.value) == f'{path}: cannot be read: No such file or directory'


def test_a_directory_is_named(tmp_path):
    with pytest.raises(ConfigError) as error:
        parameter_file.load(tmp_path)
    assert str(error.value) == f'{tmp_path}: cannot be read: Is a directory'


@pytest.mark.parametrize('content', [b'\x89PNG\r\n\x1a\n\xff\xfe', b'\x89MCAP0\r\n', b'a\x00b'],
                         ids=['png', 'mcap', 'nul'])
def test_a_binary_file_is_named(tmp_path, content):
    path = tmp_path / 'image'
    path.write_bytes(content)
    with pytest.raises(ConfigError) as error:
        parameter_file.load(path)
    assert str(error.value).startswith(str(path))


def test_a_shipped_file_that_is_not_there_is_named():
    with pytest.raises(FileNotFoundError, match='^none.yaml is not beside '):
        config_file('none.yaml')


def test_all_errors_of_a_file_are_said_at_once():
    with pytest.raises(ConfigError) as error:
        parameter_file.parse("""/**:
  ros__parameters:
    camera: {focal_lenght_mm: 25.0, width: 8}
    gyro: {rate_hz: 100}
    gyro:
      arw_deg_sqrt_h: 0.01
    mounting: {quaternion_xyzw: [0.0, 0.0, 0.0, 0.9]}
    motion: {axes: ['x', 'w'], angles_deg: [1.0]}
    intrinsics: {estimate: []}
""", 'my.yaml')
    head, *lines = str(error.value).split('\n')
    assert head == 'my.yaml: 7 errors:'
    for line, start in zip(lines, (         # not that there is one angle for six axes
            'gyro: given twice, in line 4 and line 5', 'intrinsics.estimate: an empty list',
            'camera.focal_lenght_mm: unknown parameter; did you mean camera.focal_length_mm?',
            'camera.width: got 8', 'gyro.rate_hz: got 100', "motion.axes: got 'w'",
            'mounting.quaternion_xyzw: got norm 0.9'), strict=True):
        assert line.startswith(f'  {start}')


def test_an_empty_list_is_a_list_where_that_is_the_default():
    """As in what `ros2 param dump` writes; elsewhere a node would take it for its default."""
    text = """/estimator:
  ros__parameters:
    estimator:
      adapt: []
      wait_for_nodes: []
    gyro:
      rate_hz: 50.0
"""
    text += text.replace('/estimator', '/other')
    assert parameter_file.parse(text, '').flat() == Scenario().replace(
        {'gyro.rate_hz': 50.0}).flat()
    with pytest.raises(ConfigError, match='estimator.adapt: an empty list has no type'):
        parameter_file.parse(HEAD + "    estimator: {adapt: ['arw']}\n" + text, '')


@pytest.mark.parametrize('text, said', [
    (HEAD + '    gyro.rate_hz: 1.0\n    gyro: {rate_hz: 2.0}', 'gyro.rate_hz: given twice in /**'),
    (HEAD + '    gyro: {rate_hz: 1.0, rate_hz: 1.0}',
     'gyro.rate_hz: given twice, in line 3 and line 3'),
    (HEAD + '    autostart: true\n' + HEAD + '    autostart: true', '/**: given twice, in line 1'),
    ('/estimator: {ros__parameters: {autostart: true}}\n'
     'estimator: {ros__parameters: {autostart: true}}',
     '/estimator: a section that is given twice'),
    (HEAD + '    autostart: &a true\n    estimator: {feedback: *a}', 'ROS 2 takes no alias (*a)'),
    (HEAD + '    camera: [{width: 1}]', 'camera: a list may hold nothing but values'),
    (HEAD + '    autostart: true\nest*: {ros__parameters: {}}', "'est*' is no name of a node"),
    (HEAD + '    autostart: true\nother: 3', 'line 4: not a ROS 2 parameter file')])
def test_what_would_be_passed_over_is_an_error(text, said):
    with pytest.raises(ConfigError) as error:
        parameter_file.parse(text, 'my.yaml')
    assert said in str(error.value)


# As a node reads it

SECTIONS = {
    'later': '/**: 1\n/estimator: 2', 'earlier': '/estimator: 2\n/**: 1', 'bare': 'estimator: 3',
    'other': '/**: 1\n/gyro_sim: 2', 'namespace': '/**: 1\n/ns/estimator: 2',
    'any': '/**/estimator: 2', 'one': '/**: 1\n/*/estimator: 2', 'node': '/**: 1\n/*: 2',
    'both': '/**: 1\n/*/*: 2', 'within': '/**: 1\n/ns/**: 2',
    'end': '/**: 1\n---\n/ns/estimator: 2',
    'deep': '/**: 1\n/ns/**/estimator: 2', 'nested': '/**: 1\nns: {estimator: 2}'}


@pytest.mark.parametrize('namespace', ['/', '/ns', '/ns/part'])
@pytest.mark.parametrize('sections', SECTIONS.values(), ids=SECTIONS.keys())
def test_sections_are_for_the_node_that_ros_gives_them_to(tmp_path, sections, namespace):
    text = re.sub(r': (\d)', r': {ros__parameters: {gyro: {rate_hz: \1.0}}}', sections)
    read = parameter_file.read(text, 'x', namespace=namespace).scenario
    assert read == from_flat(overrides(tmp_path, text, namespace))


@pytest.mark.parametrize('scalar', [
    '1', '1.0', '1e3', '-.5', '+.5', '1_000', '1_00.0', '1:40', '1:40.0', '0x1F', '0b101', '017',
    '0o17', '08', '.inf', '-.INF', 'inf', '.NaN', 'true', 'tRUE', 'Yes', 'y', 'N', 'off', 'null',
    '~', '2001-12-14', '1e400', '1e-400', '9223372036854775807', '9223372036854775808', '0x1.8p3',
    '1.5.2', '=', '<<', '1 2', '"1"', "'yes'", '!!str 1', '!!float 1', '|-\n      1.5'])
def test_a_scalar_has_the_type_that_ros_gives_it(tmp_path, scalar):
    text = f'{HEAD}    a: {scalar}\n'
    (section,), errors = rcl_yaml.read(text)
    ours, theirs = section.values['a'], overrides(tmp_path, text)['a']
    assert not errors and type(ours) is type(theirs)
    assert ours == theirs or ours != ours and theirs != theirs


def overrides(folder, text, namespace='/'):
    """Return the parameters that a node named estimator is given, by dotted name."""
    rclpy = pytest.importorskip('rclpy')
    path, context = folder / 'file.yaml', rclpy.Context()
    path.write_text(text)
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    try:
        node = rclpy.create_node('estimator', context=context, namespace=namespace)
        return {name: given.value for name, given in node._parameter_overrides.items()}
    finally:
        context.shutdown()


def test_the_namespace_is_that_of_the_only_section_with_the_name():
    text = '/**: {ros__parameters: {}}\n/a/estimator: {ros__parameters: {autostart: false}}\n'
    reading = parameter_file.read(text, 'my.yaml')
    assert not reading.scenario.autostart
    assert 'my.yaml is read for /a/estimator' in reading.notices
    text += '/b/estimator: {ros__parameters: {autostart: true}}\n'
    with pytest.raises(ConfigError, match='in the namespaces /a, /b; --namespace tells which'):
        parameter_file.read(text, 'my.yaml')
    assert parameter_file.read(text, 'my.yaml', namespace='b').scenario.autostart


@pytest.mark.parametrize('section, said', [
    ('/*/estimator', 'the section /*/estimator is not for /estimator; --namespace'),
    ('/estimater', 'the section /estimater is not read; did you mean estimator?'),
    ('/gyro_sim', None), ('/camera_driver', None)])
def test_a_section_that_was_meant_and_is_not_read_is_said(section, said):
    text = f'{HEAD}    mounting: {{fixed_angles_deg: [0.0, 0.0, 0.0]}}\n'
    notices = parameter_file.read(
        f'{text}{section}: {{ros__parameters: {{autostart: true}}}}', 'x').notices
    assert [said is not None and said in text for text in notices] == ([True] if said else [])


# Time and mounting

@pytest.mark.parametrize('text, seconds', [
    ('1970-01-01', 0.0), ('1970-01-02T00:00:00', 86400.0), ('2001-09-09T01:46:40', 1e9),
    ('1970-01-01T01:00:00+01:00', 0.0), ('1969-12-31T23:59:59.5', -0.5),
    ('1970-01-01T00:00:00Z', 0.0), ('1970-01-01T00:00:00.25Z', 0.25),
    ('1970-01-01T01:00:00.1234567+01:00', 0.123456)])
def test_a_stamp_is_unix_time_in_utc(text, seconds):
    assert stamp_ns('key', text) == round(seconds * 1e9)


def test_a_mounting_is_the_same_by_quaternion_and_by_fixed_angles():
    angles = models.mounting_matrix(MountingConfig(fixed_angles_deg=(0.0, 90.0, 0.0)))
    quaternion = models.mounting_matrix(
        MountingConfig(quaternion_xyzw=(0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))))
    np.testing.assert_allclose(angles, quaternion, atol=1e-15)
    np.testing.assert_allclose(angles @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-15)


def test_the_norm_of_a_quaternion_does_not_turn_the_mounting(tan2018):
    """A norm that the check lets pass, 1 + 9e-7, is taken off; it is not part of the angle."""
    q = np.array(tan2018.mounting.quaternion_xyzw)
    q /= np.linalg.norm(q)
    unit, long = (models.mounting_matrix(MountingConfig(
        quaternion_xyzw=tuple((scale * q).tolist()))) for scale in (1.0, 1.0 + 9e-7))
    np.testing.assert_allclose(long, unit, atol=1e-14)


def test_what_the_truth_leaves_out_is_nominal():
    nominal = CameraConfig(principal_point_px=(1.0, 2.0), focal_length_mm=30.0,
                           distortion=(1e-4, 0.0, 0.0, 1e-5))
    instead = TrueCameraConfig(focal_length_mm=31.0)
    np.testing.assert_array_equal(models.intrinsics(nominal, instead),
                                  [1.0, 2.0, 31.0, 1e-4, 0.0, 0.0, 1e-5])
    np.testing.assert_array_equal(models.intrinsics(nominal),
                                  [1.0, 2.0, 30.0, 1e-4, 0.0, 0.0, 1e-5])
