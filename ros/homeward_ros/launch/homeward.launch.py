"""The node of homeward: ros2 launch homeward_ros homeward.launch.py.

An argument that is given overrides params_file, which overrides config/apriltag.yaml.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

DEFAULTS = Path(__file__).resolve().parents[1] / "config" / "apriltag.yaml"
ARGUMENTS = {
    "params_file": "parameters of the node, as config/homeward.yaml",
    "namespace": "namespace of the node",
    "odometry_topic": "nav_msgs/Odometry",
    "bearings_topic": "detections of landmarks",
    "bearings_type": "their type",
    "camera_info_topic": "sensor_msgs/CameraInfo of the camera",
    "camera_frame": "frame of the camera, for its extrinsics from /tf_static",
    "topics": "of several cameras: a topics file, such as config/cameras.yaml",
    "place": "folder of a map that is kept between sessions",
    "home_in_map": "[x, y, heading] of home in the map frame, from homeward place align",
    "use_sim_time": "true: use the clock of a simulator",
    "autostart": "false: a lifecycle manager configures and activates the node",
}


def generate_launch_description():
    """Return the node and its arguments."""
    arguments = [
        DeclareLaunchArgument(name, default_value="", description=words)
        for name, words in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=node)])


def node(context):
    """Return the node with the arguments that are given."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    given = {name: value for name, value in given.items() if value.perform(context)}
    namespace, file = given.pop("namespace", ""), given.pop("params_file", None)
    return [
        LifecycleNode(
            name="homeward",
            namespace=namespace,
            package="homeward_ros",
            executable="homeward",
            parameters=[str(DEFAULTS), *filter(None, (file, given))],
            output="screen",
        )
    ]
