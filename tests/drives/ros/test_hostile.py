"""Logs that are damaged or meant to do harm: one clear line, in bounded memory and time."""

import os
import re
import resource
import struct
import subprocess
import sys

import numpy as np
import pytest
from cli.commands import call
from drives.refusals import refusal
from drives.ros import crafted
from drives.ros.crafted import (
    bag,
    cdr_odometry,
    chunk,
    mcap,
    mcap_messages,
    ros1_messages,
    ros1_odometry,
)

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.ros import log
from homeward.drives.ros.info import log_info
from homeward.errors import InputError

GIB = 2**30
FIVE_CDR = [cdr_odometry(i) for i in range(5)]
FIVE_ROS1 = [ros1_odometry(i) for i in range(5)]
IN_MCAP, IN_BAG = mcap_messages(FIVE_CDR), ros1_messages(FIVE_ROS1)


def small_drive():
    t = np.arange(20) / 10 + 1.7e9
    ids = np.array(["a", "b"] * 10, object)
    sightings = Sightings(t, ids, np.full(20, 0.5), np.full(20, 0.01))
    return Drive("x", Odometry(t, t * 0 + 0.1, t * 0), sightings, {"a": HomeBearing(0.1)})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A small log of each kind: {suffix: bytes}."""
    folder = tmp_path_factory.mktemp("whole")
    files = {}
    for suffix in (".bag", ".mcap", ".db3"):
        save_drive(small_drive(), folder / f"x{suffix}")
        files[suffix] = (folder / f"x{suffix}").read_bytes()
    return files


def test_crafted_files_are_read_when_nothing_is_wrong(tmp_path):
    path = tmp_path / "log"
    good = {
        "mcap": mcap(IN_MCAP, statistics=5),
        "mcap in chunks": mcap(
            *(chunk(IN_MCAP, how) for how in ("", "lz4", "zstd")), statistics=15
        ),
        "bag": bag(IN_BAG, 5),
        **{how: bag(IN_BAG, 5, how) for how in ("bz2", "lz4")},
    }
    for name, data in good.items():
        path.write_bytes(data)
        drive = open_drive(path)
        assert set(drive.odometry.v.tolist()) == {0.1}, name
        assert drive.odometry.t.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0], (name, drive.odometry)


@pytest.mark.parametrize(
    ("suffix", "command"),
    [(".bag", "`rosbag reindex FILE`"), (".mcap", "`mcap recover FILE"), (".db3", '".recover"')],
)
def test_a_truncated_log_names_the_command_that_repairs_it(tmp_path, whole, suffix, command):
    """In the refusal, or in a remark where it is read as far as it goes."""
    data, folder = whole[suffix], tmp_path / "bag"
    folder.mkdir()
    path = (tmp_path if suffix == ".bag" else folder) / f"cut{suffix}"
    for size in [100, *range(200, len(data) - 1, len(data) // 12), len(data) - 1]:
        path.write_bytes(data[:size])
        for place in (path, path if suffix == ".bag" else folder):
            try:
                told = [line for line in open_drive(place).remark_lines if "incomplete" in line]
            except InputError as error:
                told = [str(error)]
            assert [path.name in line and command in line for line in told] == [True]


def test_an_mcap_file_without_its_end_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "cut.mcap"
    data = mcap(*(chunk(mcap_messages([FIVE_CDR[i]], first=i), "zstd") for i in range(5)))
    path.write_bytes(data[: data.rindex(b"zstd")])
    drive = open_drive(path)
    assert drive.odometry.t.tolist() == [1.0, 2.0, 3.0, 4.0]
    end = data.rindex(b"zstd") - 41
    (line,) = [line for line in drive.remark_lines if "incomplete" in line]
    assert line.startswith("4 messages read from 'cut.mcap', which is incomplete (not closed")
    assert f"up to byte {end:,} of {path.stat().st_size:,}; recover the messages before" in line
    assert line in log_info(path).remarks


def test_a_bag_that_was_not_closed_is_refused(tmp_path):
    path = tmp_path / "robot.bag.active"
    path.write_bytes(
        re.sub(rb"index_pos=.{8}", b"index_pos=" + bytes(8), bag(IN_BAG, 5), flags=re.S)
    )
    told = refusal(open_drive, path)
    assert "not indexed" in told
    assert "`rosbag reindex FILE`" in told


def test_mcap_files_of_ros_1_and_of_no_system(tmp_path):
    path = tmp_path / "log.mcap"
    for profile in (b"ros1", b"none"):
        path.write_bytes(mcap(IN_MCAP).replace(b"ros2", profile, 1))
        assert open_drive(path).odometry.t.size == 5


def test_types_of_foreign_channels_are_named_as_in_the_log(tmp_path):
    path = tmp_path / "log.mcap"
    for kind in ("foxglove.Log", "", "a/b/c", "a/msg/C"):
        path.write_bytes(mcap(mcap_messages([bytes(20)], kind, "")))
        assert [topic.type for topic in log_info(path).topics] == [kind]
    path.write_bytes(mcap(mcap_messages([bytes(20)], "a/C", "")))
    assert log_info(path).topics[0].type == "a/msg/C"


BOMBS_MIB = {"lz4": 256, "zstd": 256, "bz2": 32}
"""To what the bombs would unpack; bz2 takes too long to make for more [MiB]."""


def test_bombs_and_lengths_in_bounded_memory_and_time(tmp_path, monkeypatch):
    monkeypatch.setattr(log, "MIN_MEMORY", GIB // 5)
    monkeypatch.setattr(log, "MIN_SECONDS", 1.0)
    huge = {how: crafted.packed_zeros(how, mib) for how, mib in BOMBS_MIB.items()}
    declared = 2**31
    files = {}
    for how in ("lz4", "zstd"):
        files[f"honest-{how}.mcap"] = mcap(chunk(b"", how, size=declared, packed=huge[how]))
        files[f"lying-{how}.mcap"] = mcap(chunk(b"", how, size=1000, packed=huge[how]))
    # A record that nobody reads, of 50 MiB, in each of many chunks.
    block = crafted.record(128, bytes(50 * 2**20))
    many = chunk(b"", "zstd", size=len(block), packed=crafted.PACK["zstd"](block))
    files["many.mcap"] = mcap(*[many] * 200)
    for how in ("lz4", "bz2"):
        files[f"honest-{how}.bag"] = bag(b"", 5, how, size=declared, packed=huge[how])
        files[f"lying-{how}.bag"] = bag(b"", 5, how, size=1000, packed=huge[how])
    two_gib = struct.pack("<I", 2**31 - 1)
    files["record.mcap"] = mcap(crafted.record(5, bytes(40), size=2**31))
    files["record-64.mcap"] = mcap(crafted.record(5, bytes(40), size=2**64 - 1))
    files["in-chunk.mcap"] = mcap(chunk(IN_MCAP + crafted.record(5, bytes(40), size=2**62)))
    files["string.mcap"] = mcap(mcap_messages([FIVE_CDR[0][:12] + two_gib + FIVE_CDR[0][16:]]))
    files["header.bag"] = b"#ROSBAG V2.0\n" + two_gib + bytes(100)
    in_chunk = IN_BAG + crafted.fields(op=b"\x02", conn=crafted.u32(0), time=bytes(8)) + two_gib
    files["message.bag"] = bag(in_chunk + bytes(50), 6)
    files["chunk.bag"] = bag(IN_BAG, 5, size=2**32 - 1)
    array = (
        "std_msgs/Header header\nfloat64[2000000000] v\n" + crafted.HEADER_TEXT + crafted.TIME_TEXT
    )
    files["array.mcap"] = mcap(mcap_messages(FIVE_CDR, definition=array.format(seq="")))
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    column = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, "
    column += "data BLOB GENERATED ALWAYS AS (zeroblob(999999999)))"
    one = "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1)"
    crafted.database(tmp_path / "computed.db3", crafted.TOPICS, crafted.ODOM, column, one)
    for path in sorted(tmp_path.iterdir()):
        if path.name != "chunk.bag":
            refusal(open_drive, path)
        else:  # rosbags needs no declared size where nothing is compressed
            assert open_drive(path).odometry.t.size == 5
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 < GIB


def test_the_process_that_reads_may_end_at_any_time(tmp_path, whole, monkeypatch):
    (path := tmp_path / "x.mcap").write_bytes(whole[".mcap"])
    open_drive(path)
    (process,) = log._idle[os.getpid()]
    process.kill()
    process.wait()
    open_drive(path)  # through a new one
    script = "import sys; sys.stdin.readline(); sys.exit(3)"
    real = subprocess.Popen
    log._end_idle()
    monkeypatch.setattr(
        log.subprocess, "Popen", lambda _, **ways: real([sys.executable, "-c", script], **ways)
    )
    assert "status 3" in refusal(open_drive, path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "neither"),
        (b"hello, I am no bag\n" * 100, "neither"),
        (b"#ROSBAG V1.2\n" + b"text " * 100, "before 2.0"),
        (b"#ROSBAG V2.0\n" + b"text, not records " * 300, "damaged"),
        (b"\x89MCAP0\r\n" + b"text, not records " * 300, "damaged"),
        (b"SQLite format 3\x00" + b"text, not pages " * 300, "sqlite"),
        (mcap(chunk(IN_MCAP, "brotli", packed=IN_MCAP)), "'brotli'"),
        (bag(IN_BAG, 5, "snappy", packed=IN_BAG), "'snappy'"),
        (mcap(chunk(IN_MCAP, "zstd", packed=b"not a frame at all")), "Zstandard"),
        (bag(IN_BAG, 5, "bz2", packed=b"not a frame at all"), "Invalid data stream"),
        (bag(IN_BAG, 5, chunks=7), "index"),
        (bag(IN_BAG, 5).replace(b"index_pos=", b"index_pos=\xff\xff", 1), "damaged"),
        (mcap(mcap_messages([b"\x00\x01\x00\x00" + b"odd"])), "too short"),
        (mcap(mcap_messages([p + bytes(40) for p in FIVE_CDR])), "does not match"),
        (
            mcap(mcap_messages(FIVE_CDR, definition="std_msgs/Header header\n$$$\n")),
            "cannot be read",
        ),
        (
            mcap(mcap_messages(FIVE_CDR, definition="std_msgs/Header header\nodd/Odd x\n")),
            "not defined",
        ),
        (
            mcap(
                mcap_messages(
                    FIVE_CDR, definition="std_msgs/Header header\nhomeward_msgs/Odometry o\n"
                )
            ),
            "not defined",
        ),
        (mcap(mcap_messages([cdr_odometry(0, np.nan)])), "finite"),
        (mcap(mcap_messages([*FIVE_CDR[3:], FIVE_CDR[0]])), "runs back"),
        (mcap(mcap_messages(FIVE_CDR, kind="sensor_msgs/msg/Imu")), "no topic with odometry"),
    ],
)
def test_refused_in_one_line(tmp_path, data, words):
    path = tmp_path / "hostile"
    path.write_bytes(data)
    if words == "neither":
        path = path.rename(tmp_path / "hostile.bag")
    assert words in refusal(open_drive, path)


def test_a_type_that_would_become_code_does_not(tmp_path):
    evil = 'homeward_msgs/msg/Odometry"""\nraise SystemExit("run")\n"""'
    path = tmp_path / "evil.mcap"
    path.write_bytes(mcap(mcap_messages(FIVE_CDR, kind=evil)))
    assert "no topic with odometry" in refusal(open_drive, path)
    field = crafted.DEFINITION.replace("float64 v ", "float64 class ", 1)
    path.write_bytes(mcap(mcap_messages(FIVE_CDR, definition=field)))
    refusal(open_drive, path)


def test_a_database_that_is_no_bag(tmp_path):
    path = tmp_path / "log.db3"
    crafted.database(path, "CREATE TABLE songs(id)")
    assert "missing tables" in refusal(open_drive, path)


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ("text", "not a mapping"),
        ("rosbag2_bagfile_information: 3", "rosbag2_bagfile_information is missing"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "is not a list of files"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [../secret]}",
            "'secret' does not exist",
        ),
        ("rosbag2_bagfile_information: {relative_file_paths: [.]}", "does not exist"),
        ("a: &a [x]\nb: [*a, *a", "not YAML"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [x.mcap], compression_mode: file, "
            "compression_format: rar}",
            "'rar'",
        ),
    ],
)
def test_bag_folders_with_odd_metadata(tmp_path, metadata, words):
    (tmp_path / "secret").write_text("not in the bag")
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text(metadata)
    with pytest.raises(InputError, match=words):
        open_drive(folder)


def test_from_the_command_line_nothing_is_written(tmp_path):
    path, out = tmp_path / "cut.bag", tmp_path / "out"
    path.write_bytes(bag(IN_BAG, 5)[:5000])
    for words in (["run", path, "--out", out], ["convert", path, out], ["info", path]):
        result = call(*words)
        assert result.exit_code == 2, result.output
        assert len(result.stderr.strip().splitlines()) == 1
        assert not out.exists()
