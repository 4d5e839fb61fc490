"""`homeward info` and `homeward convert` as a user would call them."""

import re
import shutil

import pytest
import yaml
from commands import call, done, refused

from homeward.drives.ros.settings import LogSettings
from homeward.drives.settings import DriveSettings
from homeward.io.settings import read_settings
from homeward.runs.single_run import sample_drive


@pytest.fixture
def log(tmp_path):
    target = tmp_path / "sample.mcap"
    done(call("convert", sample_drive(), target))
    return target


def test_info_lists_topics_and_prints_the_topics_file_that_is_used(log, tmp_path):
    result = done(call("info", log))
    head, columns, *rows = result.stdout.splitlines()
    assert "MCAP, 5 topics" in head
    assert columns.split()[:3] == ["topic", "type", "messages"]
    (odometry,) = [row for row in rows if row.startswith("/homeward/odometry")]
    assert "3604" in odometry
    assert "20.0 Hz" in odometry
    topics = tmp_path / "topics.yaml"
    before, following = result.stdout.split("Next: ")
    assert following == f"homeward run {log}\n"
    topics.write_text(before.partition("to change them):\n")[2])
    assert read_settings(topics, LogSettings).odometry.topic == "/homeward/odometry"
    again = call("info", log, "--topics", topics).stdout
    assert again == f"{before}Next: homeward run {log} --topics {topics}\n"


def test_info_of_a_drive_folder(tmp_path):
    assert "bearings.csv" in call("info", sample_drive()).stdout
    assert "no such file" in refused(call("info", tmp_path / "none"))
    (tmp_path / "notes.txt").write_text("hello")
    assert "neither" in refused(call("info", tmp_path / "notes.txt"))


def test_info_of_an_unfinished_drive_folder_lists_present_and_missing_files(tmp_path):
    shutil.copy(sample_drive() / "odometry.csv", tmp_path)
    result = done(call("info", tmp_path))
    assert f"{tmp_path}: drive folder" in result.stdout
    assert re.search(r"odometry.csv +t,v,omega +3604 +20.0 Hz", result.stdout)
    assert "cannot use it: there is no bearings.csv, no home.csv." in result.stdout


def test_info_of_a_drive_without_home_names_all_ways_to_give_it_and_the_next_command(tmp_path):
    folder = tmp_path / "my drive"
    shutil.copytree(sample_drive(), folder)
    (folder / "home.csv").unlink()
    words = done(call("info", folder)).stdout
    for way in ("home.csv", "--home during:FROM,TO", "spin:FROM,TO", "at:T"):
        assert way in words
    assert words.endswith(f"Next: homeward run '{folder}' --home at:0\n")


def test_info_recognises_folders_of_images_and_of_mrclam(tmp_path):
    images, mrclam = tmp_path / "images", tmp_path / "mrclam"
    shutil.copytree(sample_drive(), images)
    (images / "bearings.csv").unlink()
    (images / "images.csv").write_text("t,file\n0.5,a.png\n1.0,a.png\n")
    (images / "a.png").touch()
    reported = call("info", images).stdout
    assert "folder of images" in reported
    assert re.search(r"images.csv +t,file +2 +2.0 Hz", reported)
    mrclam.mkdir()
    (mrclam / "Barcodes.dat").touch()
    (mrclam / "Robot2_Odometry.dat").touch()
    said = call("info", mrclam).output
    assert "Robots: 2." in said
    assert said.endswith(f"{mrclam} --robot 2 --home 0,0,0 --out out/robot2\n")
    assert "columns" not in said  # no table of nothing


@pytest.mark.parametrize(
    ("file", "head", "advice", "advice_for_folder", "info"),
    [
        (
            "home.csv",
            "landmark,bearing",
            "a file or topic under home",
            "--home during",
            "drive --home at:0\n",
        ),
        (
            "bearings.csv",
            "t,landmark,bearing",
            "its topics under bearings",
            "no sightings",
            "homeward run cannot use it: bearings.csv has no rows.",
        ),
    ],
)
def test_a_log_without_a_part_names_the_way_out(
    file, head, advice, advice_for_folder, info, tmp_path
):
    folder, log, out = tmp_path / "drive", tmp_path / "log.mcap", tmp_path / "out"
    shutil.copytree(sample_drive(), folder)
    (folder / file).write_text(f"{head}\n")
    done(call("convert", folder, log))
    assert f"name {advice} in a topics file" in refused(call("run", log, "--out", out))
    assert advice_for_folder in refused(call("run", folder, "--out", out))
    assert info in call("info", folder).stdout


def test_info_reports_why_a_drive_would_be_refused(tmp_path):
    """The log is described with its errors."""
    folder = tmp_path / "drive"
    shutil.copytree(sample_drive(), folder)
    file = folder / "bearings.csv"
    head, *rows = file.read_text().splitlines()
    cells = [row.partition(",") for row in rows]
    late = [f"{float(t) + 5000},{rest}" for t, _, rest in cells]
    file.write_text("\n".join([head, *late]) + "\n")
    reported = done(call("info", folder))
    assert "odometry.csv" in reported.stdout
    *_, last = reported.stdout.splitlines()
    words = refused(call("run", folder, "--out", tmp_path / "out"))
    assert "the first of the bearings is 4,8" in words
    assert last == f"Note: homeward run cannot use it: {words.partition('drive: ')[2]}."


def test_convert_there_and_back(log, tmp_path):
    back = tmp_path / "back"
    result = done(call("convert", log, back))
    assert "3604 twists" in result.stdout
    for name in ("odometry.csv", "bearings.csv", "home.csv", "truth.csv"):
        assert (back / name).read_bytes() == (sample_drive() / name).read_bytes(), name
    reported = [yaml.safe_load((f / "drive.yaml").read_text()) for f in (back, sample_drive())]
    assert DriveSettings(**reported[0]) == DriveSettings(**reported[1])
    assert "exists already" in refused(call("convert", log, back))


def test_what_fits_no_log_is_refused(log, tmp_path):
    topics = tmp_path / "topics.yaml"
    topics.write_text("clock: header\n")
    assert "topics are for logs" in refused(call("run", sample_drive(), "--topics", topics))
    assert "cannot be read" in refused(call("info", log, "--topics", tmp_path / "none.yaml"))


def test_notes_name_the_file_that_a_log_has(tmp_path):
    """The camera is 0.2 m ahead and was not given: the topics file has no key of drive.yaml."""
    drive = tmp_path / "drive"
    shutil.copytree(sample_drive(), drive)
    (drive / "drive.yaml").write_text("odometry: {speed_sigma: 0.01}\n")
    log = tmp_path / "sample.mcap"
    done(call("convert", drive, log))
    notes = [
        done(call("run", source, "--out", tmp_path / name)).stdout.partition("Note: ")[2]
        for source, name in ((drive, "one"), (log, "other"))
    ]
    assert "under `sensor:` in drive.yaml: x: 0.2" in notes[0]
    assert "under `sensor:` of `drive:` in the topics file (--topics): x: 0.2" in notes[1]
    assert "landmarks.yaml of the drive folder" in notes[0]
    assert "landmarks.yaml of a drive folder (`homeward convert` makes it" in notes[1]
    # What is wrong with this robot is before what every run without a distance has.
    assert notes[0].startswith("Camera extrinsics")
