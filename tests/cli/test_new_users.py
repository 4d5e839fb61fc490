"""What new users typed in their first hour: each answer is a command that works."""

import dataclasses
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import call, done, first_seconds, refused
from drives.ros import build
from drives.ros.test_bearing_topics import camera_info, tags

from homeward.cli.drives.run import again, run_settings
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.topics.choosing import draft_of
from homeward.drives.ros.topics.survey import Topic
from homeward.drives.ros.writing import writing
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
    again_with = again("run", settings=settings, options=("--robot-file", "robot.yaml"))
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
        (["compare", "mine", "mine"], "--estimator A,B` to compare estimators"),
        (["import", "mine/home.csv", "--wheels", "radius=1"], "wheel_radius or omni_radius?"),
        (["import", "tags.json"], "or add a source (docs/do/sources.md)"),
        (["run", "mine", "--home-during=0,5"], "is now --home during:0,5"),
        (["run", "mine", "--estimator", "mine.py"], "or mine:NAME"),
        (["run", "mine", "--home", "during:2,9"], "or --home at:T for its pose at one time"),
        (["paper"], "use `homeward study paper`"),
        (["peers"], "use `homeward study peers`"),
        (["place", "list", "hall"], "use `homeward place info`"),
        (["place", "delete", "hall"], "use `homeward place forget`"),
        (["info", "notes.txt"], "nor a log (a ROS bag, an MCAP file or a .wpilog file)"),
        (["run", "mine", "--store-home", "dock"], "now `homeward place add PLACE DRIVE`"),
    ],
)
def test_words_of_other_programs_get_a_command(words, answer, here):
    (here / "notes.txt").write_text("Tuesday, the robot was slow.\n")
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


def pasted(result):
    """Call the command that the last line of a result names."""
    program, *words = shlex.split(result.stdout.splitlines()[-1].removeprefix("Next: "))
    assert program == "homeward"
    return call(*words)


def test_a_simulated_drive_names_the_next_command(here):
    assert "Report:" in done(pasted(done(call("simulate", "circle", "--out", "round")))).stdout


def test_the_command_after_a_conversion_runs_the_drive(here):
    assert "Report:" in pasted(done(call("convert", "mine", "mine.mcap"))).stdout
    (here / "mine" / "home.csv").unlink()
    described = done(pasted(done(call("convert", "mine", "other"))))
    assert described.stdout.splitlines()[-1] == "Next: homeward run other --home at:0"


def test_the_command_after_a_tuned_robot_writes_another_file(here):
    (here / "robot.yaml").touch()
    following = done(call("run", "mine")).stdout.splitlines()[-1]
    assert following == "Next: homeward tune mine --out robot-2.yaml"
    assert refused(call("tune", "mine")).endswith("another file, as with --out robot-2.yaml")


def test_the_commands_in_a_place_lead_on_in_it(here):
    first_seconds(here / "first", 40.0)
    first_seconds(here / "second", 41.0)
    (here / "robot.yaml").write_text("sensor: {bearing_sigma: 0.01}\n")
    shown = pasted(done(call("place", "add", "hall", "first")))
    assert done(shown).stdout == "Page: out/hall.html\n"
    words = "--place", "hall", "--robot-file", "robot.yaml"
    added = done(pasted(done(call("run", "second", *words))))
    assert "hall: 11 stayed" in added.stdout
    following = added.stdout.splitlines()[-1]
    assert following == "Next: homeward live --tcp 7707 --robot-file robot.yaml --place hall"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_command_after_an_export_compiles_and_runs_it(here):
    pytest.importorskip("casadi")
    following = done(call("export", "ekf", "--landmarks", "3")).stdout.splitlines()[-1]
    command = following.removeprefix("Next: ")
    assert "heading" in subprocess.check_output(command, shell=True, text=True)


@pytest.mark.parametrize("word", ["reflector", "Reflektor", "réflecteur"])
def test_reflectors_are_landmarks(here, word):
    for name in ("bearings.csv", "home.csv"):
        (here / name).write_text((here / "mine" / name).read_text().replace("landmark", word, 1))
    shutil.copy(here / "mine" / "odometry.csv", here)
    shown = done(call("import", "odometry.csv", "bearings.csv", "home.csv")).stdout
    assert len(re.findall(rf"{word} +landmark", shown)) == 2


def test_text_files_with_numbers_are_tables(here):
    (here / "encoders.txt").write_text("millis left_ticks right_ticks\n51234 0 0\n51284 40 43\n")
    assert "`homeward import encoders.txt --out" in refused(call("info", "encoders.txt"))
    (here / "readme.txt").write_text("2 runs, one without tags")
    (here / "mine" / "bearings.csv").rename(here / "tags.csv")
    shutil.rmtree("mine")
    assert "`homeward import encoders.txt tags.csv --out" in refused(call("run", "."))


def test_a_robot_file_from_a_log_has_no_empty_key(here):
    """Extrinsics of /tf_static are in the settings of the drive, and other cameras are not."""
    with writing(here / "log.mcap") as log:
        stamp = build.EPOCH * build.SECOND
        optical = (0.12, 0, 0.2, -0.5, 0.5, -0.5, 0.5)
        log.write(
            "/tf_static", stamp, build.transforms(log, stamp, {("base_link", "optical"): optical})
        )
        log.write("/odom", stamp, build.odometry(log, stamp, 0.1, 0.0))
        log.write("/tags", stamp, tags(log, stamp, {3: 320.0}))
        log.write("/camera_info", stamp, camera_info(log, stamp))
    settings = open_drive(here / "log.mcap", home_needed=False).settings
    assert settings.sensor.x == pytest.approx(0.12)
    assert "cameras" not in settings.model_fields_set
