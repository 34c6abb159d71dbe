"""Calibrate your own star tracker and gyros live and record the run."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Start the estimator and the recorder on the topics of the sensors."""
    config = LaunchConfiguration('config')
    output = {'recorder.output': ParameterValue(LaunchConfiguration('output'), value_type=str)}
    sensors = [('imu/data_raw', LaunchConfiguration('imu_topic')),
               ('star_tracker/centroids', LaunchConfiguration('centroids_topic'))]
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
        Node(package='starcal_ros', executable='recorder', output='screen',
             parameters=[config, output], remappings=sensors, on_exit=Shutdown()),
        Node(package='starcal_ros', executable='estimator', output='screen',
             parameters=[config], remappings=sensors),
    ])
