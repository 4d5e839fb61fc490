"""Positions of landmarks in tables become bearings, in camera or robot axes."""

import math

import numpy as np
import pytest
from cli.commands import call, refused

from homeward.drives.folder import read_folder
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.opening import sample_drive
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.io.table import identifiers, numbers, read_csv

HEIGHTS = np.linspace(-0.3, 0.4, 5)
"""Heights of the landmarks above the camera [m], by the last digit of their number."""


@pytest.fixture
def plain():
    return read_folder(sample_drive())


def positions(plain, is_in_front=False, scale=1.0, until=30.0):
    """Times, ids, bearings and positions (forward, left, up) of the sample's first sightings."""
    world = read_csv(
        sample_drive() / "world.csv", {"landmark": identifiers, "x": numbers, "y": numbers}
    )
    where = {n: np.array([x, y]) for n, x, y in zip(*world.columns.values(), strict=True)}
    truth, seen = plain.truth, plain.sightings
    rows = []
    for t, name, bearing in zip(seen.t, seen.landmark, seen.bearing, strict=True):
        if t > until or (is_in_front and abs(bearing) > 1.2):
            continue
        k = int(np.argmin(np.abs(truth.t - t)))
        c, s = math.cos(truth.heading[k]), math.sin(truth.heading[k])
        dx, dy = where[name] - [truth.x[k], truth.y[k]]
        forward, left = c * dx + s * dy - plain.settings.sensor.x, c * dy - s * dx
        place = scale * np.array([forward, left, HEIGHTS[int(name[-1]) % 5]])
        rows.append((float(t), name, math.atan2(left, forward), *map(float, place)))
    return rows


def write(folder, name, head, rows):
    lines = (",".join(map(str, row)) for row in rows)
    (folder / name).write_text("\n".join([head, *lines]) + "\n")
    return folder / name


def files(folder, tags):
    return [sample_drive() / "odometry.csv", tags, sample_drive() / "home.csv"]


def bearings(paths, *columns):
    found = understand(paths, columns)
    how = found["bearings"].columns["bearing"]
    return drive_of(found, "tags").sightings, f"{how.signed_name}; {how.source}"


QUATERNION = ("0.0", "0.0", "0.38268", "0.92388")


@pytest.mark.parametrize(
    ("head", "row", "shown"),
    [
        (
            "t,tag_id,x,y,z",
            lambda t, n, f, le, up: (t, n, -le, -up, f),
            "atan2(-x, z); z > 0, y varies least",
        ),
        (
            "header.stamp.sec,header.stamp.nanosec,header.frame_id,marker,pose.pose.position.x,"
            "pose.pose.position.y,pose.pose.position.z,pose.pose.orientation.x,"
            "pose.pose.orientation.y,pose.pose.orientation.z,pose.pose.orientation.w",
            lambda t, n, f, le, up: (
                *(int(t), round(t % 1 * 1e9), "cam_optical_frame", n, -le, -up, f, *QUATERNION),
            ),
            "atan2(-pose.pose.position.x, pose.pose.position.z); frame 'cam_optical_frame'",
        ),
        (
            "t,id,frame_id,tx,ty,tz,qx,qy,qz,qw",
            lambda t, n, f, le, up: (t, int(n[1:]), "base_link", f, le, up, *QUATERNION),
            "atan2(ty, tx); frame 'base_link'",
        ),
        (
            "time,landmark,position_x,position_y,position_z",
            lambda t, n, f, le, up: (t, n, f, le, up),
            "atan2(position_y, position_x); z varies least",
        ),
        (
            "time,tag_id,tag_x [mm],tag_y [mm],tag_z [mm]",
            lambda t, n, f, le, up: (t, n, -1e3 * le, -1e3 * up, 1e3 * f),
            "atan2(-tag_x [mm], tag_z [mm]); z > 0, y varies least",
        ),
        ("t,id,x,z", lambda t, n, f, le, up: (t, n, -le, f), "atan2(-x, z); x and z only, z > 0"),
        (
            "t,id,x,y,z,yaw",
            lambda t, n, f, le, up: (t, n, -1e3 * le, -1e3 * up, 1e3 * f, 0.3),
            "atan2(-x, z); z > 0, y varies least",
        ),
    ],
)
def test_positions_are_bearings(tmp_path, plain, head, row, shown):
    rows = positions(plain, is_in_front="z varies" not in shown)
    tags = write(tmp_path, "tags.csv", head, (row(t, n, *place) for t, n, _, *place in rows))
    sightings, how = bearings(files(tmp_path, tags))
    assert how == shown
    assert sightings.t == pytest.approx([r[0] for r in rows], abs=1e-6)
    assert wrap(sightings.bearing - [r[2] for r in rows]) == pytest.approx(0.0, abs=1e-9)
    numeric = head.startswith("t,id,frame")
    assert sightings.landmark.tolist() == [str(int(r[1][1:])) if numeric else r[1] for r in rows]


@pytest.mark.parametrize(
    ("columns", "turned"),
    [
        ("tags.csv: landmark=id, right=a, forward=b", 1),
        ("landmark=id,left=-a,forward=b", 1),
        ("tags.csv: left=a[mm], forward=b[mm]", -1),
    ],
)
def test_axes_by_columns(tmp_path, plain, columns, turned):
    rows = positions(plain)
    tags = write(tmp_path, "tags.csv", "t,id,a,b", ((t, n, -le, f) for t, n, _, f, le, _ in rows))
    sightings, how = bearings(files(tmp_path, tags), columns)
    assert wrap(sightings.bearing - [turned * r[2] for r in rows]) == pytest.approx(0, abs=1e-9)
    assert how == f"atan2({'-' if turned > 0 else ''}a, b); axes as specified"


def test_home_positions_have_the_axes_of_the_detections(tmp_path, plain):
    rows = positions(plain)
    tags = write(tmp_path, "tags.csv", "t,id,x,y,z", (r[:2] + r[3:] for r in rows))
    at_home = [(n, math.cos(h.bearing), math.sin(h.bearing), 0.2) for n, h in plain.home.items()]
    home = write(tmp_path, "home.csv", "id,px,py,pz", at_home)
    odometry = sample_drive() / "odometry.csv"
    drive = drive_of(understand([odometry, tags, home]), "home")
    expected = {n: h.bearing for n, h in plain.home.items()}
    assert {n: h.bearing for n, h in drive.home.items()} == pytest.approx(expected)
    # Without them they may be a survey.
    seen = sample_drive() / "bearings.csv"
    with pytest.raises(
        InputError,
        match=r"a survey, or home positions in unknown axes .*add a column of times.*forward=px",
    ):
        understand([odometry, seen, home])
    drive = drive_of(understand([odometry, seen, home], ["forward=px, left=py"]), "home")
    assert {n: h.bearing for n, h in drive.home.items()} == pytest.approx(expected)


def test_zeros_are_no_positions(tmp_path, plain):
    rows = [(r[0], r[1], *(r[3:] if k else (0, 0, 0))) for k, r in enumerate(positions(plain))]
    tags = write(tmp_path, "tags.csv", "t,id,x,y,z", rows)
    drive = drive_of(understand(files(tmp_path, tags)), "zeros")
    assert drive.sightings.t.size == len(rows) - 1
    assert any(line.startswith("1 landmarks out of view (0") for line in drive.remark_lines)


@pytest.mark.parametrize(
    ("head", "row", "columns", "complaint"),
    [
        ("t,id,x,y,z", lambda f, le, up: (f, le, 9 * up), (), "positions in unknown axes"),
        ("t,id,x,y,z", lambda f, le, up: (-le, abs(f), up), (), "positions in unknown axes"),
        ("t,id,x,y", lambda f, le, up: (400 + 9 * le, 300 - up), (), "give the axes, as in --colu"),
        ("t,id,x,y,z", lambda *_: ("", "", ""), (), "(x empty, y empty, z empty)"),
        ("t,id,frame_id,x,y,z", lambda f, le, up: ("map", f, le, up), (), "fixed frame 'map'"),
        ("t,id,x,y,z,theta", lambda f, le, up: (f, le, up, 1), (), "'theta' may be the bearing or"),
        ("t,id,a,b,c", lambda f, le, up: (f, le, up), ("left=b",), "requires the role forward"),
    ],
)
def test_positions_with_unknown_axes_are_refused(tmp_path, plain, head, row, columns, complaint):
    rows = ((t, n, *row(*place)) for t, n, _, *place in positions(plain, is_in_front=True))
    tags = write(tmp_path, "tags.csv", head, rows)
    given = [f"--columns={text}" for text in columns]
    out = ["--out", tmp_path / "out", "--picture", tmp_path / "import.png"]
    assert complaint in refused(call("import", *files(tmp_path, tags), *given, *out))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tags.csv"]


def test_a_camera_frame_with_x_ahead_is_not_read_as_optical_axes(tmp_path, plain):
    """As of camera_link (REP 103), with tags high above the camera."""
    seen = positions(plain, is_in_front=True)
    frame, head = "camera_link", "t,id,frame_id,x,y,z"
    body = [(t, n, frame, f, le, 4 + 9 * up) for t, n, _, f, le, up in seen]
    optical = [(t, n, frame, -le, -4 - 9 * up, f) for t, n, _, f, le, up in seen]
    with pytest.raises(InputError, match="positions in unknown axes"):
        understand(files(tmp_path, write(tmp_path, "tags.csv", head, body)))
    _, shown = bearings(files(tmp_path, write(tmp_path, "tags.csv", head, optical)))
    assert shown == "atan2(-x, z); frame 'camera_link'"


@pytest.mark.parametrize("head", ["t,x,y,heading,source_id,robot_id", "t,x,y,yaw,cell_x"])
def test_poses_with_other_columns_stay_poses(tmp_path, head):
    rows = [(k, 0.1 * k, 0.0, 0.1, 1, 2)[: head.count(",") + 1] for k in range(9)]
    found = understand([write(tmp_path, "poses.csv", head, rows)])
    assert set(found) == {"odometry"}


def test_pixels_of_the_centre_are_no_position(tmp_path, plain):
    """Detectors of tags write the pixels of the centre before the position."""
    rows = [
        (t, n, 640 - le, 360 - up, -le, -up, f) for t, n, _, f, le, up in positions(plain, True)
    ]
    head = "t,tag_id,center_x,center_y,pose_t_x,pose_t_y,pose_t_z"
    _, shown = bearings(files(tmp_path, write(tmp_path, "tags.csv", head, rows)))
    assert shown == "atan2(-pose_t_x, pose_t_z); z > 0, y varies least"
    tags = write(
        tmp_path, "tags.csv", "t,tag_id,center_x,center_y,z", [r[:4] + r[6:] for r in rows]
    )
    with pytest.raises(InputError, match="'center_y' and 'z' may belong to different points"):
        understand(files(tmp_path, tags))


def test_angles_along_with_corners_stay_bearings(tmp_path):
    head = "t,id,angle,corner_x,centre_x,corner_y"
    found = understand([write(tmp_path, "seen.csv", head, [(0, "a", 0.1, 5, 6, 7)])])
    assert set(found) == {"bearings"}


@pytest.mark.parametrize(
    ("name", "kind"),
    [("robot_pose.csv", "odometry"), ("odom.csv", "odometry"), ("mocap.csv", "truth")],
)
def test_poses_of_a_robot_are_no_landmarks(tmp_path, name, kind):
    """The frame and a constant id do not make a robot's pose a detection."""
    head = "header.stamp.sec,header.stamp.nanosec,header.frame_id,name,pose.position.x,"
    head += (
        "pose.position.y,pose.position.z,orientation.x,orientation.y,orientation.z,orientation.w"
    )
    rows = [(k, 0, "map", "robot1", 0.1 * k, 0.0, 0.0, *QUATERNION) for k in range(9)]
    found = understand([write(tmp_path, name, head, rows)])
    assert set(found) == {kind}


def test_positions_to_the_right_are_mirrored_and_shown(tmp_path, plain):
    """Coordinates do not show the direction of y; the yaw rates of the odometry do."""
    rows, head = positions(plain, until=50.0), "t,id,x,y,z"
    paths = files(
        tmp_path,
        write(tmp_path, "tags.csv", head, [(t, n, f, -le, up) for t, n, _, f, le, up in rows]),
    )
    found, shown = bearings(paths)
    assert found.bearing == pytest.approx([row[2] for row in rows], abs=1e-9)
    assert shown == "-atan2(y, x); z varies least; sign changed to fit yaw rates"
    assert any("omega=-COLUMN" in line for line in drive_of(understand(paths), "").remark_lines)
    # Home bearings of another kind keep their sign, and so do specified columns.
    assert drive_of(understand(paths), "").home["L01"].bearing == plain.home["L01"].bearing
    mirrored, shown = bearings(paths, "tags.csv: forward=x, left=y")
    assert mirrored.bearing == pytest.approx(-found.bearing)
    assert "sign" not in shown


@pytest.mark.parametrize("is_wide", [False, True])
def test_clockwise_bearings_change_their_sign_also_at_home(tmp_path, plain, is_wide):
    rows = [(t, n, -math.degrees(b)) for t, n, b, *_ in positions(plain, until=50.0)]
    ids = sorted({n for _, n, _ in rows})
    if is_wide:
        wide = ((t, *(b if n == i else "" for i in ids)) for t, n, b in rows)
        tags = write(tmp_path, "tags.csv", ",".join(["t", *ids]), wide)
    else:
        tags = write(tmp_path, "tags.csv", "t,id,bearing_deg", rows)
    at_home = [(n, -math.degrees(h.bearing)) for n, h in plain.home.items()]
    home = write(tmp_path, "home.csv", "id,bearing", at_home)
    drive = drive_of(understand([sample_drive() / "odometry.csv", tags, home]), "")
    assert np.degrees(drive.sightings.bearing) == pytest.approx([-b for _, _, b in rows])
    assert drive.home["L01"].bearing == pytest.approx(plain.home["L01"].bearing)
