"""Everything that the node publishes."""

from __future__ import annotations

from typing import Any

from homeward.drives.ros.messages.stamps import NANO
from homeward.geometry.frames import Pose
from homeward.live.messages import Answer, Command, Diagnostics, LandmarksOut, Output, line_of
from homeward.ros import conversions as convert
from homeward.ros.conversions import JSON, TFS

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class Publishers:
    """The publishers of a lifecycle node, whose parameters name topics and frames."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._out: dict[str, Any] = {}

    def make(self) -> None:
        """Make them; `ImportError` where the package of a message is missing."""
        make = self._node.create_lifecycle_publisher
        stamped = "Stamped" if self._told("cmd_vel_stamped") else ""
        topics = {
            "said": (JSON, "~/said"),
            "pose": (POSE, "~/pose"),
            "diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics"),
            "landmarks": ("visualization_msgs/msg/MarkerArray", "~/landmarks"),
            "cmd_vel": (f"geometry_msgs/msg/Twist{stamped}", self._told("cmd_vel_topic")),
            "transform": ("geometry_msgs/msg/TransformStamped", "~/map_to_odom"),
        }
        self._out = {
            key: make(convert.message_class(kind), topic, 10)
            for key, (kind, topic) in topics.items()
        }
        try:
            self._out["tf"] = make(convert.message_class(TFS), "/tf", 10)
        except ImportError:
            words = "no tf2_msgs here: map to odom is on ~/map_to_odom alone"
            self._node.get_logger().warning(words)

    def destroy(self) -> None:
        """Destroy them."""
        for publisher in self._out.values():
            self._node.destroy_publisher(publisher)
        self._out = {}

    def output(self, said: Output, epoch_ns: int) -> None:
        """Publish what a session says, poses and landmarks as messages of their own, too.

        The stamps of `said` are those of ROS less an epoch [ns].
        """
        self._line(said)
        if isinstance(said, Answer) and said.pose is not None:
            message = convert.message_class(POSE)()
            message.header.frame_id = self._told("map_frame")
            stamp = divmod(round(said.t * NANO) + epoch_ns, NANO)
            message.header.stamp.sec, message.header.stamp.nanosec = stamp
            convert.fill_pose(message.pose.pose, Pose(*said.pose))
            convert.fill_covariance(message.pose, said)
            self._out["pose"].publish(message)
        if isinstance(said, LandmarksOut):
            markers = convert.markers_out(said, self._now(), self._told("map_frame"))
            self._out["landmarks"].publish(markers)

    def command(self, command: Command) -> None:
        """Publish a command, without a stamp or with one."""
        stamped = self._told("cmd_vel_stamped")
        message = convert.message_class(f"geometry_msgs/msg/Twist{'Stamped' * stamped}")()
        if stamped:
            message.header.stamp = self._now()
        twist = message.twist if stamped else message
        twist.linear.x, twist.angular.z = float(command.v), float(command.omega)
        self._out["cmd_vel"].publish(message)
        self._line(command)

    def transform(self, map_to_odom: Pose) -> None:
        """Publish where the odometry frame lies on the map."""
        frames = self._told("map_frame"), self._told("odom_frame")
        message = convert.transform(self._now(), *frames, map_to_odom)
        self._out["transform"].publish(message)
        if "tf" in self._out:
            self._out["tf"].publish(convert.message_class(TFS)(transforms=[message]))

    def diagnostics(self, said: Diagnostics) -> None:
        """Publish how everything is."""
        self._out["diagnostics"].publish(convert.diagnostics_out(said, self._now()))
        self._line(said)

    def _line(self, said: Output) -> None:
        """Publish what is said as one line of JSON."""
        self._out["said"].publish(convert.message_class(JSON)(data=line_of(said).rstrip()))

    def _told(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()
