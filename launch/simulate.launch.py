"""Simulate a star tracker and its gyros, calibrate them live and record the run."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start both simulators, the estimator and the recorder on one configuration."""
    config, namespace = LaunchConfiguration('config'), LaunchConfiguration('namespace')
    # The run begins when estimator and recorder listen, so that neither misses anything.
    pace = {'simulation.wait_for_subscribers': 2, 'simulation.real_time_factor':
            ParameterValue(LaunchConfiguration('real_time_factor'), value_type=float)}
    output = {'recorder.output': ParameterValue(LaunchConfiguration('output'), value_type=str)}
    autostart = {'autostart': ParameterValue(LaunchConfiguration('autostart'), value_type=bool)}
    tf = [('/tf_static', 'tf_static')]
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
            'namespace', description='Namespace of all nodes and topics, /tf_static included',
            default_value=''),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='Whether estimator and recorder configure and activate themselves'),
        Node(package='starcal_ros', executable='recorder', output='screen', namespace=namespace,
             parameters=[config, output, autostart], remappings=tf, on_exit=Shutdown()),
        Node(package='starcal_ros', executable='estimator', output='screen', namespace=namespace,
             parameters=[config, autostart, {'estimator.wait_for_subscribers': 1}],
             remappings=tf),
        Node(package='starcal_ros', executable='star_tracker_sim', output='screen',
             namespace=namespace, parameters=[config, pace]),
        Node(package='starcal_ros', executable='gyro_sim', output='screen', namespace=namespace,
             parameters=[config, pace]),
    ])
