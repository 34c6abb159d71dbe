# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recording of what an estimator publishes, made without ROS 2."""

from starcal_ros.filter import verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import STATE_NAMES, UNIT
from starcal_ros.messages import cdr_results, topics
from starcal_ros.recording.writer import Writer, serialize, typestore
from starcal_ros.simulation import sensors


def record_results(path, scenario, namespace=''):
    """Write state, camera, residuals and diagnostics of a run; return its calibrator."""
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    with Writer(path) as writer:
        for number, frame in enumerate(calibrator.process()):
            stamp_ns, belief = frame.stamp_ns, frame.belief
            messages = {topics.STATE: cdr_results.encode_state(stamp_ns, belief),
                        topics.CAMERA: cdr_results.encode_camera(
                            stamp_ns, belief.estimate.intrinsics, calibrator.filter.detector),
                        topics.RESIDUALS: cdr_results.encode_residuals(frame)}
            if number % 2 == 0:
                messages[topics.DIAGNOSTICS] = serialize(
                    topics.DIAGNOSTICS.type_name, _diagnostics(calibrator, number))
            for delay_ns, (topic, message) in enumerate(messages.items()):
                writer.write(namespace + topic.recorded, topic.type_name, message,
                             stamp_ns + delay_ns)
    return calibrator


def _diagnostics(calibrator, number):
    types = typestore().types
    judged = verdict.of(calibrator)
    values = {'verdict': judged.word, 'advice': judged.advice, 'frames': str(number + 1)}
    values |= {f'sigma_{name}': f'{sigma:.6g}' for name, sigma in zip(
        STATE_NAMES, calibrator.belief.sigma / UNIT)}
    values |= {f'tolerance_{state.name}': f'{state.tolerance:.6g}' for state in judged.states}
    status = types['diagnostic_msgs/msg/DiagnosticStatus'](
        level=0, name='starcal: calibration', message=judged.summary, hardware_id='star_tracker',
        values=[types['diagnostic_msgs/msg/KeyValue'](key=key, value=value)
                for key, value in values.items()])
    header = types['std_msgs/msg/Header'](
        stamp=types['builtin_interfaces/msg/Time'](sec=0, nanosec=0), frame_id='')
    return types[topics.DIAGNOSTICS.type_name](header=header, status=[status])
