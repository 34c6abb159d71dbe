"""Play a recording back and calibrate from it as if it were live."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Start the player and the estimator, which stays to answer when the recording ends."""
    config = LaunchConfiguration('config')
    playback = {'player.bag': ParameterValue(LaunchConfiguration('bag'), value_type=str),
                'player.rate': ParameterValue(LaunchConfiguration('rate'), value_type=float)}
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='rosbag2 directory or .mcap file'),
        DeclareLaunchArgument(
            'config', description='Parameter file with the nominal values of the sensors'),
        DeclareLaunchArgument(
            'rate', description='Recorded seconds a second', default_value='1.0'),
        Node(package='starcal_ros', executable='estimator', output='screen',
             parameters=[config]),
        Node(package='starcal_ros', executable='player', output='screen',
             parameters=[config, playback]),
    ])
