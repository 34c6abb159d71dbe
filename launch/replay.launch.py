# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Play a recording back and calibrate from it as if it were live."""

from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from starcal_ros.nodes.base.launch_end import IN_PEACE, end_in_turn


def generate_launch_description() -> LaunchDescription:
    """Start the player and the estimator, which ends when the recording does."""
    config, namespace = LaunchConfiguration('config'), LaunchConfiguration('namespace')
    each = {'package': 'starcal_ros', 'output': 'screen', 'namespace': namespace, **IN_PEACE}
    # The replay begins when the estimator listens, so that it misses nothing.
    playback = {'player.wait_for_nodes': ['estimator'], 'player.rename': True, **{
        f'player.{name}': ParameterValue(LaunchConfiguration(argument), value_type=kind)
        for name, argument, kind in (
            ('bag', 'bag', str), ('rate', 'rate', float), ('loop', 'loop', bool),
            ('start_offset_s', 'start_offset', float),
            *((name, name, str) for name in (
                'recorded_namespace', 'imu_topic', 'centroids_topic', 'image_topic')))}}
    time = {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)}
    autostart = {'autostart': ParameterValue(LaunchConfiguration('autostart'), value_type=bool)}
    others = [
        Node(executable='estimator', **each,
             parameters=[config, time, autostart], remappings=[('/tf_static', 'tf_static')]),
    ]
    sources = [
        Node(executable='player', **each, parameters=[config, playback]),
    ]
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='rosbag2 directory or .mcap file'),
        DeclareLaunchArgument(
            'config', description='Parameter file with the nominal values of the sensors'),
        DeclareLaunchArgument(
            'rate', default_value='1.0',
            description='Recorded seconds a second; 0.0 is as fast as the estimator goes'),
        DeclareLaunchArgument(
            'start_offset', description='Seconds to leave out at the beginning',
            default_value='0.0'),
        DeclareLaunchArgument(
            'loop', default_value='false',
            description='Begin again at the end; the estimator then starts again as well'),
        DeclareLaunchArgument(
            'use_sim_time', description='Whether the estimator lives by the /clock of the player',
            default_value='true'),
        DeclareLaunchArgument(
            'recorded_namespace', default_value='',
            description='Namespace of the topics in the recording; left out, any that it has'),
        DeclareLaunchArgument(
            'imu_topic', default_value='',
            description='The gyros in the recording; left out, the only ones that it has'),
        DeclareLaunchArgument(
            'centroids_topic', default_value='',
            description='The centroids in the recording; left out, the only ones that it has'),
        DeclareLaunchArgument(
            'image_topic', default_value='',
            description='The images in the recording; left out, the only ones that it has'),
        DeclareLaunchArgument(
            'namespace', description='Namespace of both nodes and their topics, /tf_static '
            'included', default_value=''),
        DeclareLaunchArgument(
            'autostart', description='Whether the estimator configures and activates itself',
            default_value='true'),
        DeclareLaunchArgument(
            'linger', default_value='false',
            description='Whether the nodes stay when the replay is over'),
        *others, *sources, end_in_turn(sources, others, LaunchConfiguration('linger')),
    ])
