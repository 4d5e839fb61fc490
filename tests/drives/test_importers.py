"""CSV of any columns, separators and units becomes the drive that it is."""

import csv
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from homeward.drives.columns import unit_in
from homeward.drives.folder import SIGNS_CHANGED, read_folder, write_folder
from homeward.drives.importers.reading import drive_of, home_warnings, understand
from homeward.drives.opening import sample_drive
from homeward.drives.robot import with_first_camera
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.runs.report.canvas import png
from homeward.runs.report.imported import draw_drive


def write(folder, **texts):
    """Files of these texts, CSV where the name has no suffix."""
    paths = [folder / (name if "." in name else f"{name}.csv") for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, encoding="utf-8")
    return paths


def imported(folder, *given, **texts):
    """The drive of such files; `given` is as for `understand`."""
    return drive_of(understand(write(folder, **texts), *given), "imported")


def table(head, rows):
    return "\n".join([head, *rows]) + "\n"


def sample_rows(name):
    """The first rows of a file of the sample, as numbers where they are."""
    with (sample_drive() / name).open() as stream:
        for row in list(csv.DictReader(stream))[:400]:
            yield SimpleNamespace(**{k: v if k == "landmark" else float(v) for k, v in row.items()})


def test_other_separators_marks_names_and_units_are_the_same_drive(tmp_path):
    """The sample's beginning in ms, mm/s, deg/s and deg, with other separators and marks."""
    wheels = [
        f"{1e3 * r.t};{1e3 * r.v};{math.degrees(r.omega)}" for r in sample_rows("odometry.csv")
    ]
    seen = [
        f"{1e3 * r.t}  {r.landmark}   {math.degrees(r.bearing)}"
        for r in sample_rows("bearings.csv")
    ]
    home = [f"{r.landmark}\t{math.degrees(r.bearing)}" for r in sample_rows("home.csv")]
    truth = [
        f"{1e6 * r.t},{1e2 * r.x},{1e2 * r.y},{math.degrees(r.heading)}"
        for r in sample_rows("truth.csv")
    ]
    texts = {
        "wheels.csv": table("Time [ms];Speed [mm/s];Yaw rate [deg/s]", wheels).replace(".", ","),
        "seen.txt": table("# time  tag_id   angle", seen),
        "home.tsv": table("marker\tbearing_deg", home),
        "mocap.csv": table("timestamp_us,pos_x (cm),pos_y (cm),yaw (deg)", truth),
    }
    found = understand(write(tmp_path, **texts))
    drive, plain = drive_of(found, "odd"), read_folder(sample_drive())
    for mine, same in (
        *((getattr(drive.odometry, k), getattr(plain.odometry, k)) for k in ("t", "v", "omega")),
        *((getattr(drive.sightings, k), getattr(plain.sightings, k)) for k in ("t", "bearing")),
        *((getattr(drive.truth, k), getattr(plain.truth, k)) for k in ("t", "x", "y", "heading")),
    ):
        assert mine.size >= 390
        assert mine == pytest.approx(same[: mine.size], abs=1e-9)
    assert drive.sightings.landmark.tolist() == plain.sightings.landmark[:400].tolist()
    home = {name: seen.bearing for name, seen in plain.home.items()}
    assert {n: s.bearing for n, s in drive.home.items()} == pytest.approx(home)
    seen = found["bearings"].columns
    assert found["odometry"].columns["v"].source == "named"
    assert seen["t"].source == "as odometry"
    assert seen["bearing"].source == "guessed: more than a turn"


def test_no_header_and_a_sign_are_told(tmp_path):
    bare = write(tmp_path, bare="0,0.1,10\n0.1,0.1,20\n")
    with pytest.raises(InputError, match=r"not recognised as .* its columns are '1', '2', '3'"):
        understand(bare)
    found = understand(bare, ["t=1,v=2[m/s]", "omega=-3[deg/s]"])
    assert {c.source for c in found["odometry"].columns.values()} == {"specified"}
    table = found["odometry"].table
    assert table["omega"] == pytest.approx(np.radians([-10, -20]))


def bare(text):
    """The text without its header."""
    return text.partition("\n")[2]


def test_numbers_of_columns_are_no_landmarks(tmp_path):
    """Columns 1, 2, 3 of a file without a header were taken for tags of these names."""
    seen, home = SEEN.replace("L", ""), AT_HOME.replace("L", "")
    without = {"odometry": bare(TWISTS), "bearings": bare(seen), "home": bare(home)}
    plain = imported(tmp_path, FILES_TOLD, **without)
    assert plain.odometry.v.tolist() == [0.1, 0.2, 0.3]
    assert plain.sightings.landmark.tolist() == ["1", "2", "1"]
    assert plain.home["2"].bearing == -0.5
    # One of them without a header: no file need be named.
    one = without | {"bearings": seen, "home": home}
    drive = imported(tmp_path, ["t=1, v=2, omega=-3"], **one)
    assert drive.odometry.omega.tolist() == [-0.2, 0.1, 0.0]
    files = write(tmp_path, **one | {"bearings": bare(seen)})
    with pytest.raises(InputError, match=r"give its roles, as in --columns 'bearings.csv: t=1"):
        understand(files, ["t=1, v=2, omega=3"])
    with pytest.raises(InputError, match="no file has a column '3'"):
        understand(files, ["home.csv: landmark=3"])


FILES_TOLD = (
    "odometry.csv: t=1[s], v=2, omega=3",
    "bearings.csv: t=1, landmark=2, bearing=3",
    "home.csv:landmark=1,bearing=2",
)


def circle(form):
    """Rows of half a turn to the left on a circle of 1 m, by time and heading."""
    return "".join(form(t, a) + "\n" for t, a in enumerate(np.linspace(0, np.pi, 5)))


def tum(t, a):
    return f"{t}.0 {math.sin(a)} {1 - math.cos(a)} 0 0 0 {math.sin(a / 2)} {math.cos(a / 2)}"


def echoed(t, a):
    """A nav_msgs/Odometry as ``ros2 topic echo --csv`` prints it."""
    pose = [math.sin(a), 1 - math.cos(a), 0, 0, 0, math.sin(a / 2), math.cos(a / 2)]
    numbers = [*pose, *[0.0] * 36, np.pi / 4, 0.0, 0.0, 0.0, 0.0, np.pi / 4, *[0.0] * 36]
    return ",".join(
        [str(1 + t // 4), str(t % 4 * 250_000_000), "odom", "base_link", *map(repr, numbers)]
    )


@pytest.mark.parametrize("name", ["odom.tum", "robot_pose.txt"])
def test_a_tum_trajectory_is_odometry_or_the_true_path(tmp_path, name):
    seen = {"b": SEEN, "h": AT_HOME}
    drive = imported(tmp_path, **{name: circle(tum)}, **seen)
    assert drive.odometry.v == pytest.approx([np.pi / 4] * 4 + [0])
    assert drive.odometry.omega == pytest.approx([np.pi / 4] * 4 + [0])
    files = write(tmp_path, **seen, **{"truth.tum": circle(tum)}, odometry=TWISTS)
    heading = drive_of(understand(files), "tum").truth.heading
    assert heading == pytest.approx(np.linspace(0, np.pi, 5))
    with pytest.raises(InputError, match="no odometry found"):
        drive_of(understand(files[:-1]), "tum")
    told = drive_of(understand(files, ["truth.tum: t=1[ms], x=2[cm]"]), "told").truth
    assert told.t == pytest.approx(np.arange(5) / 1000)
    assert told.x == pytest.approx(np.sin(np.linspace(0, np.pi, 5)) / 100)


def test_odometry_as_ros2_topic_echo_prints_it(tmp_path):
    seen = {"b": SEEN.replace("0.", "1."), "h": AT_HOME}
    drive = imported(tmp_path, echo=circle(echoed), **seen)
    assert drive.odometry.t.tolist() == [1.0, 1.25, 1.5, 1.75, 2.0]
    assert drive.odometry.v == pytest.approx([np.pi / 4] * 5)
    assert drive.odometry.omega == pytest.approx([np.pi / 4] * 5)
    # Poses alone, of a PoseStamped.
    cells = [row.split(",") for row in circle(echoed).splitlines()]
    alone = "".join(",".join([*row[:3], *row[4:11]]) + "\n" for row in cells)
    poses = imported(tmp_path, echo=alone, **seen).odometry
    assert poses.omega == pytest.approx([np.pi] * 4 + [0])


def test_a_column_may_be_told_by_its_whole_name_or_given_another_unit(tmp_path):
    file = write(tmp_path, a="Time [ms],v,w,when\n0,0.1,0,0\n1000,0.1,0,1\n")
    for text, unit in (("t=Time [ms]", "ms"), ("t=Time [ms][s]", "s"), ("t=when", "s")):
        found = understand(file, [text])["odometry"].columns["t"]
        assert (found.unit, found.source) == (unit, "specified")


def test_commas_may_stand_in_the_names_of_columns(tmp_path):
    file = write(tmp_path, a='when,"Speed, filtered",w\n0,0.1,0\n0.1,0.1,0\n')
    found = understand(file, ["t=when, v=Speed, filtered[m/s]"])
    names = [column.name for column in found["odometry"].columns.values()]
    assert names == ["when", "Speed, filtered", "w"]


def test_one_option_may_name_the_columns_of_several_files(tmp_path):
    paths = write(tmp_path, o="0,0.1,0\n0.1,0.1,0\n", b="0,A,100\n0.1,A,100\n")
    roles = "o.csv: t=1, v=2, omega=3, b.csv: t=1, landmark=2, bearing=3[gon]"
    assert understand(paths, [roles])["bearings"].table["bearing"] == pytest.approx(
        [math.pi / 2] * 2
    )


def test_home_bearings_in_radians_are_not_read_in_the_degrees_of_the_drive(tmp_path):
    texts = {
        "odometry": "t,v,w\n0,0.1,0\n0.1,0.1,0\n",
        "seen": "t,id,bearing\n0,A,12.5\n0.1,B,-80\n",
        "home": "id,bearing\nA,-3.1\nB,0.2\nC,2.0\n",
    }
    with pytest.raises(InputError, match=r"only 3.1, but .* in deg; give .*bearing=bearing\[rad\]"):
        imported(tmp_path, **texts)
    drive = imported(tmp_path, ["home.csv: bearing=bearing[rad]"], **texts)
    assert drive.home["C"].bearing == 2.0


def test_angles_of_no_unit_have_that_of_their_neighbours(tmp_path):
    """A deviation of 0.57 deg is none of 0.57 rad, nor is home ahead of a robot full of radians."""
    found = understand(
        write(
            tmp_path,
            odometry="t,v,w\n0,0.1,0\n0.1,0.1,0\n",
            seen="t,std,id,bearing\n0,0.57,A,12.5\n0.1,0.57,B,-80\n",
            home="id,bearing,std\nA,-3.5,0.57\nB,5.25,\n",
        )
    )
    drive = drive_of(found, "degrees")
    assert drive.sightings.sigma == pytest.approx(np.radians([0.57, 0.57]))
    assert drive.home["A"].bearing == pytest.approx(math.radians(-3.5))
    assert drive.home["A"].sigma == pytest.approx(math.radians(0.57))
    sigma, at_home = found["bearings"].columns["sigma"], found["home"].columns["bearing"]
    assert (sigma.unit, sigma.source) == ("deg", "as bearing")
    assert (at_home.unit, at_home.source) == ("deg", "as bearings")


@pytest.mark.parametrize(
    ("head", "factor", "columns"),
    [
        ("t,vx,vy,wz", 1.0, []),
        ("t,linear.x,linear.y,angular.z", 1.0, []),
        ("t,v [mm/s],vy,omega", 1e3, []),
        ("t,speed,lateral speed (cm/s),yaw rate", (1.0, 1e2), []),
        ("t,v,drift,omega", (1.0, -1e3), ["vy=-drift[mm/s]"]),
    ],
)
def test_the_sideways_speed_is_read(tmp_path, head, factor, columns):
    ahead, left = (factor, factor) if isinstance(factor, float) else factor
    rows = [f"{t / 10},{0.2 * ahead},{-0.1 * left},{0.3}" for t in range(30)]
    seen = table("t,landmark,bearing", [f"{t / 10},a,0.1" for t in range(30)])
    home = table("landmark,bearing", ["a,0.1"])
    odometry = imported(
        tmp_path, columns, odometry=table(head, rows), seen=seen, home=home
    ).odometry
    assert odometry.v == pytest.approx(np.full(30, 0.2))
    assert odometry.vy == pytest.approx(np.full(30, -0.1))


def test_numbers_may_head_the_columns_of_landmarks(tmp_path):
    seen, home = "t,7,12\n0,0.5,\n0.1,,-1.25\n", "landmark,bearing\n7,0.4\n12,0.1\n"
    drive = imported(tmp_path, odometry=TWISTS, seen=seen, home=home)
    assert drive.sightings.landmark.tolist() == ["7", "12"]
    assert drive.sightings.bearing.tolist() == [0.5, -1.25]


def test_a_bag_as_ros_prints_it_has_unix_time_in_nanoseconds(tmp_path):
    head = "%time,field.header.seq,field.twist.twist.linear.x,field.twist.twist.angular.z"
    stamps = (1_700_000_000_000_000_000, 1_700_000_000_050_000_000)
    seen = "stamp,id,bearing\n1700000000000000000,A,0.5\n"
    odom = table(head, (f"{t},1,0.1,0.2" for t in stamps))
    found = understand(write(tmp_path, home="id,bearing\nA,0.4\n", seen=seen, odom=odom))
    assert found["odometry"].range_of("t") == "1700000000 to 1700000000.05 s"
    drive = drive_of(found, "bag")
    assert drive.settings.epoch == 1_700_000_000
    assert drive.odometry.t == pytest.approx([0.0, 0.05], abs=1e-6)
    assert drive.sightings.t.tolist() == [0.0]


TWISTS = "t,v,omega\n0,0.1,0.2\n0.5,0.2,-0.1\n1,0.3,0\n"
SEEN = "t,landmark,bearing\n0.25,L1,0.5\n0.25,L2,-1.25\n0.75,L1,0.75\n"
AT_HOME = "landmark,bearing\nL1,0.25\nL2,-0.5\n"
ODDITIES = {
    "German": {
        "odometry": "Zeit;Geschwindigkeit;Drehrate\n0;0,1;0,2\n0,5;0,2;-0,1\n1;0,3;0\n",
        "bearings": "Zeit;Landmarke;Peilung\n0,25;L1;0,5\n0,25;L2;-1,25\n0,75;L1;0,75\n",
        "home": "Marke;Winkel (°)\nL1;14,32394487827058\nL2;-28,64788975654116\n",
    },
    "French": {
        "odometry": "temps;vitesse;vitesse angulaire\n0;0,1;0,2\n0,5;0,2;-0,1\n1;0,3;0\n",
        "bearings": "Temps;Balise;Relèvement\n0,25;L1;0,5\n0,25;L2;-1,25\n0,75;L1;0,75\n",
        "home": "Balise;Angle (°)\nL1;14,32394487827058\nL2;-28,64788975654116\n",
    },
    "a column a landmark": {
        "bearings": "t,L1,L2\n0.25,0.5,-1.25\n0.75,0.75,\n",
        "home": "L1,L2\n0.25,-0.5\n",
    },
    "named columns of bearings": {
        "bearings": "time,bearing_L1_rad,bearing_L2_rad\n0.25,0.5,-1.25\n0.75,0.75,NaN\n",
    },
    "all in one": {
        "odometry": "t,v,omega,L1,L2\n0,0.1,0.2,,\n0.25,,,0.5,-1.25\n0.5,0.2,-0.1,,\n"
        "0.75,,,0.75,\n1,0.3,0,,\n",
        "bearings": None,
    },
    "units below": {
        "odometry": "t,v,omega\nms,mm/s,rad/s\n0,100,0.2\n500,200,-0.1\n1000,300,0\n",
        "bearings": "t,id,angle\n[ms],-,[rad]\n250,L1,0.5\n250,L2,-1.25\n750,L1,0.75\n",
    },
    "titles above": {
        "odometry": "Log of Monday\n\nt;v;omega\n0;0.1;0.2;\n0.5;0.2;-0.1;\n1;0.3;0;\n",
    },
    "holes": {
        "odometry": TWISTS + "1.2,n/a,0\n",
        "bearings": SEEN + "0.8,L2,-\n",
    },
    "sorted by landmark": {
        "bearings": "t,id,bearing\n0.25,L1,0.5\n0.75,L1,0.75\n0.25,L2,-1.25\n",
    },
    "a row too late": {
        "odometry": "t,v,omega\n0,0.1,0.2\n1,0.3,0\n0.5,0.2,-0.1\n",
    },
    "thousands": {
        "odometry": "t [ms];v;omega\n0;0,1;0,2\n500;0,2;-0,1\n1.000,0;0,3;0\n",
        "bearings": SEEN.replace("t,", "t [s],"),
    },
    "seconds and nanoseconds": {
        "odometry": "stamp.sec,stamp.nanosec,linear.x,angular.z\n"
        "0,0,0.1,0.2\n0,500000000,0.2,-0.1\n1,0,0.3,0\n",
    },
    "velocities": {
        "odometry": "Time (s),Linear velocity (m/s),Angular velocity (rad/s)\n"
        + TWISTS.partition("\n")[2],
    },
}


@pytest.mark.parametrize("odd", ODDITIES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_oddities_are_understood(tmp_path, odd, encoding):
    texts = {"odometry": TWISTS, "bearings": SEEN, "home": AT_HOME} | ODDITIES[odd]
    for name, text in texts.items():
        if text is not None:
            (tmp_path / f"{name}.csv").write_bytes(text.encode(encoding))
    drive = drive_of(understand(sorted(tmp_path.iterdir())), "odd")
    assert drive.odometry.t == pytest.approx([0, 0.5, 1])
    assert drive.odometry.v == pytest.approx([0.1, 0.2, 0.3])
    assert drive.odometry.omega == pytest.approx([0.2, -0.1, 0])
    assert drive.sightings.t.tolist() == [0.25, 0.25, 0.75]
    assert drive.sightings.landmark.tolist() == ["L1", "L2", "L1"]
    assert drive.sightings.bearing == pytest.approx([0.5, -1.25, 0.75])
    assert {i: s.bearing for i, s in drive.home.items()} == pytest.approx({"L1": 0.25, "L2": -0.5})
    lacking = {reason: n for reason, n in drive.remarks.items() if "incomplete" in reason}
    assert len(lacking) == (2 if odd == "holes" else 0)


def test_dates_are_unix_time_and_numbers_are_names(tmp_path):
    drive = imported(
        tmp_path,
        odometry="time,v,omega\n2026-11-23 12:00:00.5,0.1,0\n2026-11-23 12:00:01,0.1,0\n",
        bearings="time,id,bearing\n2026-11-23T13:00:00.75+01:00,3.0,0.5\n",
        home="id,bearing\n3,0.25\n",
    )
    assert drive.settings.epoch == 1795435200
    assert drive.odometry.t.tolist() == [0.5, 1.0]
    assert drive.sightings.t.tolist() == [0.75]
    assert drive.sightings.landmark.tolist() == [*drive.home] == ["3"]


@pytest.mark.parametrize("day", ["2026-11-23", "23.11.2026"])
def test_a_date_and_its_time_of_day_may_have_a_column_each(tmp_path, day):
    drive = imported(
        tmp_path,
        odometry=f"date,time,v,omega\n{day},12:00:00.5,0.1,0\n{day},12:00:01,0.1,0\n",
        bearings=f"date,time,id,bearing\n{day},12:00:00.75,3,0.5\n",
        home="id,bearing\n3,0.25\n",
    )
    assert drive.settings.epoch == 1795435200
    assert drive.odometry.t.tolist() == [0.5, 1.0]
    assert drive.sightings.t.tolist() == [0.75]


def test_a_row_of_home_bearings_below_numbers_of_landmarks_is_a_table(tmp_path):
    seen = table("t,id,bearing", (f"{k},{k % 4 + 1},0.1" for k in range(8)))
    drive = imported(
        tmp_path,
        odometry="t,v,omega\n0,0.1,0\n1,0.1,0\n",
        bearings=seen,
        home="1,2,3,4\n0.25,-1.5,2.0,0.5\n",
    )
    bearings = {name: seen.bearing for name, seen in drive.home.items()}
    assert bearings == {"1": 0.25, "2": -1.5, "3": 2.0, "4": 0.5}


@pytest.mark.parametrize(("unit", "is_counted"), [("rad", True), ("deg", True), ("deg", False)])
@pytest.mark.parametrize("direction", [1, -1])
def test_headings_beyond_a_turn_have_the_unit_that_fits_the_path(
    tmp_path, unit, is_counted, direction
):
    angle = np.arange(0.0, 20.0, 0.02)
    noise = np.random.default_rng(1).normal(0, 1e-3, (2, angle.size))
    x, y = 0.5 * np.sin(angle) + noise[0], -0.5 * np.cos(angle) + noise[1]
    heading = (angle if is_counted else np.angle(np.exp(1j * angle))) * (
        np.degrees(1.0) if unit == "deg" else 1.0
    )
    rows = zip(0.1 * np.arange(angle.size), direction * x, direction * y, heading, strict=True)
    path = write(tmp_path, odom=table("t,x,y,theta", (f"{t},{a},{b},{c}" for t, a, b, c in rows)))
    (poses,) = understand(path).values()
    found = poses.columns["heading"]
    assert (found.unit, found.source) == (unit, "guessed: along the path")


def test_poses_are_odometry_where_the_file_says_so_and_else_the_truth(tmp_path):
    """Half a turn to the left on a circle of 1 m, as quaternions; and the truth as TUM has it."""
    head = "t,position.x,position.y,orientation.x,orientation.y,orientation.z,orientation.w\n"
    rows = circle(lambda t, a: ",".join(tum(t, a).split(" 0 ", 1)).replace(" ", ","))
    truth = "# timestamp tx ty tz qx qy qz qw\n" + circle(tum)
    texts = {"my-odom.csv": head + rows, "mocap.txt": truth, "b.csv": SEEN, "h.csv": AT_HOME}
    drive = imported(tmp_path, **texts)
    assert drive.odometry.v == pytest.approx([np.pi / 4] * 4 + [0])
    assert drive.odometry.omega == pytest.approx([np.pi / 4] * 4 + [0])
    assert drive.truth.heading == pytest.approx(np.linspace(0, np.pi, 5))
    level = [line.split(" ") for line in truth.splitlines()[1:]]
    planar = "t,x,y,qz,qw\n" + "\n".join(",".join([*r[:3], *r[-2:]]) for r in level)
    drive = imported(tmp_path, **texts | {"mocap.txt": planar})
    assert drive.truth.heading == pytest.approx(np.linspace(0, np.pi, 5))
    (tmp_path / "my-odom.csv").rename(tmp_path / "robot_pose.csv")
    drive = drive_of(understand(sorted(tmp_path.iterdir())), "poses")
    assert drive.odometry.v == pytest.approx([np.pi / 4] * 4 + [0])
    assert any("robot_pose.csv used as odometry" in reason for reason in drive.remarks)


def test_odometry_and_bearings_may_share_a_file(tmp_path):
    log = "t,v,w,id,bearing\n0,0.1,0,,\n0.05,,,A,0.3\n0.1,0.2,0,,\n"
    drive = imported(tmp_path, log=log, home="id,bearing\nA,0.4\n")
    assert drive.odometry.v.tolist() == [0.1, 0.2]
    assert drive.sightings.landmark.tolist() == ["A"]


@pytest.mark.parametrize(
    ("name", "quantity", "unit"),
    [
        *(("Time (ms)", "time", "ms"), ("t_us", "time", "us"), ("time", "time", None)),
        *(("v_mm_s", "speed", "mm/s"), ("w [°/s]", "rate", "deg/s"), ("yaw_rate", "rate", None)),
        *(("angle_degrees", "angle", "deg"), ("bearing", "angle", None), ("x mm", "length", "mm")),
        ("v [rad/s]", "speed", None),
    ],
)
def test_units_in_names(name, quantity, unit):
    assert unit_in(name, quantity) == unit


@pytest.mark.parametrize(
    ("text", "columns", "complaint"),
    [
        ("", (), "empty file"),
        ("alone\n1\n2\n", (), "not a table"),
        (
            "a,b\n1,2\n3,4\n",
            (),
            r"not recognised as odometry \(time, speed, yaw rate; or wheels\), detections \(time, "
            r"landmark id, bearing, position or pixels\), .* 't=A, landmark=B, bearing=C'",
        ),
        (
            ",".join(f"c{k}" for k in range(89)) + ("\n" + "1," * 88 + "1") * 2,
            (),
            r"'c11', \.\.\. \(89 in all\)",
        ),
        ("t,v,w\n0,1,0\n0.1,x,0\n", (), "row 3: v: must be a finite number, not 'x'"),
        ("t,v,w\n0,,0\n0.1,,0\n", (), "no row has values for all of t, v, omega"),
        ("t;v;w\n0,5;1;0\n1.000;1;0\n", (), "row 3: t: '1.000' has a point"),
        ("t,v,w\n9,1,0\n0,1,0\n", (), "no bearings found"),
        (
            "t,v,w\n0,1,0\n2,1,0\n1.5,1,0\n3,1,0\n0,1,0\n",
            (),
            "row 6: time runs backwards by 3 s: 0.0 after 3.0, by more than 1 s",
        ),
        ("bearing_a,bearing_b\n0,0\n", (), "row 2: two bearings of exactly 0"),
        ("bearing_a [deg],bearing_b [rad]\n1,2\n", (), "different units: deg, rad"),
        ("a,b\n1,2\n", (), "not recognised as"),
        ("t,v,w\n0,1,0\n0.1,1,0\n0.2,1\n", (), "row 4: 2 fields, but the header has 3"),
        ("# made by hand\nt,v,w\n0,1,0\n0.1,inf,0\n", (), "row 4"),
        ("t,v,w\n0,300,0\n", (), "too fast for m/s; give its unit"),
        ("t,front_vel,rear_vel,w\n0,1,1,0\n", (), "or 'v=rear_vel'"),
        ("t,v,w\n0,1,0\n", ("v=speed",), "no file has a column 'speed'"),
        ("t,v,w\n0,1,0\n", ("v=v[furlong]",), "units of v are m/s"),
        ("t,v,w\n0,1,0\n", ("mass=v",), "the role must be one of"),
        ("t,v,w\n0,1,0\n", ("v",), "must have the form ROLE=COLUMN"),
        ("t,v,w\n0,1,0\n", (), "no bearings found"),
        ('t,v,w\n0,1,0\n0,1,0\n0,"1,0\n', (), "not CSV: unexpected end of data"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, columns, complaint):
    with pytest.raises(InputError, match=complaint) as found:
        imported(tmp_path, columns, odd=text)
    assert len(str(found.value).splitlines()) == 1


def test_too_many_columns_are_refused_and_5000_landmarks_are_imported_and_drawn(tmp_path):
    for count in (100_000, 1_000_000):
        with pytest.raises(InputError, match="columns; at most 10,000 are allowed"):
            understand(write(tmp_path, commas="," * count + "\n"))
    ids = [f"L{k}" for k in range(5000)]
    wide, home = (
        f"t,{','.join(ids)}\n0{',0.5' * 5000}\n",
        table("id,bearing", (f"{i},0.5" for i in ids)),
    )
    drive = imported(tmp_path, odometry=TWISTS, wide=wide, home=home)
    assert drive.sightings.t.size == len(drive.home) == 5000
    png(draw_drive(drive))


@pytest.mark.parametrize("data", [b"\xff\xfe\x00", b"\x00" * 5000, b"a;b\n" * 3])
def test_no_bytes_make_it_stumble(tmp_path, data):
    file = tmp_path / "junk.csv"
    file.write_bytes(data)
    with pytest.raises(InputError):
        understand([file])


@given(
    st.lists(st.text("tvwxy id,;\t|\"'#%-.019e\n[ms]ΩNa", max_size=40), min_size=1, max_size=12),
    st.lists(st.text("t=vw[ms]-,x", max_size=12), max_size=2),
)
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_whatever_stands_in_it_there_is_an_answer_or_one_line(tmp_path, lines, columns):
    file = tmp_path / "any.csv"
    file.write_text("t,v,w\n" + "\n".join(lines), encoding="utf-8")
    said = ""
    try:
        found = understand([file], columns)
        assert all(list(one.rows()) for one in found.values())
    except InputError as error:
        said = str(error)
    assert len(said.splitlines()) <= 1


def test_stamps_of_one_clock_in_two_units_are_understood(tmp_path):
    odom = (f"{1_700_000_000_000_000_000 + k * 100_000_000},1,0" for k in range(50))
    seen = (f"{1_700_000_000 + k / 10},a,0.5" for k in range(50))
    tables = {"odom": table("t,v,w", odom), "seen": table("t,id,angle", seen)}
    drive = imported(tmp_path, **tables, home="id,angle\na,0.3\n")
    assert drive.span == pytest.approx((0.0, 4.9), abs=1e-3)


def test_a_hole_among_dates_is_a_row_left_out(tmp_path):
    hours = ["2026-11-23 12:00:00", "", "nan", "2026-11-23 12:00:00.5"]
    found = understand(write(tmp_path, odom=table("date,v,w", (f"{h},1,0" for h in hours))))
    assert found["odometry"].table["t"].tolist() == [1795435200.0, 1795435200.5]
    with pytest.raises(InputError, match="must be a number or a time like 2026-11-23 12:00"):
        understand(write(tmp_path, odom="date,v,w\nNov 23 2026 12:00:00,1,0\n"))


@pytest.mark.parametrize(
    ("noon", "later"),
    [
        ("23/11/2026 12:00:00", "23/11/2026 12:00:00.5"),
        ("11/23/2026 12:00:00", "11/23/2026 12:00:00.5"),
        ("2026/11/23 12:00:00", "2026/11/23 12:00:00.5"),
        ("12:00:00", "12:00:00.5"),
    ],
)
def test_times_may_have_slashes_or_no_date(tmp_path, noon, later):
    found = understand(write(tmp_path, odom=f"time,v,w\n{noon},1,0\n{later},1,0\n"))
    first, last = found["odometry"].table["t"].tolist()
    assert (first % 86400, last - first) == (43200, 0.5)


def test_a_date_that_may_have_the_month_first_is_refused(tmp_path):
    with pytest.raises(InputError, match="may have the day or the month first; write 2026-11-23"):
        understand(write(tmp_path, odom="date,v,w\n11/12/2026 12:00:00,1,0\n"))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_text_files_of_windows_are_read(tmp_path, encoding):
    file = tmp_path / "odom.csv"
    file.write_bytes("sep=;\nt;v;w\n0,0;1,0;0,1\n0,1;1,0;#NUM!\n0,2;1,0;0,1\n".encode(encoding))
    found = understand([file])
    assert found["odometry"].table["t"].tolist() == [0.0, 0.2]


def test_an_unnamed_index_of_times_has_the_stamps(tmp_path):
    text = ",v,w\n2026-11-23 12:00:00+00:00,1,0\n2026-11-23 12:00:00.5+00:00,1,0\n"
    assert len(understand(write(tmp_path, odom=text))["odometry"].table) == 2


def test_fields_of_topics_in_one_table_are_landmarks(tmp_path):
    rows = (f"{k},1,0,{0.01 * k},,1\n" for k in range(9))
    text = "__time,/odom/v,/odom/w,/bearings/L1,/tags/L2/bearing,/bearings/L3\n" + "".join(rows)
    found = understand(write(tmp_path, log=text, home="id,bearing\nL1,0\nL2,1\nL3,2\n"))
    seen = found["bearings"].table
    assert set(seen["landmark"].tolist()) == {"L1", "L3"}


@pytest.mark.parametrize(
    ("seen", "advice"),
    [
        ('t,ids,bearings\n0,"[1, 2]","[0.1, 0.2]"\n1,"[3]","[0.1]"\n', "values in the lists"),
        ("t,a_x,a_y,b_x,b_y,c_x,c_y\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n", "positions, with the time"),
    ],
)
def test_several_landmarks_in_a_row_are_refused_with_the_form_to_write(tmp_path, seen, advice):
    with pytest.raises(InputError, match=f"write a row for each of the {advice}"):
        understand(write(tmp_path, odom="t,v,w\n0,1,0\n", seen=seen))


@pytest.mark.parametrize(("unit", "step"), [("ms", 50), ("s", 0.05)])
def test_stamps_of_two_clocks_with_one_unit_named_have_a_unit_each(tmp_path, unit, step):
    rows = (f"{k * step:g},1,0.1" for k in range(400))
    odom = table(f"time [{unit}],v,w", rows)
    seen = table("t,landmark,bearing", (f"{0.2 * k:g},a,0.1" for k in range(100)))
    found = understand(write(tmp_path, odom=odom, seen=seen))
    stamps = found["bearings"].table["t"]
    assert stamps[-1] == pytest.approx(19.8)


@pytest.mark.parametrize(
    ("home", "says"),
    [
        (["1", "2", "3"], []),
        (["1", "2"], ["2 of the 3 landmarks", "home has '1' and '2'."]),
        (["001", "002", "003"], ["0 of the 3 landmarks", "the drive has '1', '2' and '3'; home"]),
        (["1", "2", "3", "4"], []),
    ],
)
def test_who_calls_landmarks_at_home_otherwise_is_told(tmp_path, home, says):
    seen = "t,id,angle\n0,1,0\n0,2,1\n0,3,2\n"
    at_home = table("id,angle", (f"{name},0.1" for name in home))
    told = home_warnings(imported(tmp_path, odom=TWISTS, seen=seen, home=at_home))
    assert len(told) == bool(says)
    assert all(words in told[0] for words in says)


@pytest.mark.parametrize(
    ("head", "factor"), [("range", 1.0), ("distance", 1.0), ("dist_cm", 100.0), ("depth", 1000.0)]
)
def test_a_column_of_distances_becomes_ranges(tmp_path, head, factor):
    rows = [(0.1 * i, "ab"[i % 2], 0.2, 1.5 + 0.1 * i) for i in range(20)]
    lines = [f"{t:.1f},{name},{bearing},{factor * r:.6g}" for t, name, bearing, r in rows]
    drive = imported(
        tmp_path,
        tags=table(f"t,id,bearing,{head}", lines),
        odometry=table("t,v,omega", (f"{0.1 * i:.1f},0.2,0.1" for i in range(20))),
        home="landmark,bearing\na,0.1\nb,0.2",
    )
    assert drive.sightings.range == pytest.approx([r for *_, r in rows], rel=1e-5)


def test_home_bearings_recorded_for_some_seconds_are_averaged(tmp_path):
    home = "t,landmark,bearing\n0,L1,0.25\n0,L2,3.14\n1,L1,0.27\n1,L2,-3.14\n"
    files = write(tmp_path, odometry=TWISTS, bearings=SEEN, home=home)
    with pytest.raises(InputError, match=r"use --as home\.csv=KIND .* such as home"):
        understand(files)
    drive = drive_of(understand(files, (), ["home.csv=home"]), "")
    assert drive.home["L1"].bearing == pytest.approx(0.26)
    assert abs(drive.home["L2"].bearing) == pytest.approx(math.pi)
    assert "4 rows of home bearings, averaged for each landmark" in drive.remark_lines
    files[2].write_text("landmark,bearing\nL1,0.25\nL1,0.75\n")
    with pytest.raises(InputError, match="row 3: landmark: 'L1' already has a row"):
        drive_of(understand(files), "")


def test_the_camera_of_each_bearing_is_kept(tmp_path):
    seen = ["0,A,front,0.1,3", "0,B,rear,0.2,4", "1,A,front,0.15,3"]
    drive = imported(
        tmp_path,
        odometry=TWISTS,
        seen=table("t,tag,camera,angle,camera_x", seen),
        home="tag,angle,cam\nA,0.1,front\nB,0.2,rear\n",
    )
    assert drive.sightings.camera.tolist() == ["front", "rear", "front"]
    assert {name: home.camera for name, home in drive.home.items()} == {"A": "front", "B": "rear"}
    with pytest.raises(InputError, match=r"cameras 'front' and 'rear'.*add cameras:"):
        with_first_camera(drive.settings, drive)


def test_clockwise_bearings_of_two_cameras_are_found(tmp_path):
    """The cameras, of different yaw, see the same landmarks in turn."""
    t = np.arange(0.0, 40.0, 0.5)
    odometry = table("t,v,omega", (f"{at},0.0,0.3" for at in t))
    names, yaws, seen = ("front", "rear"), (0.0, 2.0), []
    for k, at in enumerate(t):
        for tag, place in enumerate((0.3, 2.0, 4.0)):
            bearing = -wrap(place - 0.3 * at - yaws[k % 2])
            seen.append(f"{at},{tag},{names[k % 2]},{bearing}")
    seen = table("t,tag,camera,bearing", seen)
    found = understand(write(tmp_path, odometry=odometry, seen=seen))
    assert any("bearings with changed sign" in reason for reason in found["bearings"].remarks)
    drive = drive_of(found, "", home_needed=False)
    write_folder(drive, tmp_path / "drive")
    assert (
        read_folder(tmp_path / "drive", home_needed=False).remarks[SIGNS_CHANGED]
        == drive.sightings.t.size
    )
