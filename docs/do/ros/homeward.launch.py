from pathlib import Path

from launch import LaunchDescription
from launch_ros.actions import LifecycleNode


def generate_launch_description():
    node = LifecycleNode(
        name="homeward",
        namespace="",
        package=None,
        executable="python3",
        arguments=["-m", "homeward.ros"],
        parameters=[str(Path(__file__).with_name("homeward.yaml"))],
        output="screen",
    )
    return LaunchDescription([node])
