"""homeward and a map server in place of AMCL: ros2 launch homeward_ros nav2.launch.py map:=FILE.

The arguments of homeward.launch.py apply too. Nav2 itself is started by its navigation_launch.py.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, SetRemap

HOMEWARD = Path(__file__).resolve().with_name("homeward.launch.py")
ARGUMENTS = {
    "map": {"description": "YAML file of the occupancy map"},
    "namespace": {"default_value": "", "description": "namespace of all nodes"},
    "use_sim_time": {"default_value": "", "description": "true: use the clock of a simulator"},
}
TOPICS = {"~/pose": "amcl_pose", "/tf": "tf", "/tf_static": "tf_static"}
MANAGER = {
    "autostart": True,
    "node_names": ["map_server", "homeward"],
    "bond_timeout": 0.0,  # the node of homeward has no bond
}


def generate_launch_description():
    """Return the nodes and their arguments."""
    arguments = [DeclareLaunchArgument(name, **words) for name, words in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context):
    """Return homeward, the map server and their lifecycle manager."""
    namespace, clock = LaunchConfiguration("namespace"), {}
    if (given := LaunchConfiguration("use_sim_time")).perform(context):
        clock["use_sim_time"] = given
    homeward = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(HOMEWARD)),
        launch_arguments=[("autostart", "false")],  # the manager activates it
    )
    remaps = [SetRemap(src=source, dst=to) for source, to in TOPICS.items()]
    map_server = Node(
        package="nav2_map_server",
        executable="map_server",
        name="map_server",
        namespace=namespace,
        parameters=[{"yaml_filename": LaunchConfiguration("map"), **clock}],
        output="screen",
    )
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_localization",
        namespace=namespace,
        parameters=[MANAGER | clock],
        output="screen",
    )
    return [GroupAction([*remaps, homeward]), map_server, manager]
