"""A simulated robot as a node of ROS 2: odometry and bearings out, cmd_vel in.

`python robot_node.py SEED [EPOCH]`; with an EPOCH [s] it is the simulator whose clock all go by.
Its base stops without a command for 0.2 s, as a real one must.
It writes a line of JSON a period: t, true distance from home, speed; "move" on stdin moves L1.
"""

import json
import math
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import Pose, PoseArray, TransformStamped, Twist
from live_rig import SCENARIO
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from homeward.geometry.frames import Pose as Planar
from homeward.geometry.frames import Twist as Command
from homeward.geometry.frames import advance, compose
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.simulate import load_scenario


class RobotNode(Node):
    def __init__(self, seed, epoch=None, **more):
        super().__init__("robot")
        more = {"seed": seed, "landmarks.count": 12, "rates.bearings": 30.0} | more
        self.robot = LiveRobot(load_scenario("paper-homing", SCENARIO | more))
        self.rolled = Planar(0.0, 0.0, 0.0)
        self.epoch = time.time() if epoch is None else epoch
        self.clock = None if epoch is None else self.create_publisher(Clock, "/clock", 10)
        self.odometry = self.create_publisher(Odometry, "odom", 10)
        self.bearings = self.create_publisher(PoseArray, "bearings", 10)
        self.create_subscription(Twist, "cmd_vel", self.command, 1)  # the newest alone counts
        self.say_where_the_camera_sits()
        self.create_timer(self.robot.period, self.step)
        threading.Thread(target=self.listen, daemon=True).start()

    def say_where_the_camera_sits(self):
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            return
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.static = self.create_publisher(TFMessage, "/tf_static", latched)
        there = TransformStamped()
        there.header.frame_id, there.child_frame_id = "base_link", "camera"
        sits = self.robot.drive.settings.sensor
        there.transform.translation.x, there.transform.translation.y = sits.x, sits.y
        there.transform.rotation.z = math.sin(sits.yaw / 2)
        there.transform.rotation.w = math.cos(sits.yaw / 2)
        self.static.publish(TFMessage(transforms=[there]))

    def listen(self):
        for line in sys.stdin:
            if line.strip() == "move":
                self.robot.move_landmark("L01", 0.4, 0.3)

    def command(self, message):
        self.robot.command(Command(message.linear.x, message.angular.z), 0.2)

    def step(self):
        before = self.robot.pose
        sensed = self.robot.step()
        stamp = round((self.epoch + sensed.t) * 1e9)
        if self.clock is not None:
            now = Clock()
            now.clock.sec, now.clock.nanosec = divmod(stamp, 10**9)
            self.clock.publish(now)
        message = Odometry()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.twist.twist.linear.x = sensed.twist.v
        message.twist.twist.angular.z = sensed.twist.omega
        message.pose.pose.position.x = float(self.rolled.x)
        message.pose.pose.position.y = float(self.rolled.y)
        message.pose.pose.orientation.z = math.sin(self.rolled.heading / 2)
        message.pose.pose.orientation.w = math.cos(self.rolled.heading / 2)
        step = advance(Planar(0.0, 0.0, 0.0), sensed.twist, self.robot.period)
        self.rolled = compose(self.rolled, step)
        self.odometry.publish(message)
        if sensed.seen is not None:
            self.look(message.header.stamp, sensed.seen, before)
        moved = math.hypot(self.robot.pose.x - before.x, self.robot.pose.y - before.y)
        line = {"t": sensed.t, "distance": self.robot.distance, "v": moved / self.robot.period}
        print(json.dumps(line), flush=True)

    def look(self, stamp, seen, pose):
        array = PoseArray()
        array.header.stamp, array.header.frame_id = stamp, "camera"
        for name in self.robot.world.ids:
            pose = Pose()  # at the origin: not seen
            if name in seen:
                pose.position.x = math.cos(seen[name])
                pose.position.y = math.sin(seen[name])
            array.poses.append(pose)
        self.bearings.publish(array)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(RobotNode(int(sys.argv[1]), *map(float, sys.argv[2:])))
