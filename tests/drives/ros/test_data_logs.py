"""WPILib data logs with PhotonVision and Limelight, and logs of LCM."""

import math
import struct

import numpy as np
import pytest

from benchmarks.inputs.data_logs import (
    CAMERA,
    MICRO,
    PHOTON,
    SPEEDS,
    TAGS,
    doubles,
    finish,
    header,
    limelight,
    limelight_log,
    photon,
    photon_log,
    record,
    small_log,
    start,
)
from benchmarks.inputs.kinds import Sample
from homeward.drives.opening import open_drive
from homeward.drives.ros.info import log_info
from homeward.drives.ros.wpilog import DataLog
from homeward.errors import InputError


@pytest.fixture
def opened(tmp_path):
    def put(data, topics="", **options):
        path = tmp_path / "robot.wpilog"
        path.write_bytes(data)
        (tmp_path / "topics.yaml").write_text(topics)
        return open_drive(path, topics=tmp_path / "topics.yaml" if topics else None, **options)

    return put


def refused(opened, data, topics=""):
    with pytest.raises(InputError) as caught:
        opened(data, topics)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("log_of", [photon_log, limelight_log])
def test_the_sample_drive_as_a_data_log_is_the_sample_drive(opened, log_of):
    sample = Sample()
    drive, seen = opened(log_of(sample)), sample.seen.ahead
    np.testing.assert_allclose(drive.odometry.t - 10, sample.t, atol=1e-6)
    np.testing.assert_allclose(drive.odometry.v, sample.v, rtol=1e-12)
    np.testing.assert_allclose(drive.odometry.omega, sample.omega, rtol=1e-12)
    # The stamps are those of the exposure, not of the result.
    order = np.lexsort([seen.id, seen.t])
    ids = drive.sightings.landmark.astype(int)
    own = np.lexsort([ids, drive.sightings.t.round(3)])
    assert ids[own].tolist() == seen.id[order].tolist()
    np.testing.assert_allclose(drive.sightings.t[own] - 10, seen.t[order], atol=1e-6)
    np.testing.assert_allclose(drive.sightings.bearing[own], seen.bearing[order], atol=1e-9)


def test_the_example_of_the_specification_is_read(tmp_path):
    log = tmp_path / "log"
    log.write_bytes(
        bytes.fromhex("57 50 49 4c 4f 47 00 01 00 00 00 00")
        + bytes.fromhex("20 00 1a 40 42 0f 00 01 00 00 00 04 00 00 00 74 65 73 74")
        + bytes.fromhex("05 00 00 00 69 6e 74 36 34 00 00 00 00")
        + bytes.fromhex("20 01 08 40 42 0f 03 00 00 00 00 00 00 00")
    )
    with log.open("rb") as stream:
        ((entry, t, data),) = DataLog(stream, log.stat().st_size).records()
    assert (tuple(entry), t, data) == (("test", "int64"), 1_000_000, b"\3" + bytes(7))


def test_home_is_where_the_robot_was_at_rest(opened):
    drive = opened(small_log(), home_during=(0.0, 2.0))
    expected = {str(n): math.atan2(y, x) for n, (x, y, _) in TAGS.items()}
    assert {name: pytest.approx(seen.bearing) for name, seen in drive.home.items()} == expected


def test_info_lists_the_entries_and_those_that_a_run_would_use(opened, tmp_path):
    opened(small_log())
    found = log_info(tmp_path / "robot.wpilog")
    assert found.kind == "WPILib data log"
    assert [(t.name, t.type, t.count) for t in found.topics] == [
        ("/Drive/Speeds", "struct:ChassisSpeeds", 40),
        ("NT:/photonvision/cam/rawBytes", "photonstruct:PhotonPipelineResult", 40),
    ]
    assert found.plan.odometry.topic == "/Drive/Speeds"
    assert found.plan.bearings[0].topic == "NT:/photonvision/cam/rawBytes"


@pytest.mark.parametrize("unit", [1, 1000])
def test_the_latency_of_photonvision_is_subtracted(opened, unit):
    data = small_log(made=lambda tags: photon(tags, 5 * MICRO * unit, unit=unit))
    assert opened(data).sightings.t[0] == pytest.approx(-0.03, abs=1e-5)


def test_values_that_are_logged_only_when_they_change_are_valid_until_then(opened):
    rows = [header(), SPEEDS, CAMERA, record(1, 0, doubles(0.5, 0.0, 0.1))]
    rows += [record(2, k * MICRO // 10, photon(TAGS)) for k in range(100)]
    rows += [record(1, 10 * MICRO, doubles(0.0, 0.0, 0.0))]
    drive = opened(b"".join(rows))
    assert np.diff(drive.odometry.t).max() <= 0.5
    assert set(drive.odometry.v[:-1]) == {0.5}
    assert drive.odometry.t[-1] == 10.0


@pytest.mark.parametrize(
    ("name", "kind", "turn"),
    [("/Pose", "struct:Pose2d", 1.0), ("/Robot", "double[]", 180 / math.pi)],
)
def test_poses_are_odometry_where_the_topics_file_names_them(opened, name, kind, turn):
    rows = [header(), start(1, name, kind), CAMERA]
    for k in range(50):
        angle = 0.02 * k
        pose = math.sin(angle), 1 - math.cos(angle), angle * turn
        rows += [
            record(1, k * MICRO // 50, doubles(*pose)),
            record(2, k * MICRO // 50, photon(TAGS)),
        ]
    data = b"".join(rows)
    drive = opened(data, f"odometry: {{topic: {name}}}")
    assert drive.odometry.v[:-1] == pytest.approx(1.0, rel=1e-3)
    assert drive.odometry.omega[:-1] == pytest.approx(1.0, rel=1e-3)
    assert "no topic with odometry" in refused(opened, data)


def test_sideways_speeds_of_a_swerve_drive_are_read(opened):
    rows = [header(), SPEEDS, CAMERA]
    for k in range(20):
        rows += [record(1, k * MICRO // 10, doubles(0.5, 0.4, 0.0)), record(2, k, photon(TAGS))]
    drive = opened(b"".join(rows))
    assert drive.odometry.vy.tolist() == [0.4] * 20


MODULES = ((0.3, 0.25), (0.3, -0.25), (-0.3, 0.25), (-0.3, -0.25))
POSITIONS = f"[{', '.join(f'[{x}, {y}]' for x, y in MODULES)}]"


def swerve_log(v, vy, omega, kind="struct:SwerveModuleState[]"):
    """Return a log of 2 s of module states."""
    rolled = [complex(v - omega * y, vy + omega * x) for x, y in MODULES]
    # A module is optimised: it may point backwards and drive at a negative speed.
    states = doubles(
        *(
            value
            for k, z in enumerate(rolled)
            for value in (
                abs(z) * (-1) ** k,
                math.atan2(z.imag, z.real) + math.pi * (k % 2),
            )
        )
    )
    rows = [header(), start(1, "/Drive/States", kind), CAMERA]
    for k in range(20):
        t = k * MICRO // 10
        rows += [record(1, t, states), record(2, t + 1, photon(TAGS))]
    return b"".join(rows)


@pytest.mark.parametrize("kind", ["struct:SwerveModuleState[]", "struct:SwerveModuleVelocity[]"])
def test_states_of_swerve_modules_are_odometry(opened, tmp_path, kind):
    data = swerve_log(0.5, -0.4, 0.3, kind)
    topics = f"odometry: {{topic: /Drive/States, modules: {POSITIONS}}}"
    odometry = opened(data, topics).odometry
    found = np.stack([odometry.v, odometry.vy, odometry.omega], axis=1)
    assert found[:-1] == pytest.approx(np.tile([0.5, -0.4, 0.3], (len(found) - 1, 1)))
    robot = tmp_path / "robot.yaml"
    robot.write_text(f"wheels: {{modules: {POSITIONS}, wheel_radius: 0.05}}\n")
    drive = open_drive(tmp_path / "robot.wpilog", robot_file=robot)
    assert drive.odometry.vy[0] == pytest.approx(-0.4)


def test_states_of_swerve_modules_need_their_positions(opened):
    data = swerve_log(0.5, -0.4, 0.3)
    assert "needs modules; give the geometry" in refused(opened, data)
    topics = "odometry: {topic: /Drive/States, modules: [[0.3, 0.2], [-0.3, 0.2]]}"
    assert "states of 4 modules, but modules has 2 positions" in refused(opened, data, topics)


def test_objects_without_an_id_and_results_without_positions_are_left_out(opened):
    tags = TAGS | {-1: (1.0, 0.0, 0.0), 9: (0.0, 0.0, 0.0)}
    drive = opened(small_log(made=lambda _: photon(tags)))
    assert set(drive.sightings.landmark) == {"1", "2", "3"}
    assert drive.remarks["sightings without an id, left out"] == 40


def test_the_given_tilt_of_a_camera_is_corrected(opened):
    up = 0.35
    tilted = {
        n: (x * math.cos(up) + z * math.sin(up), y, z * math.cos(up) - x * math.sin(up))
        for n, (x, y, z) in TAGS.items()
    }
    topics = 'bearings: {topic: "NT:/photonvision/cam/rawBytes", pitch: -0.35}'
    drive = opened(small_log(made=lambda _: photon(tilted)), topics)
    expected = [math.atan2(y, x) for x, y, _ in TAGS.values()]
    assert drive.sightings.bearing[:3] == pytest.approx(expected)


def test_two_cameras_are_named_for_the_topics_file(opened):
    data = (
        small_log()
        + start(3, "NT:/photonvision/rear/rawBytes", PHOTON)
        + record(3, 1, photon(TAGS))
    )
    said = refused(opened, data)
    assert "NT:/photonvision/cam/rawBytes, NT:/photonvision/rear/rawBytes" in said
    topics = """bearings:
    - {topic: "NT:/photonvision/cam/rawBytes", sensor: {x: 0.2}}
    - {topic: "NT:/photonvision/rear/rawBytes", sensor: {x: -0.2, yaw: 3.14159265}}
    """
    assert set(opened(data, topics).sightings.landmark) == {"1", "2", "3"}


def test_an_older_photonvision_is_listed_as_not_read(opened, tmp_path):
    camera = start(2, "NT:/photonvision/cam/rawBytes", "rawBytes")
    opened(small_log(camera))
    remarks = log_info(tmp_path / "robot.wpilog").remarks
    assert "Types that are not read yet: NT:/photonvision/cam/rawBytes (rawBytes)." in remarks


def test_another_layout_of_photonvision_is_refused(opened):
    said = refused(opened, small_log(made=lambda tags: photon(tags) + b"more"))
    assert "another version of PhotonVision" in said


def test_a_log_that_was_cut_off_is_read_as_far_as_it_goes(opened):
    whole = small_log()
    for size in [len(whole) // 2, *range(len(whole) - 300, len(whole), 7)]:
        drive = opened(whole[:size])
        assert drive.odometry.t.size >= 19
    assert any(
        "incomplete" in line and "copy it from the robot" in line for line in drive.remark_lines
    )
    assert not any("incomplete" in line for line in opened(whole).remark_lines)


def test_entries_that_were_finished_are_ignored(opened):
    late = record(1, 3 * MICRO, doubles(9.0, 0.0, 0.0))
    assert opened(small_log() + finish(1) + late).odometry.v.max() == 0.5


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (header(0x0200), "version 2.0"),
        (b"WPILOG", "no readable message"),
        (header()[:8] + b"\xff\xff\xff\xff", "no readable message"),
        (header() + SPEEDS + b"\x0f\1\0\0\0\xff\xff\xff\x7f\0", "no readable message"),
        (header() + record(0, 0, struct.pack("<BII", 0, 1, 2**31)), "no readable message"),
        (header(), "no topic with odometry"),
        (small_log() + record(1, 2**62, doubles(0, 0, 0), (1, 1, 8)), "beyond the year 2262"),
        (small_log() + record(1, 10**8, b"short"), "does not match its type struct:ChassisSpeeds"),
    ],
)
def test_invalid_logs_are_refused_in_one_line(opened, data, message):
    assert message in refused(opened, data)


def test_the_repeated_values_of_a_hostile_log_are_limited(opened):
    rows = [header(), SPEEDS, CAMERA]
    times = [*(10**k for k in range(6)), 600_000]
    rows += [record(1, t * MICRO, doubles(0, 0, 0), (1, 1, 8)) for t in times]
    rows += [record(2, 0, photon(TAGS))]
    assert opened(b"".join(rows)).odometry.t.size < 110_000
    rows += [record(1, 10**9 * MICRO, doubles(0, 0, 0), (1, 1, 8))]
    with pytest.raises(InputError, match="the clock was set during the recording"):
        opened(b"".join(rows))


@pytest.mark.parametrize(
    "values", [(math.nan,) * 7, (1, 0, 0, 0, math.inf, 0, 0), (1, 90, 90, 0, 0, 0, 0)]
)
def test_invalid_numbers_of_a_limelight_are_left_out(opened, values):
    camera = start(2, "NT:/limelight/rawfiducials", "double[]")
    drive = opened(small_log(camera, lambda tags: doubles(*values) + limelight(tags)))
    assert np.isfinite(drive.sightings.bearing).all()
    assert "2" in drive.sightings.landmark


def test_a_log_of_lcm_is_refused_with_the_way_to_export_it(tmp_path):
    log = tmp_path / "lcmlog-2024-04-15.00"
    log.write_bytes(struct.pack(">IqqII", 0xEDA1DA01, 0, 1713214583477858, 8, 4) + b"MBOT_VELdata")
    with pytest.raises(InputError, match=r"LCM event log.*CSV.*homeward import"):
        open_drive(log)
