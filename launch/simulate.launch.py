"""Simulate a star tracker and its gyros, calibrate them live and record the run."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start both simulators, the estimator and the recorder on one configuration."""
    config = LaunchConfiguration('config')
    # The run begins when estimator and recorder listen, so that neither misses anything.
    pace = {'simulation.wait_for_subscribers': 2, 'simulation.real_time_factor':
            ParameterValue(LaunchConfiguration('real_time_factor'), value_type=float)}
    output = {'recorder.output': ParameterValue(LaunchConfiguration('output'), value_type=str)}
    return LaunchDescription([
        DeclareLaunchArgument(
            'config', description='Parameter file of the scenario',
            default_value=PathJoinSubstitution(
                [FindPackageShare('starcal_ros'), 'config', 'tan2018.yaml'])),
        DeclareLaunchArgument(
            'output', description='The recording to write', default_value='run.mcap'),
        DeclareLaunchArgument(
            'real_time_factor', description='Simulated seconds a second', default_value='1.0'),
        Node(package='starcal_ros', executable='recorder', output='screen',
             parameters=[config, output], on_exit=Shutdown()),
        Node(package='starcal_ros', executable='estimator', output='screen',
             parameters=[config]),
        Node(package='starcal_ros', executable='star_tracker_sim', output='screen',
             parameters=[config, pace]),
        Node(package='starcal_ros', executable='gyro_sim', output='screen',
             parameters=[config, pace]),
    ])
