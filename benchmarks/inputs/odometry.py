"""Odometry from wheels, poses and gyroscopes, and files whose role is not obvious."""

import numpy as np

from benchmarks.inputs.kinds import Files, Sample, kind, table
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
