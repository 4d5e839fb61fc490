"""Logs for tests: real odometry with simulated sightings on top of it, and made-up topics."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from homeward.drives.drive import Odometry
from homeward.drives.ros.kinds import BEARINGS, POSE
from homeward.drives.ros.writing import writing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between
from homeward.odometry.history import dead_reckoning

NANO = 10**9
LANDMARKS = 12
SIGMA = 0.01


def real_bag(data_dir, name):
    bag = data_dir / "ros_bags_odom_only" / name
    if not bag.is_file():
        pytest.skip(f"no ros_bags_odom_only/{name} in the data folder")
    return bag


def odometry_of(bag, topic):
    """The messages of an odometry topic as rosbags' own reader has them: (receive, message)."""
    with AnyReader([bag]) as reader:
        (connection,) = [c for c in reader.connections if c.topic == topic]
        return [
            (receive, reader.deserialize(raw, connection.msgtype))
            for _, receive, raw in reader.messages([connection])
        ]


def stamp_of(message):
    return message.header.stamp.sec * NANO + message.header.stamp.nanosec


class Scene:
    """Landmarks round a path, what a camera sees of them on it, and what it saw at home."""

    def __init__(self, t, path: Pose, seed=0):
        self.rng = np.random.default_rng(seed)
        self.t, self.path = np.asarray(t), path
        self.home = Pose(float(path.x[0]), float(path.y[0]), float(path.heading[0]))
        x, y = path.x, path.y
        size = max(np.ptp(x), np.ptp(y), 2.0)
        angle = 2 * np.pi * np.arange(LANDMARKS) / LANDMARKS
        radius = size * self.rng.uniform(0.6, 1.0, LANDMARKS)
        self.x = (x.min() + x.max()) / 2 + radius * np.cos(angle)
        self.y = (y.min() + y.max()) / 2 + radius * np.sin(angle)
        self.ids = [f"mark {i}" for i in range(LANDMARKS)]
        self.at_home = self.look(self.home)

    def look(self, pose):
        """Bearings of all landmarks from a pose [rad], with noise."""
        noise = SIGMA * self.rng.standard_normal(LANDMARKS)
        return np.asarray(wrap(bearing(pose, self.x, self.y) + noise))

    def pose(self, i) -> Pose:
        """Pose number i, in the frame of the path."""
        return Pose(self.path.x[i], self.path.y[i], self.path.heading[i])

    def truth(self, i) -> Pose:
        """Pose number i in the home frame."""
        return Pose(*map(float, between(self.home, self.pose(i))))


def bearings_message(log, stamp, ids, values, sigmas=()):
    return log.make(
        BEARINGS,
        header=log.header(stamp, "camera"),
        residue=0.0,
        landmarks=list(ids),
        bearings=np.asarray(values, float),
        sigmas=np.asarray(sigmas, float),
    )


def with_sightings(bag: Path, topic: str, target: Path, every: int, until=np.inf):
    """Write a log of a real bag's odometry, and of sightings simulated along the way it tells.

    Every so many odometry messages there is a look round, over the first `until` seconds.
    The type of log is told by the target's suffix; home is where the drive begins.
    """
    met = odometry_of(bag, topic)
    met = [(r, m) for r, m in met if r - met[0][0] <= until * NANO]
    t = [stamp_of(m) / NANO for _, m in met]
    twists = np.array([(m.twist.twist.linear.x, m.twist.twist.angular.z) for _, m in met])
    scene = Scene(t, dead_reckoning(Odometry(np.array(t), *twists.T), np.array(t)))
    with writing(target) as log:
        first = stamp_of(met[0][1])
        log.write("/home_view", first, bearings_message(log, first, scene.ids, scene.at_home))
        for i, (receive, message) in enumerate(met):
            log.write(topic, receive, recoded(log, message))
            if i % every == 0:
                seen = bearings_message(
                    log, stamp_of(message), scene.ids, scene.look(scene.pose(i))
                )
                log.write("/sightings", receive, seen)
                x, y, heading = scene.truth(i)
                header = log.header(stamp_of(message), "home")
                true = log.make(POSE, header=header, residue=0.0, x=x, y=y, heading=heading)
                log.write("/true_pose", receive, true)
    return scene


def recoded(log, message):
    """The same message in the types of another log: ROS 1 numbers its headers, ROS 2 does not."""
    if not hasattr(message, "__dataclass_fields__"):
        return message
    kind = message.__msgtype__
    if kind == "std_msgs/msg/Header":
        return log.header(message.stamp.sec * NANO + message.stamp.nanosec, message.frame_id)
    fields = {
        f: recoded(log, getattr(message, f))
        for f in message.__dataclass_fields__
        if f != "__msgtype__"
    }
    return log.make(kind, **fields)
