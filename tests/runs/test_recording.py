"""run.mcap and trajectory.tum, read back by rosbags, by Rerun and by evo."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from runs.made_up_run import MOUNTS, SETTINGS, first_rows, made_up, of_two_cameras

from homeward.drives.drive import Odometry
from homeward.drives.images import Images
from homeward.drives.settings import DriveSettings
from homeward.geometry.frames import Pose, compose
from homeward.odometry.history import dead_reckoning
from homeward.runs.report.files import write_trajectory
from homeward.runs.report.folder import write_run
from homeward.runs.report.mcap import write_recording
from homeward.runs.report.palette import BLUE, MOVED, MUTED
from homeward.runs.scoring import score

NANO = 10**9
HOSTILE = ("a/b", "", "line\nbreak", "棚🚚 <b>")
DRAWN = {
    *("sensor_msgs/msg/PointCloud2", "visualization_msgs/msg/MarkerArray"),
    *("tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped"),
}
"""What Foxglove's 3D panel draws, by its documentation."""


@pytest.fixture(scope="module")
def run():
    return made_up()


@pytest.fixture(scope="module")
def file(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "out"
    picture = folder.parent / "1.png"
    picture.write_bytes(b"\x89PNG not really")
    t = run[1].t
    write_run(folder, *run, SETTINGS, Images(t[[0, 1, 10]], [picture] * 3))
    return folder / "run.mcap"


@cache
def read(file, topic):
    """(stamp of the recorder [ns], message) of a topic, by rosbags."""
    with AnyReader([file]) as reader:
        found = [c for c in reader.connections if c.topic == topic]
        return [
            (t, reader.deserialize(raw, found[0].msgtype)) for _, t, raw in reader.messages(found)
        ]


def cloud(message):
    """Points (n, 2) of a PointCloud2 of little-endian numbers, and their colours."""
    kinds = {6: "<u4", 7: "<f4"}
    form = [(f.name, kinds[f.datatype]) for f in message.fields]
    assert [f.offset for f in message.fields] == list(range(0, message.point_step, 4))
    points = np.frombuffer(message.data.tobytes(), form)
    assert points.size == message.width
    assert (message.height, message.header.frame_id) == (1, "map")
    assert (points["color"] == points["rgb"] << 8 | 0xFF).all()
    return np.column_stack([points["x"], points["y"]]), [f"#{c:06x}" for c in points["rgb"]]


def pose(message):
    """x, y, heading of a Pose or a Transform, which must be flat."""
    place = getattr(message, "position", None) or message.translation
    turn = getattr(message, "orientation", None) or message.rotation
    assert place.z == turn.x == turn.y == 0
    return Pose(place.x, place.y, 2 * math.atan2(turn.z, turn.w))


def evo(*words, home):
    # A program of another licence, never imported; it must be there where tests are.
    beside = Path(sys.executable).parent  # the environment need not be on the PATH
    program = shutil.which(words[0], path=f"{beside}{os.pathsep}{os.environ['PATH']}")
    assert program is not None, f"{words[0]} is not installed; make dev brings it"
    env = os.environ | {"HOME": str(home), "MPLBACKEND": "agg"}
    result = subprocess.run(
        [program, *map(str, words[1:])], capture_output=True, text=True, env=env, timeout=120
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_poses_and_their_covariance(run, file):
    _, track = run
    messages = read(file, "/homeward/pose")
    rows = np.flatnonzero(track.has_pose)
    assert len(messages) == rows.size
    for row, (t, message) in zip(rows, messages, strict=True):
        stamp = message.header.stamp.sec * NANO + message.header.stamp.nanosec
        assert stamp == t
        assert stamp / NANO == track.t[row]
        assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
        there = pose(message.pose.pose)
        assert (there.x, there.y) == (track.x[row], track.y[row])
        assert math.remainder(there.heading - track.heading[row], math.tau) == pytest.approx(
            0, abs=1e-12
        )
        six = message.pose.covariance.reshape(6, 6)
        assert six[np.ix_([0, 1, 5], [0, 1, 5])].tolist() == track.covariance[row].tolist()
        assert not six[2:5].any()
    assert messages[0][1].twist.twist.linear.x == 0.4


def test_frames_chain_as_rep_105_has_them(run, file):
    drive, track = run
    transforms = [m.transforms for _, m in read(file, "/tf")]
    assert len(transforms) == track.t.size
    for row, both in enumerate(transforms):
        links = [(t.header.frame_id, t.child_frame_id) for t in both]
        with_pose = [("odom", "base_link"), ("map", "odom")]
        assert links == (with_pose if track.has_pose[row] else with_pose[:1])
        if track.has_pose[row]:
            base = compose(pose(both[1].transform), pose(both[0].transform))
            assert (base.x, base.y) == pytest.approx((track.x[row], track.y[row]), abs=1e-9)
            assert math.remainder(base.heading - track.heading[row], math.tau) == pytest.approx(
                0, abs=1e-9
            )
    rolled = dead_reckoning(drive.odometry, track.t)
    assert pose(transforms[-1][0].transform)[:2] == pytest.approx((rolled.x[-1], rolled.y[-1]))


def test_the_colour_of_a_landmark_follows_its_probability_of_having_moved(run, file):
    _, track = run
    messages = read(file, "/homeward/landmarks")
    assert [t / NANO for t, _ in messages] == track.history.t.tolist()
    points, before = cloud(messages[0][1])
    assert points == pytest.approx(np.array([[1.0, 2.0], [1.25, 2.0], [1.5, 2.0]]))  # d: no place
    _, after = cloud(messages[-1][1])
    assert before[1:] == after[1:] == [BLUE, BLUE]
    assert (before[0] != after[0], after[0]) == (True, MOVED)
    chances = [m for _, m in read(file, "/homeward/moved_probability")]
    assert chances[0].layout.dim[0].label == "a, b, c, d"
    assert [m.data[0] for m in (chances[0], chances[-1])] == [0.1, 0.999]
    names = [[m.text for m in array.markers] for _, array in read(file, "/homeward/landmark_names")]
    assert names == [["a\nmoved: 10%", "b", "c"], ["a\nmoved: 100%", "b", "c"]]


def test_rays_end_at_their_landmarks_and_vanish_without_new_sightings(run, file):
    _, track = run
    messages = read(file, "/homeward/rays")
    assert len(messages) == int(track.has_pose.sum()) + 1
    row = 100
    points, colours = cloud({t / NANO: m for t, m in messages}[track.t[row]])
    rays = points.reshape(4, -1, 2)
    here = np.array([track.x[row], track.y[row]])
    assert rays[:, 0] == pytest.approx(np.tile(here, (4, 1)), abs=1e-3)
    # The second is used, and mapped at (1.25, 2); the fourth has no position.
    reach = np.linalg.norm(rays[:, -1] - rays[:, 0], axis=1)
    assert reach[1] == pytest.approx(math.dist(here, (1.25, 2.0)), abs=2e-3)
    assert reach[3] == pytest.approx(2.0, abs=2e-3)
    assert set(colours[-24:]) == {BLUE}
    assert messages[-1][1].width == 0
    assert messages[-1][0] / NANO == pytest.approx(track.t[-1] + 0.5)
    rejected = {c for _, m in messages for c in cloud(m)[1]}
    assert rejected == {BLUE, MOVED}


def test_rays_begin_at_their_camera_and_have_its_direction(tmp_path):
    drive, track = of_two_cameras()
    write_recording(tmp_path / "run.mcap", drive, track)
    row = 100
    messages = {t / NANO: m for t, m in read(tmp_path / "run.mcap", "/homeward/rays")}
    rays = cloud(messages[track.t[row]])[0].reshape(4, -1, 2)
    robot = Pose(track.x[row], track.y[row], track.heading[row])
    front, rear = (compose(robot, mount) for mount in MOUNTS.values())
    begins = np.array([camera[:2] for camera in (front, front, rear, rear)])
    assert rays[:, 0] == pytest.approx(begins, abs=1e-3)
    along = (rays[:, -1] - rays[:, 0]).T
    ahead = np.array([camera.heading for camera in (front, front, rear, rear)])
    assert np.cos(np.arctan2(along[1], along[0]) - ahead) == pytest.approx(np.ones(4), abs=1e-5)
    ((_, fixed),) = read(tmp_path / "run.mcap", "/tf_static")
    at = {one.child_frame_id: one.transform.translation.x for one in fixed.transforms}
    assert at == {"camera": 0.3, "camera_rear": -0.2}


def test_the_robot_is_an_ellipse_of_two_sigma_with_its_heading(run, file):
    _, track = run
    messages = {t / NANO: m for t, m in read(file, "/homeward/robot")}
    assert len(messages) == track.t.size
    assert messages[track.t[0]].width == 0  # no pose yet
    points, _ = cloud(messages[track.t[100]])
    points -= [track.x[100], track.y[100]]
    assert np.linalg.norm(points[:24], axis=1) == pytest.approx(np.full(24, 0.2), abs=2e-3)
    assert np.arctan2(*points[-1][::-1]) == pytest.approx(
        math.remainder(track.heading[100], math.tau), abs=0.01
    )


def test_paths_and_series(run, file):
    _, track = run
    ((_, path),) = read(file, "/homeward/path")
    points, colours = cloud(path)
    assert len(points) == int(track.has_pose.sum())
    assert len(set(colours)) == 2
    ((_, true_path),) = read(file, "/homeward/true_path")
    assert set(cloud(true_path)[1]) == {MUTED}
    assert {tuple(m.data) for _, m in read(file, "/homeward/sigma")} == {(0.1, 0.1, 0.1)}
    errors = np.array([m.data for _, m in read(file, "/homeward/error")])
    assert errors[0] == pytest.approx([0.03, -0.04, 0.0], abs=1e-9)
    status = [m.msg for _, m in read(file, "/homeward/status")]
    assert [s.partition(":")[0] for s in status] == ["mapping", "localised", "coasting"]


def test_images_have_an_interval_of_half_a_second(run, file):
    images = read(file, "/camera/image/compressed")
    assert [t / NANO for t, _ in images] == run[1].t[[0, 10]].tolist()
    assert images[0][1].format == "png"
    assert images[0][1].data.tobytes() == b"\x89PNG not really"
    ((_, mount),) = read(file, "/tf_static")
    assert mount.transforms[0].child_frame_id == images[0][1].header.frame_id


def test_messages_are_written_in_order_of_time(file):
    with AnyReader([file]) as reader:
        stamps = [t for _, t, _ in reader.messages()]
    assert stamps == sorted(stamps)


def panels(node):
    """The panels of a Foxglove layout: a panel's name, or a direction and two layouts."""
    if isinstance(node, str):
        return [node]
    assert node.keys() - {"splitPercentage"} == {"direction", "first", "second"}
    assert node["direction"] in ("row", "column")
    return panels(node["first"]) + panels(node["second"])


def test_the_foxglove_layout_names_topics_that_its_panels_can_show(file):
    layout = json.loads((file.parent / "foxglove.json").read_text())
    assert layout.keys() == {
        *("configById", "globalVariables", "userNodes", "playbackConfig", "layout")
    }
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    with AnyReader([file]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
    for panel, config in layout["configById"].items():
        kind = panel.partition("!")[0]
        if kind == "3D":
            assert {kinds[topic] for topic in config["topics"]} <= DRAWN
            for topic, look in config["topics"].items():
                field = look.get("colorField")
                if field is not None:
                    assert field in [f.name for f in read(file, topic)[0][1].fields]
        elif kind == "Plot":
            for path in config["paths"]:
                topic, rest = re.fullmatch(r"([\w/]+)\.data\[(\d|:)\]", path["value"]).groups()
                assert kinds[topic] == "std_msgs/msg/Float64MultiArray"
                assert rest == ":" or int(rest) < read(file, topic)[0][1].data.size
        elif kind == "Image":
            topic = config["imageMode"]["imageTopic"]
            assert kinds[topic] == "sensor_msgs/msg/CompressedImage"
        else:
            shown = {
                "RosOut": "rcl_interfaces/msg/Log",
                "DiagnosticSummary": "diagnostic_msgs/msg/DiagnosticArray",
            }
            assert kinds[config["topicToRender"]] == shown[kind]


def test_rerun_shows_what_its_blueprint_names(file):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    from rerun.chunk import McapReader, RrdReader

    found = {}
    for chunk in McapReader(file).stream():
        names = chunk.to_record_batch().schema.names
        found.setdefault(chunk.entity_path, set()).update(name.split("/")[-1] for name in names)
    shown = {
        "sigma": "Scalars:scalars",
        "error": "Scalars:scalars",
        "moved_probability": "Scalars:scalars",
        "status": "TextLog:text",
    }
    clouds = ("home", "path", "true_path", "rays", "landmarks", "robot")
    for topic in clouds:
        assert {"Points3D:positions", "Points3D:color"} <= found[f"/homeward/{topic}"]
    for topic, component in shown.items():
        assert component in found[f"/homeward/{topic}"]
    assert "EncodedImage:blob" in found["/camera/image/compressed"]
    assert "Transform3D:translation" in found["/tf"]

    overridden, named = set(), set()
    views = RrdReader(file.parent / "rerun.rbl")
    (store,) = views.blueprints()
    assert store.application_id == file.stem
    for chunk in views.stream(store=store):
        overridden |= set(re.findall("/overrides(/homeward/[a-z_]+)", chunk.entity_path))
        text = str(chunk.to_record_batch().to_pylist())
        named |= set(re.findall(r"/(?:homeward|camera)/[a-z_/]+", text))
    assert overridden == {f"/homeward/{topic}" for topic in clouds}
    wanted = overridden | {f"/homeward/{topic}" for topic in shown} | {"/camera/image/compressed"}
    assert named == wanted <= found.keys()


def test_any_name_of_a_landmark_is_written(tmp_path):
    write_recording(tmp_path / "run.mcap", *made_up(HOSTILE))
    ((_, first), *_) = read(tmp_path / "run.mcap", "/homeward/landmark_names")
    assert [m.text.partition("\nmoved")[0] for m in first.markers] == list(HOSTILE[:3])


@pytest.mark.parametrize("rows", [0, 1, 20])
def test_a_run_with_little_to_show_is_written_too(tmp_path, rows):
    drive, track = made_up(truth=False)
    write_recording(tmp_path / "run.mcap", drive, first_rows(track, rows))
    assert len(read(tmp_path / "run.mcap", "/homeward/home")) == (rows > 0)


def test_status_is_written_when_it_changes_and_each_second(run, file):
    messages = read(file, "/diagnostics")
    reported = [m.status[0].message.partition(":")[0] for _, m in messages]
    assert [reported[0], reported[-1]] == ["mapping", "coasting"]
    assert {m.status[0].level for _, m in messages} == {0, 1}
    assert np.diff([t for t, _ in messages]).max() <= 1.1 * NANO
    assert "3 are needed" in messages[0][1].status[0].message


def test_evo_computes_the_same_error(run, file, tmp_path):
    drive, track = run
    ours = score(track, drive.truth).as_dict()["position_rmse_m"]
    reported = evo("evo_ape", "mcap", file, "/homeward/truth", "/homeward/pose", home=tmp_path)
    assert float(re.search(r"rmse\s+(\S+)", reported)[1]) == pytest.approx(ours, rel=1e-3)
    listed = evo("evo_traj", "mcap", file, "/homeward/pose", "/homeward/truth", home=tmp_path)
    assert f"{int(track.has_pose.sum())} poses" in listed


def test_evo_reads_the_trajectory(run, file, tmp_path):
    drive, track = run
    write_trajectory(tmp_path / "trajectory.tum", track)
    truth = tmp_path / "truth.tum"
    rows = zip(drive.truth.t, drive.truth.x, drive.truth.y, drive.truth.heading, strict=True)
    truth.write_text(
        "".join(
            f"{t!r} {x} {y} 0 0 0 {math.sin(h / 2)} {math.cos(h / 2)}\n"
            for t, x, y, h in (map(float, row) for row in rows)
        )
    )
    reported = evo("evo_ape", "tum", truth, tmp_path / "trajectory.tum", home=tmp_path)
    assert float(re.search(r"rmse\s+(\S+)", reported)[1]) == pytest.approx(0.05, rel=1e-6)


def test_times_count_from_the_epoch_of_the_log(tmp_path):
    drive, track = made_up(seconds=4.0)
    settings = DriveSettings(epoch=400_000_000)
    write_recording(
        tmp_path / "run.mcap", type(drive)(**{**vars(drive), "settings": settings}), track
    )
    _, message = read(tmp_path / "run.mcap", "/homeward/pose")[0]
    assert message.header.stamp.sec == int(track.t[track.has_pose][0]) + 400_000_000
    write_trajectory(tmp_path / "trajectory.tum", track, epoch=400_000_000)
    first = (tmp_path / "trajectory.tum").read_text().split()[0]
    assert first == repr(float(track.t[track.has_pose][0])).replace("12482", "16482", 1)


def test_dead_reckoning_round_a_circle():
    t = np.arange(0.0, 10.0, 0.1)
    odometry = Odometry(t, np.full(t.size, 0.5), np.full(t.size, 0.25))
    # A radius of 2 m, to the left; between stamps too, and held for 1 s after the last.
    asked = np.array([-1.0, 0.0, 0.05, 3.33, 9.9, 10.9, 20.0])
    angle = 0.25 * np.clip(asked, 0.0, 10.9)
    there = dead_reckoning(odometry, asked)
    assert there.x == pytest.approx(2 * np.sin(angle))
    assert there.y == pytest.approx(2 * (1 - np.cos(angle)))
    assert there.heading == pytest.approx(angle)
