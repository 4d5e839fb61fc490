"""Imported odometry from wheels, steering, steps and gyroscopes."""

import math

import numpy as np
import pytest

from homeward.drives.columns import words_in
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.settings import Wheels
from homeward.drives.wheels import CONTRADICT, WRAPPED, wheel_roles
from homeward.errors import InputError

T = np.arange(0.0, 30.0, 0.1)
V = 0.2 + 0.1 * np.sin(0.3 * T)
OMEGA = 0.5 * np.sin(0.2 * T)
WHEELS = Wheels(wheel_radius=0.05, track_width=0.4, ticks_per_turn=1000, wheelbase=0.5)
SPEEDS = V + np.array([[-0.2], [0.2]]) * OMEGA
TRAVEL = np.cumsum(np.pad(SPEEDS[:, :-1] * 0.1, ((0, 0), (1, 0))), axis=1)
TICKS = np.round(TRAVEL / (0.05 * 2 * np.pi / 1000))


def imported(folder, names, *columns, wheels=WHEELS, roles=(), more=(), kinds=()):
    """The drive of a table with stamps and these columns."""
    rows = zip(*(np.asarray(c).tolist() for c in (T, *columns)), strict=True)
    text = "\n".join([f"t,{names}", *(",".join(map(repr, row)) for row in rows)])
    (folder / "wheels.csv").write_text(text.replace("nan", "") + "\n")
    (folder / "b.csv").write_text("t,landmark,bearing\n0.1,A,0.5\n0.2,A,0.5\n")
    (folder / "h.csv").write_text("landmark,bearing\nA,0.4\n")
    files = [folder / name for name in ("wheels.csv", "b.csv", "h.csv", *more)]
    found = understand(files, roles, kinds, wheels)
    return drive_of(found, "wheels", wheels=wheels)


def assert_same(odometry, tolerance=1e-6):
    assert odometry.v[:-1] == pytest.approx(V[:-1], abs=tolerance)
    assert odometry.omega[:-1] == pytest.approx(OMEGA[:-1], abs=tolerance / 0.2)


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("left_wheel_angle,right_wheel_angle", TRAVEL / 0.05),
        ("wheel_left_joint/position,wheel_right_joint/position", TRAVEL / 0.05),
        ("left_deg,right_deg", np.degrees(TRAVEL / 0.05)),
        ("left wheel [rev],right wheel [rev]", TRAVEL / 0.05 / (2 * np.pi)),
        ("left_distance_mm,right_distance_mm", 1e3 * TRAVEL),
        ("vl [m/s],vr [m/s]", SPEEDS),
        ("omega_l,omega_r", SPEEDS / 0.05),
        ("left_rad_per_s,right_rad_per_s", SPEEDS / 0.05),
        ("leftRpm,rightRpm", SPEEDS / 0.05 * 60 / (2 * np.pi)),
        ("left_vel_mm_s,right_vel_mm_s", 1e3 * SPEEDS),
        ("w_left_rad_s,w_right_rad_s", SPEEDS / 0.05),
        ("d_left [m],d_right [m]", np.diff(TRAVEL, axis=1, prepend=0.0)),
    ],
)
def test_wheels_in_each_unit_are_the_same_odometry(tmp_path, names, values):
    assert_same(imported(tmp_path, names, *values).odometry)


@pytest.mark.parametrize(
    "names",
    [
        *("left_ticks,right_ticks", "leftticks,rightticks", "encoder_l,encoder_r", "encL,encR"),
        *("left,right", "Left Encoder,Right Encoder", "ticks_left,ticks_right", "L,R"),
    ],
)
def test_counts_of_encoders(tmp_path, names):
    drive = imported(tmp_path, names, *TICKS.astype(int))
    assert_same(drive.odometry, 4e-3)
    steps = np.diff(TICKS.astype(int), axis=1, prepend=0)
    assert_same(imported(tmp_path, "dl,dr", *steps).odometry, 4e-3)


def test_counters_that_wrap_round_or_restart(tmp_path):
    for shift, span in ((2**15, 2**15), (2**16 - 1000, 2**16)):
        wrapped = imported(tmp_path, "left_ticks,right_ticks", *((TICKS + shift - 500) % span))
        assert_same(wrapped.odometry, 4e-3)
        assert wrapped.remarks[WRAPPED] == 2
    again = TICKS.astype(int)
    again[:, 150:] -= again[:, 150:151]
    reset = imported(tmp_path, "left_ticks,right_ticks", *again)
    assert np.flatnonzero(np.isnan(reset.odometry.v)).tolist() == [149]


VY = 0.15 * np.cos(0.4 * T)
REACH = (0.4 + 0.5) / 2
MECANUM = V + np.outer([-1, 1, 1, -1], VY) + np.outer([-1, 1, -1, 1], REACH * OMEGA)
"""Speeds of the wheels front left, front right, rear left and rear right, rollers as an X."""
MECANUM_TRAVEL = np.cumsum(np.pad(MECANUM[:, :-1] * 0.1, ((0, 0), (1, 0))), axis=1)


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("fl_ticks,fr_ticks,rl_ticks,rr_ticks", np.round(MECANUM_TRAVEL * 1000 / (0.1 * np.pi))),
        ("lf_rev,rf_rev,lb_rev,rb_rev", MECANUM_TRAVEL / (0.1 * np.pi)),
        (
            "front_left_wheel_angle,front_right_wheel_angle,back_left_wheel_angle,"
            "back_right_wheel_angle",
            MECANUM_TRAVEL / 0.05,
        ),
        ("wheel_FL_rpm,wheel_FR_rpm,wheel_BL_rpm,wheel_BR_rpm", MECANUM * 30 / 0.05 / np.pi),
        ("d_fl_m,d_fr_m,d_rl_m,d_rr_m", np.diff(MECANUM_TRAVEL, axis=1, prepend=0.0)),
    ],
)
def test_four_wheels_of_a_mecanum_drive(tmp_path, names, values):
    drive = imported(tmp_path, names, *values)
    tolerance = 4e-3 if "ticks" in names else 1e-6
    assert_same(drive.odometry, tolerance)
    assert drive.odometry.vy[:-1] == pytest.approx(VY[:-1], abs=tolerance)
    wheels = WHEELS.model_copy(update={"wheelbase": None})
    with pytest.raises(InputError, match="requires wheelbase"):
        imported(tmp_path, names, *values, wheels=wheels)


def test_rollers_of_a_mecanum_drive_at_another_angle(tmp_path):
    """The wheel's own speed along the axle of a roller is that of the ground."""
    angle = math.radians(60.0)
    cot = 1.0 / math.tan(angle)
    reach = (0.4 + 0.5 * cot) / 2
    wheels = V + np.outer([-1, 1, 1, -1], cot * VY) + np.outer([-1, 1, -1, 1], reach * OMEGA)
    given = WHEELS.model_copy(update={"roller_angle": angle})
    drive = imported(tmp_path, "fl_m_s,fr_m_s,rl_m_s,rr_m_s", *wheels, wheels=given)
    assert_same(drive.odometry)
    assert drive.odometry.vy[:-1] == pytest.approx(VY[:-1], abs=1e-6)


@pytest.mark.parametrize(("count", "first"), [(3, None), (4, None), (3, 0.0), (3, 3.0)])
@pytest.mark.parametrize("by", ["wheel", "speed"])
def test_omni_wheels_on_a_circle(tmp_path, count, first, by):
    """A wheel at (x, y) rolls by the ground's speed there, anti-clockwise about the centre."""
    angle = (math.pi / count if first is None else first) + math.tau * np.arange(count) / count
    x, y = 0.2 * np.cos(angle)[:, None], 0.2 * np.sin(angle)[:, None]
    along = (V - OMEGA * y) * -np.sin(angle)[:, None] + (VY + OMEGA * x) * np.cos(angle)[:, None]
    turned = np.cumsum(np.pad(along[:, :-1] * 0.1, ((0, 0), (1, 0))), axis=1) / 0.05
    wheels = Wheels(wheel_radius=0.05, omni_radius=0.2, omni_angle=first)
    names = [f"motor{k}" for k in range(count)]
    unit = "rad" if by == "wheel" else "rad/s"
    roles = [f"omni_{k + 1}_{by}={name}[{unit}]" for k, name in enumerate(names)]
    values = turned if by == "wheel" else along / 0.05
    drive = imported(tmp_path, ",".join(names), *values, wheels=wheels, roles=roles)
    assert_same(drive.odometry)
    assert drive.odometry.vy[:-1] == pytest.approx(VY[:-1], abs=1e-6)
    lacks = Wheels(wheel_radius=0.05)
    with pytest.raises(InputError, match="requires omni_radius"):
        imported(tmp_path, ",".join(names), *values, wheels=lacks, roles=roles)


def test_two_of_four_wheels_of_a_skid_steered_robot(tmp_path):
    names, roles = (
        "fl_ticks,fr_ticks,rl_ticks,rr_ticks",
        "left_wheel=fl_ticks, right_wheel=rr_ticks",
    )
    assert_same(imported(tmp_path, names, *TICKS, *TICKS, roles=[roles]).odometry, 4e-3)


def test_steering_and_steps(tmp_path):
    steering = np.arctan(OMEGA * 0.5 / V)
    assert_same(imported(tmp_path, "speed,steering_angle", V, steering).odometry)
    assert_same(imported(tmp_path, "speed,steering_deg", V, np.degrees(steering)).odometry)
    moved = [np.append(0.0, 0.1 * column[:-1]) for column in (V, OMEGA)]
    drive = imported(tmp_path, "delta_distance,delta_yaw", *moved, wheels=None)
    assert_same(drive.odometry)


@pytest.mark.parametrize(
    ("names", "values", "wheels", "complaint"),
    [
        ("left_ticks,right_ticks", TICKS, {}, "requires wheel_radius, ticks_per_turn, track_width"),
        ("v_left,v_right", SPEEDS, {}, r"requires track_width .* --wheels track_width=0\.16"),
        ("speed,steering", SPEEDS, {"track_width": 1}, "requires wheelbase"),
        ("v,omega", SPEEDS, {"track_width": 1}, "--wheels: not needed"),
        ("v_left,v_right", SPEEDS, {"wheel_radius": 1, "track_width": 1}, "in m/s, or in rad/s"),
        ("v_left,v_right", 99 * SPEEDS, {"track_width": 1}, r"too fast for m/s.*left_speed=v_left"),
        ("left_enc,right_enc", TRAVEL, {}, r"may be in ticks, rad or m.*left_wheel=left_enc\[rad"),
        ("left [m],right_ticks", [TRAVEL[0], TICKS[1]], {}, "'left .m.' is in m, 'right_ticks' in"),
        (
            "wl,wr",
            SPEEDS,
            {"track_width": 1},
            r"'wl' \[rad/s\] .* requires wheel_radius .* --wheels",
        ),
        ("left_ticks,right_ticks", 1e3 * TICKS, WHEELS.model_dump(), "wheels reach .* --wheels"),
        ("front_left_ticks,left_ticks2,right_ticks", [*TICKS, TICKS[0]], {}, "may both be left_wh"),
        ("left_ticks,right_ticks", np.full((2, 300), np.nan), {}, "no row has values for all"),
    ],
)
def test_wheels_with_unclear_units_or_geometry_are_refused(
    tmp_path, names, values, wheels, complaint
):
    with pytest.raises(InputError, match=complaint) as error:
        imported(tmp_path, names, *np.asarray(values), wheels=Wheels(**wheels))
    assert "\n" not in str(error.value)


def test_commands_are_no_measurements(tmp_path):
    drive = imported(tmp_path, "cmd_left,cmd_right,v,omega", *SPEEDS, V, OMEGA, wheels=None)
    assert_same(drive.odometry)
    assert not wheel_roles(words_in("left_speed_target"))


@pytest.mark.parametrize(
    "name", ["bearing_L1", "bearing_left_rad", "left", "tag_right", "x", "angle_left_door_right"]
)
def test_other_columns_are_no_wheels(name):
    assert not wheel_roles(words_in(name))


def test_an_encoder_that_counts_backwards_is_reported(tmp_path):
    left, right = TICKS.astype(int)
    drive = imported(tmp_path, "left_ticks,right_ticks", left, -right)
    (reason,) = (reason for reason in drive.remarks if "opposite directions" in reason)
    assert "'right_wheel=-right_ticks'" in reason
    corrected = imported(
        tmp_path, "left_ticks,right_ticks", left, -right, roles=["right_wheel=-right_ticks"]
    )
    assert_same(corrected.odometry, 4e-3)
    assert not any("opposite directions" in reason for reason in corrected.remarks)


def turning(folder):
    """Write what a robot sees that moves as `V` and `OMEGA`; return the files of it."""
    heading = np.cumsum(np.append(0.0, OMEGA[:-1] * 0.1))
    x, y = (np.cumsum(np.append(0.0, V[:-1] * 0.1 * f(heading[:-1]))) for f in (np.cos, np.sin))
    rows = []
    for k in range(0, T.size, 2):
        for i, (a, b) in enumerate(((6.0, 1.0), (-3.0, 5.0), (2.0, -5.0))):
            angle = np.arctan2(b - y[k], a - x[k]) - heading[k]
            rows.append(f"{T[k]:.1f},L{i},{math.remainder(angle, 2 * math.pi):.5f}")
    (folder / "seen.csv").write_text("\n".join(["t,landmark,bearing", *rows, ""]))
    (folder / "home.csv").write_text("landmark,bearing\nL0,0.165\nL1,2.111\nL2,-1.190\n")
    return folder / "seen.csv", folder / "home.csv"


@pytest.mark.parametrize("names", ["left_angle,right_angle", "fl_angle,fr_angle,rl_angle,rr_angle"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_motors_mounted_as_mirror_images_are_refused_with_their_columns(tmp_path, names, side):
    files = turning(tmp_path)
    count = names.count(",") // 2 + 1
    lever = 0.2 if count == 1 else 0.45
    speeds = V + lever * np.array([[-1.0], [1.0]]) * OMEGA
    angles = 0.1 / 0.05 * np.cumsum(np.pad(speeds[:, :-1], ((0, 0), (1, 0))), axis=1)
    angles[int(side == "right")] *= -1.0
    rows = [",".join(map(str, (t, *pair, *pair)[: 1 + 2 * count]))
            for t, *pair in zip(T, *angles, strict=True)]  # fmt: skip
    (tmp_path / "wheels.csv").write_text("\n".join([f"t,{names}", *rows, ""]))
    every = [tmp_path / "wheels.csv", *files]
    with pytest.raises(
        InputError, match="opposite directions, which the bearings contradict"
    ) as no:
        drive_of(understand(every, wheels=WHEELS), "wheels", wheels=WHEELS)
    assert no.value.file == tmp_path / "wheels.csv"
    wrong = [name for name in names.split(",") if f"{side[0]}_" in name or side in name]
    axles = ("",) if count == 1 else ("front_", "rear_")
    given = [f"{axle}{side}_wheel=-{name}" for axle, name in zip(axles, wrong, strict=True)]
    corrected = drive_of(understand(every, given, wheels=WHEELS), "wheels", wheels=WHEELS)
    assert_same(corrected.odometry, 1e-2)
    if side == "right":
        assert f"'{', '.join(given)}' if the right wheels count backwards" in str(no.value)


def test_one_wheel_of_a_mecanum_drive_that_counts_backwards_is_reported(tmp_path):
    names = "fl_ticks,fr_ticks,rl_ticks,rr_ticks"
    ticks = np.round(MECANUM_TRAVEL * 1000 / (0.1 * np.pi))
    assert CONTRADICT not in imported(tmp_path, names, *ticks).remarks
    ticks[2] *= -1.0
    assert CONTRADICT in imported(tmp_path, names, *ticks).remarks


def test_wheels_named_by_their_corner_alone_ask_for_their_unit(tmp_path):
    with pytest.raises(InputError, match=r"front_left_wheel=fl\[rad\]"):
        imported(tmp_path, "fl,fr,rl,rr", *MECANUM_TRAVEL / 0.05)
    roles = [f"{axle}_{side}_wheel={axle[0]}{side[0]}[rad]" for axle in ("front", "rear")
             for side in ("left", "right")]  # fmt: skip
    drive = imported(tmp_path, "fl,fr,rl,rr", *MECANUM_TRAVEL / 0.05, roles=roles)
    assert_same(drive.odometry)


def test_boxes_in_an_image_are_no_wheels(tmp_path):
    text = "t,id,bearing,left,top,right,bottom\n0.1,A,0.5,100,120,140,160\n"
    (tmp_path / "boxes.csv").write_text(text)
    assert set(understand([tmp_path / "boxes.csv"])) == {"bearings"}


def test_a_gyroscope_replaces_the_yaw_rate_of_the_wheels(tmp_path):
    slipping = SPEEDS + np.array([[0.05], [-0.05]]) * OMEGA
    columns = [*slipping, -np.degrees(OMEGA)]
    with_gyro = imported(tmp_path, "left_vel [m/s],right_vel [m/s],gyro_z", *columns)
    assert with_gyro.odometry.omega[1:-1] == pytest.approx(OMEGA[1:-1], abs=0.006)
    assert any("with the sign inverted" in reason for reason in with_gyro.remarks)
    rows = (f"{t!r},0,0,{rate!r}\n" for t, rate in zip(T.tolist(), OMEGA.tolist(), strict=True))
    (tmp_path / "imu.csv").write_text("time,gyro_x,gyro_y,gyro_z\n" + "".join(rows))
    twists = imported(tmp_path, "v,omega", V, 0 * V, wheels=None, more=["imu.csv"])
    assert twists.odometry.omega[1:-1] == pytest.approx(OMEGA[1:-1], abs=0.006)
    assert any("turns too little for a comparison" in reason for reason in twists.remarks)


def test_a_gyroscope_in_raw_units_is_refused(tmp_path):
    raw = np.round(np.degrees(OMEGA) * 16.4)
    with pytest.raises(InputError, match=r"'gyro_z': the yaw rate of the odometry is 0\.06"):
        imported(tmp_path, "left_vel [m/s],right_vel [m/s],gyro_z", *SPEEDS, raw)


def test_wheels_and_poses_in_one_table(tmp_path):
    """Without the geometry of the wheels, the poses are used."""
    x = np.append(0.0, np.cumsum(0.1 * V[:-1]))
    columns = [*TICKS, x, 0 * V, 0 * V]
    names = "left_ticks,right_ticks,x,y,theta"
    assert imported(tmp_path, names, *columns, wheels=None).odometry.omega == pytest.approx(0.0)
    assert_same(imported(tmp_path, names, *columns).odometry, 4e-3)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ("wheels.csv=wheel", "and one of detections, odometry, gyro"),
        ("nothing.csv=home", "no file 'nothing.csv'"),
        ("b.csv", "must be FILE=KIND"),
        ("b.csv=truth", "--as b.csv=truth: its columns .* have no t, x, y, heading"),
        ("b.csv=odometry", "--as b.csv=odometry: its columns .* have no t, v, omega"),
    ],
)
def test_a_kind_that_a_file_cannot_have_is_refused(tmp_path, given, complaint):
    with pytest.raises(InputError, match=complaint):
        imported(tmp_path, "v,omega", V, OMEGA, wheels=None, kinds=[given])


ROS1_IMU = [
    *("%time", "field.header.seq", *(f"field.orientation.{a}" for a in "xyzw")),
    *(f"field.angular_velocity.{a}" for a in "xyz"),
    *(f"field.linear_acceleration.{a}" for a in "xyz"),
]


@pytest.mark.parametrize("tool", ["rostopic echo -p", "ros2 topic echo --csv"])
def test_imu_messages_as_ros_prints_them_are_gyroscopes(tmp_path, tool):
    lines = [",".join(ROS1_IMU)] * (tool == "rostopic echo -p")
    for t, rate in zip(T.tolist(), OMEGA.tolist(), strict=True):
        if lines and tool == "rostopic echo -p":
            lines.append(f"{t + 1.7e9:.9f},1,0,0,0,1,0.1,0.2,{rate!r},0.3,0.4,9.8")
        else:
            zeros = ",".join(["0.0"] * 9)
            stamp = f"{int(t)},{round(t % 1 * 1e9) % 10**9}"
            rates = f"0.1,0.2,{rate!r},{zeros},0.3,0.4,9.8,{zeros}"
            lines.append(f"{stamp},imu,0,0,0,1,{zeros},{rates}")
    (tmp_path / "imu.csv").write_text("\n".join(lines) + "\n")
    found = understand([tmp_path / "imu.csv"])
    assert set(found) == {"gyro"}
    assert found["gyro"].table["omega"] == pytest.approx(OMEGA)


def test_joint_states_and_ackermann_as_ros2_topic_echo_prints_them(tmp_path):
    columns = np.concatenate([TRAVEL / 0.05, SPEEDS / 0.05]).T.tolist()
    stamps = [f"{int(t)},{round(t % 1 * 1e9) % 10**9}" for t in T.tolist()]
    rows = zip(stamps, columns, strict=True)
    lines = [f"{t},,left_joint,right_joint,{','.join(map(repr, r))},0.0,0.0\n" for t, r in rows]
    (tmp_path / "joints.csv").write_text("".join(lines))
    found = understand([tmp_path / "joints.csv"])["odometry"]
    assert found.table["left_wheel"] == pytest.approx(TRAVEL[0] / 0.05)
    lines = [
        f"{t},base_link,0.1,0.0,{v!r},0.0,0.0\n" for t, v in zip(stamps, V.tolist(), strict=True)
    ]
    (tmp_path / "car.csv").write_text("".join(lines))
    found = understand([tmp_path / "car.csv"])["odometry"]
    assert found.table["v"] == pytest.approx(V)
    assert found.table["steering"] == pytest.approx(0.1)


def test_names_above_a_table_that_are_separated_by_gaps(tmp_path):
    """As in the MRCLAM data set."""
    text = "# data\n# Time [s]    forward velocity [m/s]    angular velocity[rad/s]\n"
    (tmp_path / "o.dat").write_text(text + "0.0 \t 0.1 \t 0.2 \n0.1 \t 0.1 \t 0.3 \n")
    found = understand([tmp_path / "o.dat"])["odometry"]
    assert found.table["omega"].tolist() == [0.2, 0.3]
    assert {column.source for column in found.columns.values()} == {"named"}


def test_counters_with_the_clock_of_an_arduino(tmp_path):
    found = imported(tmp_path, "enc_left,enc_right", *TICKS)
    table = tmp_path / "wheels.csv"
    head, *rows = table.read_text().splitlines()
    cells = [row.partition(",") for row in rows]
    later = [f"{1000 * float(t):.0f},{rest}" for t, _, rest in cells]
    table.write_text("\n".join([head.replace("t,", "millis,", 1), *later]))
    files = [tmp_path / name for name in ("wheels.csv", "b.csv", "h.csv")]
    again = drive_of(understand(files, wheels=WHEELS), "wheels", wheels=WHEELS).odometry
    assert again.t == pytest.approx(found.odometry.t)
    assert again.v == pytest.approx(found.odometry.v)
