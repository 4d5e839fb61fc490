"""The node of homeward with several cameras: ros2 launch homeward_ros cameras.launch.py."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

CONFIG = Path(__file__).resolve().parents[1] / "config"
ARGUMENTS = {
    "params_file": (
        str(CONFIG / "homeward.yaml"),
        "parameters of the node; the arguments below override them",
    ),
    "topics": (str(CONFIG / "cameras.yaml"), "topics file: a topic for each camera"),
    "bearings_type": ("apriltag_msgs/msg/AprilTagDetectionArray", "type of all these topics"),
    "odometry_topic": ("odom", "nav_msgs/Odometry"),
    "place": ("", "folder of a map that is kept between sessions"),
    "use_sim_time": ("false", "use the clock of a simulator"),
}


def generate_launch_description():
    """Return the node and its arguments."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = LifecycleNode(
        name="homeward",
        namespace="",
        package="homeward_ros",
        executable="homeward",
        parameters=[
            given["params_file"],
            {name: value for name, value in given.items() if name != "params_file"},
        ],
        output="screen",
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, (default, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, node])
