"""A simulated robot that speaks by another vendor's DDS: Eclipse Cyclone, without any ROS.

It drives in circles until it is localised, asks for the way home, and drives by cmd_vel. A line of
JSON describes its end: {"state", "distance", "poses", "transform", "twists"}.
"""

import json
import math
import sys
import time
from dataclasses import dataclass, field
from types import new_class

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from live_rig import SCENARIO

from homeward.geometry.frames import Twist as Command
from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient
from homeward.lab.simulation.simulate import load_scenario
from homeward.live.messages import (
    Answer,
    BearingsIn,
    GoHome,
    OdometryIn,
    SetHome,
    line_of,
    parse_output,
)
from homeward.live.messages import Command as Commanded

DEFAULTS = {str: "", int32: 0, uint32: 0, float64: 0.0}
COVARIANCE = array[float64, 36]


def struct(kind, **fields):
    """A message type of ROS as DDS has it; fields begin at zero, empty, or not rotated."""
    package, name = kind.split("/")
    made = {"__annotations__": fields}
    for each, of in fields.items():
        if of in DEFAULTS:
            made[each] = 1.0 if each == "w" else DEFAULTS[of]
        elif of is COVARIANCE:
            made[each] = field(default_factory=lambda: [0.0] * 36)
        else:
            made[each] = field(default_factory=of if isinstance(of, type) else list)
    typename = f"{package}::msg::dds_::{name}_"
    kind = new_class(name, (IdlStruct,), {"typename": typename}, lambda body: body.update(made))
    return final(dataclass(kind))


Time = struct("builtin_interfaces/Time", sec=int32, nanosec=uint32)
Header = struct("std_msgs/Header", stamp=Time, frame_id=str)
String = struct("std_msgs/String", data=str)
Point = struct("geometry_msgs/Point", x=float64, y=float64, z=float64)
Vector3 = struct("geometry_msgs/Vector3", x=float64, y=float64, z=float64)
Quaternion = struct("geometry_msgs/Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = struct("geometry_msgs/Pose", position=Point, orientation=Quaternion)
PoseArray = struct("geometry_msgs/PoseArray", header=Header, poses=sequence[Pose])
PoseWithCovariance = struct("geometry_msgs/PoseWithCovariance", pose=Pose, covariance=COVARIANCE)
PoseWithCovarianceStamped = struct(
    "geometry_msgs/PoseWithCovarianceStamped", header=Header, pose=PoseWithCovariance
)
Twist = struct("geometry_msgs/Twist", linear=Vector3, angular=Vector3)
TwistWithCovariance = struct(
    "geometry_msgs/TwistWithCovariance", twist=Twist, covariance=COVARIANCE
)
Odometry = struct(
    "nav_msgs/Odometry",
    header=Header,
    child_frame_id=str,
    pose=PoseWithCovariance,
    twist=TwistWithCovariance,
)
Transform = struct("geometry_msgs/Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = struct(
    "geometry_msgs/TransformStamped", header=Header, child_frame_id=str, transform=Transform
)


PARTICIPANT = DomainParticipant(int(sys.argv[1]))
OLD = Policy.DataRepresentation(use_cdrv0_representation=True)
QUALITY = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(100), OLD)


def writer(name, kind):
    return DataWriter(PARTICIPANT, Topic(PARTICIPANT, f"rt/{name}", kind, qos=QUALITY), qos=QUALITY)


def reader(name, kind):
    return DataReader(PARTICIPANT, Topic(PARTICIPANT, f"rt/{name}", kind, qos=QUALITY), qos=QUALITY)


class Robot:
    """Translates between a player and topics."""

    def __init__(self):
        scenario = SCENARIO | {"seed": 0, "landmarks.count": 12, "rates.bearings": 30.0}
        self.player = SimulatedRobotClient(
            LiveRobot(load_scenario("paper-homing", scenario)), 120.0
        )
        self.ids = {name: str(k) for k, name in enumerate(self.player.robot.world.ids)}
        self.epoch, self.asked = time.time(), False
        self.odometry, self.bearings = writer("odom", Odometry), writer("bearings", PoseArray)
        self.request = writer("homeward/request", String)
        self.said, self.twists = reader("homeward/said", String), reader("cmd_vel", Twist)
        self.poses = reader("homeward/pose", PoseWithCovarianceStamped)
        self.transforms = reader("homeward/map_to_odom", TransformStamped)
        self.heard = {"poses": 0, "twists": 0, "transform": None}

    def say(self, message):
        if isinstance(message, OdometryIn):
            header = self.header(message.t, "odom")
            result = Odometry(header=header, child_frame_id="base_link")
            result.twist.twist.linear.x, result.twist.twist.angular.z = message.v, message.omega
            self.odometry.write(result)
        elif isinstance(message, BearingsIn):
            seen = {self.ids[i]: b for i, b in message.bearings.items()}
            result = PoseArray(header=self.header(message.t, "camera"))
            for name in self.ids.values():
                there = name in seen  # at the origin: not seen
                x, y = (math.cos(seen[name]), math.sin(seen[name])) if there else (0.0, 0.0)
                result.poses.append(Pose(position=Point(x=x, y=y)))
            self.bearings.write(result)
        else:
            self.asked |= isinstance(message, GoHome)
            if isinstance(message, SetHome):
                named = {self.ids[i]: b for i, b in message.bearings.items()}
                message = SetHome(bearings=named)
            self.request.write(String(data=line_of(message).strip()))

    def header(self, t, frame):
        sec, nanosec = divmod(round((self.epoch + t) * 1e9), 10**9)
        return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame)

    def listen(self):
        for twist in self.twists.take(100):
            self.heard["twists"] += 1
            if self.asked:
                self.player.robot.command(Command(twist.linear.x, twist.angular.z), 0.2)
        for result in self.said.take(100):
            said = parse_output(result.data)
            if isinstance(said, Answer):
                self.player.on_message(said)
            elif isinstance(said, Commanded) and said.state in ("arrived", "failed"):
                self.player.ending = said
        self.heard["poses"] += len(self.poses.take(100))
        for result in self.transforms.take(100):
            self.heard["transform"] = [result.header.frame_id, result.child_frame_id]

    def drive(self):
        deadline = time.monotonic() + 30.0
        while not self.request.get_matched_subscriptions() and time.monotonic() < deadline:
            time.sleep(0.1)
        self.say(self.player.home())
        began = time.monotonic()
        while not self.player.done:
            for message in self.player.step():
                self.say(message)
            self.listen()
            time.sleep(max(began + self.player.robot.t - time.monotonic(), 0.0))
        ending = self.player.ending
        state = "time up" if ending is None else ending.state
        print(json.dumps({"state": state, "distance": self.player.robot.distance} | self.heard))


Robot().drive()
