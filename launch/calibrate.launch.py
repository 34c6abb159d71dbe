# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Calibrate your own star tracker and gyros live and record the run."""

from __future__ import annotations

from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from starcal_ros.nodes.base.launch_end import IN_PEACE, end_in_turn


def generate_launch_description() -> LaunchDescription:
    """Start the estimator and the recorder on the topics of the sensors."""
    config, namespace = LaunchConfiguration('config'), LaunchConfiguration('namespace')
    each = {'package': 'starcal_ros', 'output': 'screen', 'namespace': namespace, **IN_PEACE}
    images = LaunchConfiguration('images')

    def parameter(name: str, argument: str, kind: type) -> dict[str, ParameterValue]:
        return {name: ParameterValue(LaunchConfiguration(argument), value_type=kind)}

    common = [config, parameter('autostart', 'autostart', bool),
              parameter('use_sim_time', 'use_sim_time', bool)]
    topics = [('imu/data_raw', LaunchConfiguration('imu_topic')),
              ('star_tracker/centroids', LaunchConfiguration('centroids_topic')),
              ('star_tracker/image_raw', LaunchConfiguration('image_topic')),
              ('/tf_static', 'tf_static')]

    def estimator(condition: IfCondition | UnlessCondition, *more: dict[str, bool]) -> Node:
        return Node(executable='estimator', **each, condition=condition, remappings=topics,
                    parameters=[*common, {'estimator.wait_for_nodes': ['recorder']},
                                parameter('estimator.load_calibration', 'load_calibration', bool),
                                *more])

    nodes = [
        Node(executable='centroid_extractor', **each, condition=IfCondition(images),
             remappings=topics,
             parameters=[*common, {'centroid_extractor.wait_for_nodes': [
                 'star_identifier', 'recorder']}]),
        Node(executable='star_identifier', **each, condition=IfCondition(images),
             remappings=topics,
             parameters=[*common, {'star_identifier.wait_for_nodes': [
                 'estimator', 'recorder']}]),
        # The sigma of a centroid that is extracted holds the trail of a moving star already.
        estimator(UnlessCondition(images)),
        estimator(IfCondition(images), {'star_tracker.smear': False}),
        Node(executable='recorder', **each,
             parameters=[*common, parameter('recorder.output', 'output', str)],
             remappings=topics),
    ]
    return LaunchDescription([
        DeclareLaunchArgument(
            'config', description='Parameter file with the nominal values of your sensors'),
        DeclareLaunchArgument(
            'output', description='The recording to write', default_value='run.mcap'),
        DeclareLaunchArgument(
            'imu_topic', description='sensor_msgs/Imu of the gyros',
            default_value='imu/data_raw'),
        DeclareLaunchArgument(
            'centroids_topic', description='sensor_msgs/PointCloud2 of the star tracker',
            default_value='star_tracker/centroids'),
        DeclareLaunchArgument(
            'images', default_value='false',
            description='Whether the star tracker delivers images, whose stars are then extracted '
            'and identified'),
        DeclareLaunchArgument(
            'image_topic', description='sensor_msgs/Image of the star tracker',
            default_value='star_tracker/image_raw'),
        DeclareLaunchArgument(
            'load_calibration', default_value='false',
            description='Begin with the newest saved calibration, if there is one'),
        DeclareLaunchArgument(
            'namespace', description='Namespace of both nodes and their topics, /tf_static '
            'included', default_value=''),
        DeclareLaunchArgument(
            'use_sim_time', description='Whether the nodes live by /clock', default_value='false'),
        DeclareLaunchArgument(
            'autostart', description='Whether the nodes configure and activate themselves',
            default_value='true'),
        *nodes, end_in_turn([], nodes, spare=nodes[-1]),
    ])
