"""The node of homeward with one camera: ros2 launch homeward_ros homeward.launch.py."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

PARAMETERS = Path(__file__).resolve().parents[1] / "config" / "homeward.yaml"
ARGUMENTS = {
    "params_file": (str(PARAMETERS), "parameters of the node; the arguments below override them"),
    "namespace": ("", "namespace of the node"),
    "odometry_topic": ("odom", "nav_msgs/Odometry"),
    "bearings_topic": ("detections", "detections of landmarks"),
    "bearings_type": ("apriltag_msgs/msg/AprilTagDetectionArray", "their type"),
    "camera_info_topic": ("camera_info", "sensor_msgs/CameraInfo of the camera"),
    "camera_frame": ("", "frame of the camera, for its extrinsics from /tf_static"),
    "place": ("", "folder of a map that is kept between sessions"),
    "home_in_map": ("[0.0, 0.0, 0.0]", "pose of home in the map frame, from homeward place align"),
    "transform_tolerance": ("0.0", "map -> odom is stamped this much later [s]"),
    "use_sim_time": ("false", "use the clock of a simulator"),
    "autostart": ("true", "false: a lifecycle manager configures and activates the node"),
}
OF_LAUNCH = ("params_file", "namespace")


def generate_launch_description():
    """Return the node and its arguments."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = LifecycleNode(
        name="homeward",
        namespace=given["namespace"],
        package="homeward_ros",
        executable="homeward",
        parameters=[
            given["params_file"],
            {name: value for name, value in given.items() if name not in OF_LAUNCH},
        ],
        output="screen",
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, (default, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, node])
