"""run.mcap and trajectory.tum, read back by rosbags and by evo."""

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from report.made_up_run import made_up
from rosbags.highlevel import AnyReader

from homeward.drives.drive import DriveSettings, Odometry
from homeward.frames import Pose, compose
from homeward.odometry.dead_reckoning import dead_reckoning
from homeward.report.files import write_trajectory
from homeward.report.palette import BLUE, MOVED
from homeward.report.run.mcap import write_recording
from homeward.scoring import score

NANO = 10**9


@pytest.fixture(scope="module")
def run():
    return made_up()


@pytest.fixture(scope="module")
def file(run, tmp_path_factory):
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    write_recording(file, *run)
    return file


def read(file, topic):
    """(stamp of the recorder [ns], message) of a topic, by rosbags."""
    with AnyReader([file]) as reader:
        found = [c for c in reader.connections if c.topic == topic]
        return [
            (t, reader.deserialize(raw, found[0].msgtype)) for _, t, raw in reader.messages(found)
        ]


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
    assert program is not None, f"{words[0]} is not installed; make install brings it"
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


def test_landmarks_that_moved_have_another_colour(file):
    ((_, array),) = read(file, "/homeward/landmarks")
    spheres = [m for m in array.markers if m.ns == "landmarks"]
    names = [m.text for m in array.markers if m.ns == "names"]
    assert names == ["a", "b", "c", "d"]
    colours = [
        "#{:02x}{:02x}{:02x}".format(*(round(255 * getattr(m.color, c)) for c in "rgb"))
        for m in spheres
    ]
    assert colours == [MOVED, BLUE, BLUE, BLUE]
    assert len({(m.ns, m.id) for m in array.markers}) == 8


def test_status_is_told_when_it_changes_and_each_second(run, file):
    messages = read(file, "/diagnostics")
    told = [m.status[0].message.partition(":")[0] for _, m in messages]
    assert [told[0], told[-1]] == ["mapping", "coasting"]
    assert {m.status[0].level for _, m in messages} == {0, 1}
    assert np.diff([t for t, _ in messages]).max() <= 1.1 * NANO
    assert "3 are needed" in messages[0][1].status[0].message


def test_evo_finds_the_error_that_we_tell(run, file, tmp_path):
    drive, track = run
    ours = score(track, drive.truth).as_dict()["position_rmse_m"]
    told = evo("evo_ape", "mcap", file, "/homeward/truth", "/homeward/pose", home=tmp_path)
    assert float(re.search(r"rmse\s+(\S+)", told)[1]) == pytest.approx(ours, rel=1e-3)
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
    told = evo("evo_ape", "tum", truth, tmp_path / "trajectory.tum", home=tmp_path)
    assert float(re.search(r"rmse\s+(\S+)", told)[1]) == pytest.approx(0.05, rel=1e-6)


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
