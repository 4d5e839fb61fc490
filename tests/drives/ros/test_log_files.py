"""Definitions of messages, and the several forms of ROS 2 bags."""

import re
from pathlib import Path

import numpy as np
import pytest
from drives.ros.build import EPOCH, odometry, stamps
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from homeward.drives.opening import open_drive
from homeward.drives.ros.info import log_info
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.writing import DEFINITIONS, LogFile, typestore, writing
from homeward.errors import InputError
from homeward.io.settings import parse_settings


def test_the_definitions_are_those_in_the_documentation():
    text = (Path(__file__).resolve().parents[3] / "docs" / "do" / "logs.md").read_text(
        encoding="utf-8"
    )
    for definition in DEFINITIONS.values():
        assert definition in text
    (example,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    told = parse_settings(example, LogSettings, Path("docs/do/logs.md"))
    assert told.drive.sensor.x == 0.2


def test_a_log_without_definitions_and_bags_of_several_compressed_files(tmp_path):
    import sqlite3

    from backports import zstd

    folder = tmp_path / "bag"
    folder.mkdir()
    for number in range(2):
        file = folder / f"part_{number}.db3"
        with writing(file) as log:
            for t in stamps(5, EPOCH + number):
                log.write("/odom", t, odometry(log, t, 0.2, 0.1))
        with sqlite3.connect(file) as database:
            database.execute("DROP TABLE message_definitions")
            database.execute("UPDATE schema SET schema_version = 3")  # as of ROS 2 Humble
        database.close()
        (folder / f"{file.name}.zstd").write_bytes(zstd.compress(file.read_bytes()))
        file.unlink()
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [part_0.db3.zstd, part_1.db3.zstd], "
        "compression_mode: FILE, compression_format: zstd}\n"
    )
    drive = open_drive(folder)
    assert drive.odometry.t.tolist() == pytest.approx(
        [*np.arange(5) / 10, *(1 + np.arange(5) / 10)]
    )


def test_info_and_run_agree_on_a_log_without_definitions(tmp_path):
    """Types that are known here are read; of others `info` gives the reason why `run` refuses."""
    import sqlite3

    path, home = tmp_path / "humble.db3", tmp_path / "home.csv"
    home.write_text("landmark,bearing\n3,0.25\n")
    topics = tmp_path / "topics.yaml"
    topics.write_text("home: {csv: home.csv}\n")
    with writing(path) as log:
        for t in stamps(5):
            log.write("/odom", t, odometry(log, t, 0.2, 0.1))
            place = {"position": log.make("geometry_msgs/msg/Point", x=1.0, z=1.0)}
            within = {"header": None, "pose": {"pose": place}}
            tag = {"id": np.array([3], np.int32), "size": np.array([0.1]), "pose": within}
            tags = [log.make("apriltag_ros/msg/AprilTagDetection", **tag)]
            kind, header = "apriltag_ros/msg/AprilTagDetectionArray", log.header(t, "camera")
            log.write("/detections", t, log.make(kind, header=header, detections=tags))
    with sqlite3.connect(path) as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")  # as of ROS 2 Humble
    database.close()
    drive = open_drive(path, topics=topics)
    assert drive.sightings.landmark.tolist() == ["3"] * 5
    assert drive.sightings.bearing == pytest.approx([-np.pi / 4] * 5)
    assert "/detections can be used as bearings." in log_info(path).remarks
    with sqlite3.connect(path) as database:
        kind = "fiducial_msgs/msg/FiducialTransformArray"
        database.execute("UPDATE topics SET type = ? WHERE name = '/detections'", (kind,))
    database.close()
    with pytest.raises(InputError, match="the log contains no definition") as refused:
        open_drive(path, topics=topics)
    assert f"{refused.value.what}." in log_info(path).remarks
    assert (
        log_info(path, topics).remarks[-1] == f"homeward run cannot use it: {refused.value.what}."
    )
    assert not any("/detections can be used" in line for line in log_info(path).remarks)


def test_messages_compressed_one_by_one(tmp_path):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer_made:
        pass
    writer = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        log = LogFile(writer, ros1=False)
        for t in stamps(5):
            log.write("/odom", t, odometry(log, t, 0.2, 0.1))
    assert open_drive(tmp_path / "packed").odometry.v.tolist() == [0.2] * 5
    assert writer_made.connections == []
    with pytest.raises(InputError, match="no topic with odometry"):
        open_drive(tmp_path / "bag")


def test_other_distributions_know_our_types():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
        assert store.hash_rihs01(name) == typestore(ros1=False).hash_rihs01(name)
