"""Roll and pitch of the robot in tables correct bearings of a known elevation."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from homeward.drives.folder import read_folder
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.measure import NOISIER, TAN_ELEVATION, UNRELIABLE
from homeward.drives.opening import open_drive, save_drive
from homeward.errors import InputError

PLACES = {"high": (2.0, 1.0, 1.5), "level": (2.0, -1.0, 0.0), "low": (1.5, 2.0, -0.5)}
"""Positions of landmarks in the level frame at the camera, along the robot's axes [m]."""
YAW = 0.3
"""That of the camera on the robot [rad]."""
STAMPS = [0.1 * k for k in range(20)]


def tilt(t):
    return 0.15 * math.sin(3 * t), 0.2 * math.cos(2 * t)


def seen(t, place):
    """Position in the frame of the tilted camera."""
    roll, pitch = tilt(t)
    there = Rotation.from_euler("ZYX", [0.0, pitch, roll]).inv().apply(place)
    return Rotation.from_euler("Z", -YAW).apply(there)


def write(folder, name, head, rows):
    lines = (",".join(map(str, row)) for row in rows)
    (folder / name).write_text("\n".join([head, *lines]) + "\n")
    return folder / name


@pytest.fixture
def tables(tmp_path):
    """Odometry, positions of landmarks and home; the tilt is in a file of its own, or missing."""
    twists = [(t, 0.2, 0.1) for t in STAMPS]
    rows = [(t, name, *seen(t, place)) for t in STAMPS for name, place in PLACES.items()]
    home = [(name, math.atan2(y, x) - YAW) for name, (x, y, _) in PLACES.items()]
    return [
        write(tmp_path, "odometry.csv", "t,v,omega", twists),
        write(tmp_path, "tags.csv", "t,landmark,forward,left,up", rows),
        write(tmp_path, "home.csv", "landmark,bearing", home),
    ]


def with_yaw(drive, folder):
    """Write an imported drive, give its camera the yaw, and open it."""
    save_drive(drive, folder)
    file = folder / "drive.yaml"
    settings = (yaml.safe_load(file.read_text()) or {}) if file.exists() else {}
    file.write_text(yaml.safe_dump(settings | {"sensor": {"yaw": YAW}}))
    return open_drive(folder)


def assert_level(drive):
    for name, (x, y, _) in PLACES.items():
        found = drive.sightings.bearing[drive.sightings.landmark == name]
        assert found == pytest.approx([math.atan2(y, x) - YAW] * len(STAMPS), abs=1e-9)


def test_a_table_with_roll_and_pitch_corrects_positions(tables, tmp_path):
    angles = [(t, *map(math.degrees, tilt(t))) for t in STAMPS]
    imu = write(tmp_path, "imu.csv", "t,roll_deg,pitch_deg", angles)
    drive = drive_of(understand([*tables, imu]), "tilted")
    assert_level(with_yaw(drive, tmp_path / "drive"))
    plain = with_yaw(drive_of(understand(tables), "level"), tmp_path / "plain")
    error = plain.sightings.bearing - with_yaw(drive, tmp_path / "again").sightings.bearing
    assert np.abs(error).max() > 0.1


def test_odometry_may_have_the_columns_and_a_camera_its_axes(tables, tmp_path):
    twists = [(t, 0.2, 0.1, *tilt(t)) for t in STAMPS]
    odometry = write(tmp_path, "odometry.csv", "t,v,omega,roll,pitch", twists)
    rows = [(t, name, seen(t, place)) for t in STAMPS for name, place in PLACES.items()]
    optical = [(t, name, -y, -z, x) for t, name, (x, y, z) in rows]
    tags = write(tmp_path, "tags.csv", "t,frame_id,landmark,x,y,z", [
        (t, "cam_optical", name, *place) for t, name, *place in optical
    ])  # fmt: skip
    drive = drive_of(understand([odometry, tags, tables[2]]), "tilted")
    assert_level(with_yaw(drive, tmp_path / "drive"))


def test_the_folder_keeps_elevation_and_tilt_for_another_yaw(tables, tmp_path):
    imu = write(tmp_path, "imu.csv", "t,roll,pitch", [(t, *tilt(t)) for t in STAMPS])
    drive = drive_of(understand([*tables, imu]), "tilted")
    save_drive(drive, tmp_path / "drive")
    again = read_folder(tmp_path / "drive")
    assert again.tilt.roll == pytest.approx(drive.tilt.roll, abs=0)
    assert again.sightings.elevation == pytest.approx(drive.sightings.elevation, abs=0)
    opened = open_drive(tmp_path / "drive")
    assert opened.tilt is None
    assert np.isnan(opened.sightings.elevation).all()
    assert opened.recorded.tilt is not None
    with pytest.raises(InputError, match=r"a log cannot contain tilt\.csv"):
        save_drive(drive, tmp_path / "drive.mcap")


def test_without_an_elevation_the_tilt_adds_to_the_noise(tables, tmp_path):
    imu = write(tmp_path, "imu.csv", "t,roll,pitch", [(t, 0.0, 0.12) for t in STAMPS])
    rows = [(t, name, 0.1, 0.02) for t in STAMPS for name in PLACES]
    seen = write(tmp_path, "tags.csv", "t,landmark,bearing,sigma", rows)
    drive = drive_of(understand([tables[0], seen, tables[2], imu]), "tilted")
    save_drive(drive, tmp_path / "drive")
    opened = open_drive(tmp_path / "drive")
    assert opened.sightings.bearing == pytest.approx(drive.sightings.bearing, abs=0)
    assert opened.sightings.sigma == pytest.approx(math.hypot(0.02, TAN_ELEVATION * 0.12))
    assert opened.remarks[NOISIER] == opened.remarks[UNRELIABLE] == 60
    bare = dataclasses.replace(
        drive, sightings=dataclasses.replace(drive.sightings, sigma=np.full(60, np.nan))
    )
    save_drive(bare, tmp_path / "bare")
    (tmp_path / "bare" / "drive.yaml").write_text("sensor: {bearing_sigma: 0.03}\n")
    expected = math.hypot(0.03, TAN_ELEVATION * 0.12)
    assert open_drive(tmp_path / "bare").sightings.sigma == pytest.approx(expected)


def test_angles_of_tags_and_of_ground_truth_are_not_the_robots(tables, tmp_path):
    tags = write(tmp_path, "tags.csv", "t,landmark,forward,left,up,roll,pitch", [
        (t, name, *place, 0.3, 0.4) for t in STAMPS for name, place in PLACES.items()
    ])  # fmt: skip
    truth = write(tmp_path, "truth.csv", "t,x,y,z,roll,pitch,yaw", [
        (t, 0.02 * k, 0.0, 0.0, *tilt(t), 0.0) for k, t in enumerate(STAMPS)
    ])  # fmt: skip
    given = [tables[0], tags, tables[2], truth]
    drive = drive_of(understand(given), "level")
    assert drive.tilt is None
    assert np.isnan(drive.sightings.elevation).all()
    chosen = drive_of(understand(given, ["truth.csv: roll=roll, pitch=pitch"]), "tilted")
    assert chosen.tilt.pitch == pytest.approx([tilt(t)[1] for t in STAMPS])


def test_roll_and_pitch_without_a_unit_may_be_degrees(tables, tmp_path):
    imu = write(tmp_path, "imu.csv", "t,roll,pitch", [(t, 0.8, 0.1) for t in STAMPS])
    with pytest.raises(InputError, match=r"roll and pitch reach 0\.8 and may be in degrees"):
        understand([*tables, imu])
    large = write(tmp_path, "imu.csv", "t,roll,pitch", [(t, 0.8, 4.0) for t in STAMPS])
    drive = drive_of(understand([*tables, large]), "tilted")
    assert np.degrees(drive.tilt.roll) == pytest.approx(0.8)
    assert np.degrees(drive.tilt.pitch) == pytest.approx(4.0)
