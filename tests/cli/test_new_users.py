"""What new users typed in their first hour: each answer is a command that works."""

import dataclasses
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import call, done, first_seconds, refused

from homeward.cli.drives.run import again, run_settings
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.topics.choosing import draft_of
from homeward.drives.ros.topics.survey import Topic
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.io import naming
from homeward.io.settings import parse_yaml, validated


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The first 20 seconds of the sample drive in the folder in which commands run."""
    monkeypatch.chdir(tmp_path)
    first_seconds(tmp_path / "mine", 20.0)
    return tmp_path


def test_paths_in_the_current_folder_are_shown_as_typed(here):
    assert str(InputError("no", here / "a.csv")) == "a.csv: no"
    assert str(InputError("no", Path("/elsewhere/a.csv"))) == "/elsewhere/a.csv: no"
    assert naming.command("run", here / "out" / "mine") == "homeward run out/mine"
    assert refused(call("run", "min")).endswith("no such file or folder; did you mean mine?")


def test_the_next_command_keeps_home_and_leads_to_the_robot_file(here):
    (here / "mine" / "home.csv").rename(here / "dock.csv")
    result = done(call("run", "mine", "--home", "dock.csv"))
    following = result.stdout.splitlines()[-1].removeprefix("Next: homeward ")
    assert following == "tune mine --home dock.csv"
    tuned = call(*shlex.split(following))  # it finds home, and the drive is too short
    assert "mine: its first half has 76 sightings" in tuned.stderr
    settings = run_settings("mine", {"home_at": 3.0})
    again_with = again("run", settings, "--robot-file", "robot.yaml")
    assert again_with == "homeward run mine --home at:3 --robot-file robot.yaml"


def test_a_program_outside_the_path_is_named_as_it_was_called(here, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(sys, "argv", [str(here / ".venv-demo/bin/homeward"), "run", "sample"])
    assert naming.command("tune", "sample") == ".venv-demo/bin/homeward tune sample"


def test_a_home_next_to_a_log_is_proposed(here):
    drive = dataclasses.replace(open_drive(here / "mine"), home={})
    save_drive(drive, here / "log.mcap")
    shutil.move(here / "mine" / "home.csv", here / "home.csv")
    following = done(call("info", "log.mcap")).stdout.splitlines()[-1]
    assert following == "Next: homeward run log.mcap --home home.csv"


def test_the_command_for_the_tables_of_this_folder_names_it(here, monkeypatch):
    (here / "tables").mkdir()
    shutil.copy(here / "mine" / "odometry.csv", here / "tables" / "wheels.csv")
    monkeypatch.chdir(here / "tables")
    assert "`homeward import wheels.csv --out out/tables`" in refused(call("info", "."))


def test_the_next_command_of_a_log_at_rest_can_be_typed_as_it_is(here):
    drive = open_drive(here / "mine")
    rest = dataclasses.replace(drive.odometry, v=0 * drive.odometry.v, omega=0 * drive.odometry.v)
    save_drive(dataclasses.replace(drive, home={}, odometry=rest), here / "log.mcap")
    following = done(call("info", "log.mcap")).stdout.splitlines()[-1]
    assert re.fullmatch(r"Next: homeward run log\.mcap --home during:0,[\d.]*\d", following)


def test_info_prints_a_topics_file_to_complete_where_a_run_needs_one():
    def topic(name, kind):
        return Topic(name, kind, np.arange(3), None)

    tags = [topic(f"/{name}/tags", "apriltag_msgs/msg/ApriltagArrayStamped") for name in "ab"]
    motion = topic("/odom", "nav_msgs/msg/Odometry")
    draft = parse_yaml(draft_of([*tags, motion], None), None, typed=True)
    assert draft["odometry"] == {"topic": "/odom"}
    assert [row["topic"] for row in draft["bearings"]] == ["/a/tags", "/b/tags"]
    validated(
        LogSettings, draft | {"bearings": [row | {"camera": "/info"} for row in draft["bearings"]]}
    )
    assert draft_of([motion, topic("/scan", "sensor_msgs/msg/LaserScan")], None) == ""
    others = ("/tf_static", "tf2_msgs/msg/TFMessage"), ("/m", "visualization_msgs/msg/MarkerArray")
    draft = draft_of(
        [topic("/joints", "sensor_msgs/msg/JointState"), *(topic(*o) for o in others)], None
    )
    assert "wheel_radius: METRES" in draft
    assert parse_yaml(draft, None, typed=True)["bearings"] == [{"topic": "/m"}]


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["calibrate", "mine"], "use `homeward tune DRIVE`"),
        (["score"], "use `homeward run DRIVE`"),
        (["help"], "use `homeward --help`"),
        (["export", "robust"], "homeward export ekf --landmarks 12"),
        (["export", "ekf"], "homeward export ekf --landmarks 12"),
        (["place", "serve", "hall", "--tcp", "7710"], "an MQTT broker"),
        (["compare", "robust", "ekf"], "use `homeward run DRIVE --estimator robust,ekf`"),
        (["import", "mine/home.csv", "--wheels", "radius=1"], "wheel_radius or omni_radius?"),
        (["import", "tags.json"], "or add a source (docs/do/sources.md)"),
        (["run", "mine", "--home-during=0,5"], "is now --home during:0,5"),
        (["run", "mine", "--store-home", "dock"], "now `homeward place add PLACE DRIVE`"),
    ],
)
def test_words_of_other_programs_get_a_command(words, answer, here):
    (here / "tags.json").write_text('[{"timestamp": 0.1, "detections": []}]')
    assert refused(call(*words)).endswith(answer)


def test_only_the_first_help_offers_completion():
    assert "--install-completion" in call("--help").stdout
    assert "completion" not in call("run", "--help").stdout


def test_a_status_prints_as_its_word():
    assert f"{Status.MAPPING}" == "mapping"


def test_rotation_velocities_in_degrees_are_yaw_rates(here):
    (here / "wheels.csv").write_text(
        "timestamp_ms;lin_vel_mm_s;rot_vel_deg_s\n" + "".join(f"{k}0;100;3\n" for k in range(9))
    )
    assert "no bearings found" in refused(call("import", "wheels.csv"))  # the next missing table


def test_a_simulated_drive_names_the_next_command(here):
    result = done(call("simulate", "circle", "--out", "round"))
    assert result.stdout.splitlines()[-1] == "Next: homeward run round"
