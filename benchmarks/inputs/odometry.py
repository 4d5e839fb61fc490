"""Odometry from wheels, steps, poses and gyroscopes, and files whose role is not obvious."""

from collections.abc import Callable

import numpy as np

from benchmarks.inputs.kinds import EPOCH, Files, Sample, kind, table
from benchmarks.inputs.logs import POSE_TOPICS, Messages, log_of, nav, pose_topics
from homeward.drives.ros.writing import LogFile
from homeward.drives.wheels import Wheels

ROBOT = Wheels(wheel_radius=0.033, track_width=0.16, ticks_per_turn=4096, wheelbase=0.3)
RADIUS_WIDTH = "--wheels wheel_radius=0.033,track_width=0.16"
TICKS = f"import encoders.csv bearings.csv home.csv {RADIUS_WIDTH},ticks_per_turn=4096"
OTHER = "import odometry.csv {} bearings.csv home.csv"


def speeds(s: Sample) -> np.ndarray:
    """Return the speeds of the left and the right wheel, (2, n) [m/s]."""
    return s.v + np.array([[-0.5], [0.5]]) * s.omega * ROBOT.track_width


def travel(s: Sample) -> np.ndarray:
    """Return the positions of the wheels, (2, n) [m]."""
    return np.cumsum(np.pad(speeds(s)[:, :-1] * np.diff(s.t), ((0, 0), (1, 0))), axis=1)


def ticks(s: Sample) -> np.ndarray:
    """Return the counts of the wheels, (2, n)."""
    return np.round(travel(s) / ROBOT.metres("ticks")).astype(int)


def poses(s: Sample) -> dict[str, np.ndarray]:
    """Return the poses of dead reckoning."""
    return {"t": s.t, "x": s.path.x, "y": s.path.y, "theta": s.path.heading}


def two(s: Sample, left: str, right: str, values: np.ndarray) -> Files:
    return {"encoders.csv": table({"timestamp": s.t, left: values[0], right: values[1]})}


@kind("encoder counts", TICKS)
def _(s: Sample) -> Files:
    return two(s, "left_ticks", "right_ticks", ticks(s))


@kind("encoder counts of 16 bits, as of LCM in microseconds", TICKS)
def _(s: Sample) -> Files:
    counts = (ticks(s) + 2**15) % 2**16 - 2**15
    utime = np.round(1e6 * (EPOCH + s.t)).astype(int)
    seen = {"utime": np.round(1e6 * (EPOCH + s.seen.t)).astype(int), "id": s.seen.id}
    return {
        "encoders.csv": table({"utime": utime, "leftticks": counts[0], "rightticks": counts[1]}),
        "bearings.csv": table(seen | {"bearing": s.seen.bearing}),
    }


@kind("encoder counts that restart at 0", TICKS)
def _(s: Sample) -> Files:
    counts, k = ticks(s), s.t.size // 2
    counts[:, k:] -= counts[:, k : k + 1]
    return two(s, "encoder_l", "encoder_r", counts)


@kind("encoder counts from row to row", TICKS)
def _(s: Sample) -> Files:
    return two(s, "delta_left_ticks", "delta_right_ticks", np.diff(ticks(s), axis=1, prepend=0))


@kind(
    "encoder counts from row to row, named as if cumulative",
    TICKS + " --columns 'left_step=left, right_step=right'",
)
def _(s: Sample) -> Files:
    return two(s, "left", "right", np.diff(ticks(s), axis=1, prepend=0))


@kind("the same without --columns", TICKS, refused="do not accumulate.*left_step=left")
def _(s: Sample) -> Files:
    return two(s, "left", "right", np.diff(ticks(s), axis=1, prepend=0))


@kind(
    "encoder counts without geometry",
    "import encoders.csv bearings.csv home.csv",
    refused="requires wheel_radius, ticks_per_turn, track_width.*--wheels",
)
def _(s: Sample) -> Files:
    return two(s, "left_ticks", "right_ticks", ticks(s))


@kind("wheel angles in rad", f"import encoders.csv bearings.csv home.csv {RADIUS_WIDTH}")
def _(s: Sample) -> Files:
    angles = travel(s) / ROBOT.metres("rad")
    return two(s, "wheel_left_joint/position", "wheel_right_joint/position", angles)


@kind("wheel speeds in rad/s", f"import encoders.csv bearings.csv home.csv {RADIUS_WIDTH}")
def _(s: Sample) -> Files:
    return two(s, "omega_l", "omega_r", speeds(s) / ROBOT.metres("rad"))


@kind("wheel speeds in m/s", "import encoders.csv bearings.csv home.csv --wheels track_width=0.16")
def _(s: Sample) -> Files:
    return two(s, "v_left", "v_right", speeds(s))


@kind(
    "wheel speeds in m/s or rad/s",
    f"import encoders.csv bearings.csv home.csv {RADIUS_WIDTH}",
    refused="may be in m/s, or in rad/s.*left_speed=vl",
)
def _(s: Sample) -> Files:
    return two(s, "vl", "vr", speeds(s))


@kind("speed and steering angle", "import car.csv bearings.csv home.csv --wheels wheelbase=0.3")
def _(s: Sample) -> Files:
    v = np.where(abs(s.v) < 0.01, 0.01, s.v)
    steering = np.arctan2(s.omega * ROBOT.wheelbase, v)
    return {"car.csv": table({"time": s.t, "speed": v, "steering_angle": steering})}


@kind("distance and turn of each row", "import steps.csv bearings.csv home.csv")
def _(s: Sample) -> Files:
    steps = {k: np.append(0.0, (v[:-1] * np.diff(s.t))) for k, v in (("ds", s.v), ("w", s.omega))}
    return {"steps.csv": table({"t": s.t, "delta_s": steps["ds"], "delta_theta": steps["w"]})}


@kind(
    "speeds of three omni wheels in rpm, --columns",
    "import encoders.csv bearings.csv home.csv --wheels wheel_radius=0.033,omni_radius=0.2 "
    "--columns 'omni_1_speed=a[rpm], omni_2_speed=b[rpm], omni_3_speed=c[rpm]'",
)
def _(s: Sample) -> Files:
    angle = np.radians([[60.0], [180.0], [300.0]])
    rolled = (0.2 * s.omega - np.sin(angle) * s.v) / 0.033 * 30.0 / np.pi
    return {"encoders.csv": table({"t": s.t, **dict(zip("abc", rolled, strict=True))})}


@kind(
    "counts of four mecanum wheels",
    f"import encoders.csv bearings.csv home.csv {RADIUS_WIDTH},ticks_per_turn=4096,wheelbase=0.3",
)
def _(s: Sample) -> Files:
    reach = (ROBOT.track_width + ROBOT.wheelbase) / 2
    rolled = s.v + np.outer([-reach, reach, -reach, reach], s.omega)
    steps = np.pad(rolled[:, :-1] * np.diff(s.t), ((0, 0), (1, 0)))
    counts = np.round(np.cumsum(steps, axis=1) / ROBOT.metres("ticks")).astype(int)
    names = ("fl_ticks", "fr_ticks", "rl_ticks", "rr_ticks")
    return {"encoders.csv": table({"t": s.t, **dict(zip(names, counts, strict=True))})}


MODULES = np.array([[0.3, 0.25], [0.3, -0.25], [-0.3, 0.25], [-0.3, -0.25]])
"""Positions of four swerve modules, ahead and to the left [m]."""
LIST = str(MODULES.tolist()).replace(" ", "")


def modules(s: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds [m/s] and angles [rad] of swerve modules, (4, n) each."""
    rolled = s.v + 1j * np.outer(MODULES @ [1, 1j], s.omega)
    return np.abs(rolled), np.angle(rolled)


@kind(
    "states of four swerve modules, --columns",
    f"import modules.csv bearings.csv home.csv --wheels modules={LIST} --columns '"
    + ", ".join(f"module_{k}_speed=v{k}, module_{k}_angle=a{k}[deg]" for k in (1, 2, 3, 4))
    + "'",
)
def _(s: Sample) -> Files:
    speed, angle = modules(s)
    columns = {f"v{k}": values for k, values in enumerate(speed, 1)}
    columns |= {f"a{k}": np.degrees(values) for k, values in enumerate(angle, 1)}
    return {"modules.csv": table({"t": s.t, **columns})}


@kind("yaw rate of a gyroscope in deg/s, clockwise", OTHER.format("imu.csv"))
def _(s: Sample) -> Files:
    wheels = {"t": s.t, "v": s.v, "omega": 1.2 * s.omega}
    gyro = {"t": s.t, "gyro_x": 0 * s.t, "gyro_y": 0 * s.t, "gyro_z": -np.degrees(s.omega)}
    return {"odometry.csv": table(wheels), "imu.csv": table(gyro)}


@kind("encoder counts and a gyroscope in one table", TICKS)
def _(s: Sample) -> Files:
    wheels = {"t": s.t, "enc_l": ticks(s)[0], "enc_r": ticks(s)[1], "gz": s.omega}
    return {"encoders.csv": table(wheels)}


@kind("a gyroscope of another robot", OTHER.format("imu.csv"), refused="contradicts that of the")
def _(s: Sample) -> Files:
    return {"imu.csv": table({"t": s.t, "gyro_z": np.sin(3.0 * s.t)})}


@kind("robot_pose.csv without other odometry", "import robot_pose.csv bearings.csv home.csv")
def _(s: Sample) -> Files:
    return {"robot_pose.csv": table(poses(s))}


@kind("robot_pose.csv with ground truth", "import robot_pose.csv truth.csv bearings.csv home.csv")
def _(s: Sample) -> Files:
    t, x, y, heading = (getattr(s.truth, name) for name in ("t", "x", "y", "heading"))
    true = table({"t": t, "x": x, "y": y, "theta": heading})
    return {"robot_pose.csv": table(poses(s)), "truth.csv": true}


@kind("robot_pose.csv of the odometry's poses", OTHER.format("robot_pose.csv"))
def _(s: Sample) -> Files:
    return {"robot_pose.csv": table(poses(s))}


@kind(
    "two files with poses from the origin",
    "import a.csv b.csv bearings.csv home.csv",
    refused="a.csv and b.csv have poses.*--as FILE=odometry",
)
def _(s: Sample) -> Files:
    return {"a.csv": table(poses(s)), "b.csv": table(poses(s))}


@kind(
    "two files with poses and --as",
    "import a.csv b.csv bearings.csv home.csv --as a.csv=odometry --as b.csv=truth",
)
def _(s: Sample) -> Files:
    return {"a.csv": table(poses(s)), "b.csv": table(poses(s))}


@kind("odometry and tag positions in one table", "import log.csv home.csv")
def _(s: Sample) -> Files:
    a = s.seen.ahead
    order = np.argsort(np.concatenate([s.t, a.t]), kind="stable")

    def column(of_odometry: np.ndarray | float, of_tags: np.ndarray | float) -> np.ndarray:
        rows = np.broadcast_to(of_odometry, s.t.shape), np.broadcast_to(of_tags, a.t.shape)
        return np.concatenate(rows)[order]

    ids = ["" if np.isnan(i) else str(int(i)) for i in column(np.nan, a.id)]
    tag = {"tag_id": ids, "tag_x": column(np.nan, -a.left), "tag_y": column(np.nan, -0.3)}
    twist = {"t": column(s.t, a.t), "v": column(s.v, np.nan), "omega": column(s.omega, np.nan)}
    return {"log.csv": table(twist | tag | {"tag_z": column(np.nan, a.forward)})}


def repeated(s: Sample, odometry: dict[str, np.ndarray]) -> Files:
    """Return a table with the odometry in each row, and with the bearings of that time."""
    bare = ~np.isin(s.t, s.seen.t)
    k = np.concatenate([np.searchsorted(s.t, s.seen.t), np.flatnonzero(bare)])
    order = np.argsort(k, kind="stable")
    ids = np.concatenate([s.seen.id.astype(str), np.full(bare.sum(), "")])
    seen = {"id": ids, "bearing": np.concatenate([s.seen.bearing, np.full(bare.sum(), np.nan)])}
    rows = {name: values[k] for name, values in odometry.items()} | seen
    return {"log.csv": table({name: values[order] for name, values in rows.items()})}


@kind("odometry repeated in each row of bearings", "import log.csv home.csv")
def _(s: Sample) -> Files:
    return repeated(s, {"t": s.t, "v": s.v, "omega": s.omega})


@kind("poses repeated in each row of bearings", "import log.csv home.csv")
def _(s: Sample) -> Files:
    return repeated(s, poses(s))


@kind("one row of numbers", "import odometry.csv bearings.csv ab.csv", refused="not recognised")
def _(s: Sample) -> Files:
    return {"ab.csv": "a,b\n1,2\n"}


def log(s: Sample, messages: Callable[[LogFile, int, int], Messages], topics: str) -> Files:
    """Return a log with a pose topic for each tag and other odometry."""
    write = log_of(s, s.seen.ahead, pose_topics, ACKERMANN, messages)
    return {"log.mcap": write, "topics.yaml": f"{POSE_TOPICS}odometry: {topics}\n"}


@kind("JointState with encoder counts, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def joints(log: LogFile, stamp: int, k: int) -> Messages:
        names, none = ["wheel_left_joint", "wheel_right_joint"], np.empty(0)
        values = {"position": counts[:, k].astype(float), "velocity": none, "effort": none}
        message = log.make("sensor_msgs/msg/JointState", name=names, **values)
        message.header = log.header(stamp, "")
        return {"/joint_states": message}

    counts = ticks(s)
    wheels = "wheel_radius: 0.033, track_width: 0.16, ticks_per_turn: 4096"
    return log(s, joints, f"{{topic: /joint_states, {wheels}}}")


ACKERMANN = {
    "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\n"
    "float32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n",
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\n"
    "ackermann_msgs/AckermannDrive drive\n",
}


@kind("AckermannDriveStamped, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def car(log: LogFile, stamp: int, k: int) -> Messages:
        v = max(float(s.v[k]), 0.01)
        drive = {"speed": v, "steering_angle": float(np.arctan2(0.3 * s.omega[k], v))}
        header, kind = log.header(stamp, "base_link"), "ackermann_msgs/msg/AckermannDriveStamped"
        return {"/car": log.make(kind, header=header, drive=drive)}

    return log(s, car, "{topic: /car, wheelbase: 0.3}")


@kind("odometry as odom -> base_link in /tf, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def transform(log: LogFile, stamp: int, k: int) -> Messages:
        pose = nav(log, stamp, s, k).pose.pose
        place = {"x": pose.position.x, "y": pose.position.y}
        moved = {"translation": place, "rotation": pose.orientation}
        frames = {"header": log.header(stamp, "odom"), "child_frame_id": "base_link"}
        there = log.make("geometry_msgs/msg/TransformStamped", **frames, transform=moved)
        return {"/tf": log.make("tf2_msgs/msg/TFMessage", transforms=[there])}

    return log(s, transform, "{topic: /tf}")


@kind("Odometry with the yaw rate of an Imu, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def both(log: LogFile, stamp: int, k: int) -> Messages:
        odometry, zeros = nav(log, stamp, s, k), np.zeros(9)
        odometry.twist.twist.angular.z *= 1.2
        rates = {"z": -float(s.omega[k])}
        names = ("orientation", "angular_velocity", "linear_acceleration")
        fields = {f"{name}_covariance": zeros for name in names}
        header = log.header(stamp, "imu_link")
        imu = log.make("sensor_msgs/msg/Imu", header=header, angular_velocity=rates, **fields)
        return {"/odom": odometry, "/imu": imu}

    return log(s, both, "{topic: /odom, use: twist, yaw_rate: /imu}")
