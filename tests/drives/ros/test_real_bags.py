"""Real logs of real robots: every message read, and sightings on top of their odometry."""

import json

import numpy as np
import pytest
import yaml
from cli.commands import call, done
from drives.ros.rig import NANO, odometry_of, real_bag, stamp_of, with_sightings
from rosbags.highlevel import AnyReader

from homeward.drives.opening import open_drive
from homeward.drives.ros.log import Log

BAGS = {
    "rl_test1.bag": "/husky_velocity_controller/odom",
    "rl_test2.bag": "/jackal_velocity_controller/odom",
    "fuse_tb3.bag": "/odom",
    "nav2_turtlebot.mcap": "/odom",
}
TOPICS = {
    "bearings": {"topic": "/sightings", "sigma": 0.01},
    "home": {"topic": "/home_view"},
    "truth": {"topic": "/true_pose"},
}


@pytest.fixture(params=BAGS)
def name(request):
    return request.param


def test_every_message_is_the_one_that_rosbags_reads(data_dir, name):
    bag = real_bag(data_dir, name)
    ours = sorted(
        (m.receive, m.channel.topic, m.channel.type, bytes(m.data)) for m in Log(bag).messages()
    )
    with AnyReader([bag]) as reader:
        theirs = sorted((t, c.topic, c.msgtype, bytes(raw)) for c, t, raw in reader.messages())
    assert ours == theirs


def test_twists_and_stamps_are_those_of_the_messages(data_dir, name):
    bag = real_bag(data_dir, name)
    drive = open_drive(bag)
    met = [message for _, message in odometry_of(bag, BAGS[name])]
    met = [
        m
        for m, n in zip(met, [*met[1:], None], strict=True)
        if n is None or stamp_of(m) != stamp_of(n)
    ]
    assert drive.odometry.v.tolist() == [m.twist.twist.linear.x for m in met]
    assert drive.odometry.omega.tolist() == [m.twist.twist.angular.z for m in met]
    epoch = drive.settings.epoch or 0
    stamps = [round(t * NANO) + epoch * NANO for t in drive.odometry.t.tolist()]
    assert stamps == [stamp_of(m) for m in met]
    assert drive.home == {}
    assert not drive.sightings.t.size


@pytest.mark.parametrize("name", ["rl_test1.bag", "nav2_turtlebot.mcap"])
def test_whole_chain_on_real_odometry(data_dir, name, tmp_path):
    bag = real_bag(data_dir, name)
    # Into the other generation of ROS than it came from.
    target = tmp_path / ("log.bag" if name.endswith("mcap") else "log.mcap")
    with_sightings(bag, BAGS[name], target, every=5, until=50.0)
    topics = tmp_path / "topics.yaml"
    topics.write_text(yaml.safe_dump(TOPICS))
    words = ["run", target, "--topics", topics, "--out", tmp_path / "out"]
    done(call(*words))
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    drive = open_drive(target, topics=topics)
    size = np.hypot(np.ptp(drive.truth.x), np.ptp(drive.truth.y))
    assert metrics["position_rmse_m"] < 0.05 * max(size, 1.0)
    assert metrics["heading_rmse_rad"] < 0.03


def test_wheels_agree_with_the_odometry_made_of_them(data_dir, tmp_path):
    bag = real_bag(data_dir, "fuse_tb3.bag")
    topics = tmp_path / "topics.yaml"
    # As a TurtleBot 3 Waffle is built.
    topics.write_text("odometry: {topic: /joint_states, wheel_radius: 0.033, track_width: 0.287}\n")
    wheels, twists = open_drive(bag, topics=topics).odometry, open_drive(bag).odometry
    v = np.interp(twists.t, wheels.t, wheels.v)
    assert np.corrcoef(v, twists.v)[0, 1] > 0.9
    way = wheels.v[:-1] @ np.diff(wheels.t)
    assert way == pytest.approx(twists.v[:-1] @ np.diff(twists.t), rel=0.02)
