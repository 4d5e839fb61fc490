"""Witness node: writes all received messages as JSON lines, and publishes what stdin requests.

In: {"twist": [v, omega]} until the next one, {"twist": null}, {"call": "go_home"},
{"estop": true}, {"transition": "deactivate"}, {"scan": m} until the next one,
{"start": [x, y, h]}, {"reinitialize": null}, {"name": ["store_home", "dock 3"]}.
"""

import json
import math
import sys
import threading
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    PoseArray,
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
    Twist,
)
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Empty, SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Witness(Node):
    def __init__(self):
        super().__init__("witness")
        self.twist = self.free = None
        self.scans = self.create_publisher(LaserScan, "scan", 10)
        self.starts = self.create_publisher(PoseWithCovarianceStamped, "/initialpose", 10)
        self.out = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_timer(0.05, self.drive)
        self.names = {
            what: self.create_publisher(String, f"/homeward/{what}", 10)
            for what in ("store_home", "go_home")
        }
        topics = {
            "/homeward/said": (String, lambda m: json.loads(m.data)),
            "/homeward/pose": (PoseWithCovarianceStamped, self.pose),
            "/homeward/map_to_odom": (TransformStamped, self.transform),
            "detected_dock_pose": (PoseStamped, self.dock),
            "/homeward/tag_0": (PoseWithCovarianceStamped, self.tag),
            "/homeward/sightings": (Marker, self.rays),
            "/homeward/landmarks": (MarkerArray, lambda m: len(m.markers)),
            "/diagnostics": (DiagnosticArray, lambda m: m.status[0].message),
            "bearings": (PoseArray, stamp),
            "cmd_vel": (Twist, lambda m: [m.linear.x, m.angular.z]),
        }
        try:
            from tf2_msgs.msg import TFMessage

            topics["/tf"] = (TFMessage, lambda m: self.transform(m.transforms[0]))
        except ImportError:
            pass
        for topic, (kind, read) in topics.items():
            heard = self.heard(topic, read)
            self.create_subscription(kind, topic, heard, 100)
        # As Nav2's commander subscribes to the pose of AMCL.
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        heard = self.heard("amcl_pose", self.pose)
        self.create_subscription(PoseWithCovarianceStamped, "amcl_pose", heard, latched)
        threading.Thread(target=self.listen, daemon=True).start()

    @staticmethod
    def pose(message):
        p = message.pose.pose.position
        return [p.x, p.y, message.pose.covariance[0], stamp(message)]

    @staticmethod
    def dock(message):
        p = message.pose.position
        return [p.x, p.y, message.header.frame_id]

    @staticmethod
    def tag(message):
        p, covariance = message.pose.pose.position, message.pose.covariance
        return [p.x, p.y, p.z, math.sqrt(covariance[14]), message.header.frame_id]

    @staticmethod
    def rays(message):
        p = message.pose.position
        return [p.x, p.y, len(message.points) // 2, message.header.frame_id]

    @staticmethod
    def transform(message):
        shift, turn = message.transform.translation, message.transform.rotation
        heading = 2 * math.atan2(turn.z, turn.w)
        frames = [message.header.frame_id, message.child_frame_id]
        return [*frames, shift.x, shift.y, heading, stamp(message)]

    def heard(self, topic, read):
        def hear(message):
            self.send(topic, read(message))

        return hear

    def send(self, topic, value):
        line = {"at": time.monotonic(), "topic": topic, "value": value}
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()

    def drive(self):
        if self.twist is not None:
            message = Twist()
            message.linear.x, message.angular.z = self.twist
            self.out.publish(message)
        if self.free is not None:
            scan = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.05, range_max=8.0)
            scan.ranges = [8.0, 8.0, self.free, 8.0, 8.0]
            self.scans.publish(scan)

    def listen(self):
        for line in sys.stdin:
            for what, value in json.loads(line).items():
                if what == "twist":
                    self.twist = value
                elif what == "scan":
                    self.free = value
                elif what == "start":
                    self.start(*value)
                elif what == "reinitialize":
                    self.call(Empty, "reinitialize_global_localization", Empty.Request())
                elif what == "call":
                    self.call(Trigger, f"/homeward/{value}", Trigger.Request())
                elif what == "name":
                    self.names[value[0]].publish(String(data=value[1]))
                elif what == "estop":
                    self.call(SetBool, "/homeward/estop", SetBool.Request(data=value))
                else:
                    request = ChangeState.Request()
                    request.transition.id = getattr(Transition, f"TRANSITION_{value.upper()}")
                    self.call(ChangeState, "/homeward/change_state", request)

    def start(self, x, y, heading):
        message = PoseWithCovarianceStamped()
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z = math.sin(heading / 2)
        message.pose.pose.orientation.w = math.cos(heading / 2)
        self.starts.publish(message)

    def call(self, kind, name, request):
        client = self.create_client(kind, name)
        client.wait_for_service(5.0)
        future = client.call_async(request)
        future.add_done_callback(lambda f: self.send(name, getattr(f.result(), "success", True)))


rclpy.init()
rclpy.spin(Witness())
