# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a star tracker and its gyros, calibrate them live and record the run."""

from __future__ import annotations

from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from starcal_ros.nodes.base.launch_end import IN_PEACE, end_in_turn


def generate_launch_description() -> LaunchDescription:
    """Start both simulators, the estimator and the recorder on one configuration."""
    config, namespace = LaunchConfiguration('config'), LaunchConfiguration('namespace')
    each = {'package': 'starcal_ros', 'output': 'screen', 'namespace': namespace, **IN_PEACE}
    images = LaunchConfiguration('images')
    # The run begins when all listen that have to, so that none misses anything. By name: a
    # recorder of rosbag2 that was there before is a subscriber, too.
    pace = {'simulation.images': ParameterValue(images, value_type=bool),
            'simulation.wait_for_simulators': 1,
            'simulation.real_time_factor':
            ParameterValue(LaunchConfiguration('real_time_factor'), value_type=float)}

    def listeners(group: str, with_images: list[str], without: list[str]
                  ) -> dict[str, ParameterValue]:
        return {f'{group}.wait_for_nodes': ParameterValue(PythonExpression(
            [f"({with_images} if '", images, f"'.lower() in ('true', '1') else {without}) + '",
             LaunchConfiguration('wait_for'), "'.replace(',', ' ').split()"]),
            value_type=list[str])}

    def always(group: str, *names: str) -> dict[str, ParameterValue]:
        return listeners(group, [*names], [*names])

    output = {'recorder.output': ParameterValue(LaunchConfiguration('output'), value_type=str)}
    autostart = {'autostart': ParameterValue(LaunchConfiguration('autostart'), value_type=bool)}
    tf = [('/tf_static', 'tf_static')]

    def estimator(condition: IfCondition | UnlessCondition, *more: dict[str, bool]) -> Node:
        return Node(executable='estimator', **each, condition=condition, remappings=tf,
                    parameters=[config, autostart, always('estimator', 'recorder'), *more])

    others = [
        Node(executable='centroid_extractor', **each, condition=IfCondition(images),
             parameters=[config, autostart, always(
                 'centroid_extractor', 'star_identifier', 'recorder')]),
        Node(executable='star_identifier', **each, condition=IfCondition(images),
             parameters=[config, autostart, always('star_identifier', 'estimator', 'recorder')]),
        # The sigma of a centroid that is extracted holds the trail of a moving star already.
        estimator(UnlessCondition(images)),
        estimator(IfCondition(images), {'star_tracker.smear': False}),
        Node(executable='recorder', **each, parameters=[config, output, autostart], remappings=tf),
    ]
    sources = [
        Node(executable='star_tracker_sim', **each,
             parameters=[config, pace, listeners(
                 'simulation', ['centroid_extractor', 'recorder'], ['estimator', 'recorder'])]),
        Node(executable='gyro_sim', **each,
             parameters=[config, pace, listeners(
                 'simulation', ['estimator', 'star_identifier', 'recorder'],
                 ['estimator', 'recorder'])]),
    ]
    return LaunchDescription([
        DeclareLaunchArgument(
            'config', description='Parameter file of the scenario',
            default_value=PathJoinSubstitution(
                [FindPackageShare('starcal_ros'), 'config', 'tan2018.yaml'])),
        DeclareLaunchArgument(
            'output', description='The recording to write', default_value='run.mcap'),
        DeclareLaunchArgument(
            'real_time_factor', default_value='1.0',
            description='Simulated seconds a second; 0.0 is as fast as the nodes go'),
        DeclareLaunchArgument(
            'images', default_value='false',
            description='Whether the star tracker delivers images, whose stars are then extracted '
            'and identified; the recording has the images as well, 4 MB a second'),
        DeclareLaunchArgument(
            'wait_for', default_value='',
            description='Nodes beside its own that the run waits for, which listen to all topics: '
            'rosbag2_recorder, or /rosbag2_recorder from a namespace, for ros2 bag record --all'),
        DeclareLaunchArgument(
            'namespace', description='Namespace of all nodes and topics, /tf_static included',
            default_value=''),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='Whether the managed nodes configure and activate themselves'),
        DeclareLaunchArgument(
            'linger', default_value='false',
            description='Whether the nodes stay when the run is over'),
        *others, *sources,
        end_in_turn(sources, others, LaunchConfiguration('linger'), spare=others[-1]),
    ])
