"""Tables, as other programs write them."""

from datetime import UTC, datetime

import numpy as np

from benchmarks.inputs.kinds import EPOCH, Files, Sample, Seen, kind, table

ALL = "import odometry.csv bearings.csv home.csv"
TAGS = "import odometry.csv tags.csv home.csv"
NANO = 10**9


def stamps(t: np.ndarray, unit: float = NANO) -> list[int]:
    """Return Unix stamps as integers, in nanoseconds or another part of a second."""
    return [round((EPOCH + one) * unit) for one in t.tolist()]


def poses(s: Sample) -> dict[str, np.ndarray]:
    """Return position and quaternion of the odometry, with the names of TUM files."""
    half, zeros = s.path.heading / 2, 0 * s.t
    place = {"x": s.path.x, "y": s.path.y, "z": zeros}
    return place | {"qx": zeros, "qy": zeros, "qz": np.sin(half), "qw": np.cos(half)}


@kind("plain tables in SI units", ALL)
def _(s: Sample) -> Files:
    return {}


@kind("ms, mm/s, deg; semicolon, decimal comma", "import wheels.csv seen.csv home.csv")
def _(s: Sample) -> Files:
    wheels = {"Time [ms]": 1e3 * s.t, "Speed [mm/s]": 1e3 * s.v}
    wheels["Yaw rate [deg/s]"] = np.degrees(s.omega)
    seen = {"time": 1e3 * s.seen.t, "tag_id": s.seen.id, "angle": np.degrees(s.seen.bearing)}
    return {
        "wheels.csv": table(wheels, ";", comma=True),
        "seen.csv": table(seen, ";", comma=True),
        "home.csv": table({"Marke": s.home.id, "Peilung [Grad]": np.degrees(s.home.bearing)}, "\t"),
    }


@kind("UTF-16 with tabs, from a spreadsheet", ALL)
def _(s: Sample) -> Files:
    odometry = {"Zeit (s)": s.t, "Geschwindigkeit (m/s)": s.v, "Drehrate (rad/s)": s.omega}
    return {"odometry.csv": table(odometry, "\t", comma=True).encode("utf-16")}


@kind("rosbag to CSV (rostopic echo -p)", "import odom.csv bearings.csv home.csv")
def _(s: Sample) -> Files:
    odom = {"%time": stamps(s.t), "field.header.seq": range(s.t.size)}
    odom["field.header.stamp"] = stamps(s.t)
    odom |= {"field.header.frame_id": ["odom"] * s.t.size}
    odom |= {f"field.pose.pose.{k}": v for k, v in poses(s).items() if len(k) == 1}
    odom |= {"field.twist.twist.linear.x": s.v, "field.twist.twist.angular.z": s.omega}
    seen = {"stamp": EPOCH + s.seen.t, "id": s.seen.id, "bearing": s.seen.bearing}
    return {"odom.csv": table(odom), "bearings.csv": table(seen)}


@kind("nav_msgs/Odometry by ros2 topic echo --csv", "import odom.csv bearings.csv home.csv")
def _(s: Sample) -> Files:
    n, zeros = s.t.size, {f"{k}": np.zeros(s.t.size) for k in range(36)}
    seconds, nano = np.divmod(np.array(stamps(s.t)), NANO)
    columns = {"s": seconds, "ns": nano, "f": ["odom"] * n, "c": ["base_link"] * n, **poses(s)}
    columns |= zeros | {"vx": s.v, "vy": 0 * s.v, "vz": 0 * s.v}
    columns |= {"wx": 0 * s.v, "wy": 0 * s.v, "wz": s.omega}
    columns |= {f"twist {k}": zero for k, zero in zeros.items()}
    seen = {"t": stamps(s.seen.t), "id": s.seen.id, "bearing": s.seen.bearing}
    return {"odom.csv": table(columns, header=False), "bearings.csv": table(seen)}


@kind("TUM trajectory as odometry", "import odom.tum bearings.csv home.csv")
def _(s: Sample) -> Files:
    return {"odom.tum": table({"t": s.t} | poses(s), " ", header=False)}


@kind("dates as time stamps", ALL)
def _(s: Sample) -> Files:
    def dates(t: np.ndarray) -> list[str]:
        return [datetime.fromtimestamp(EPOCH + one, UTC).isoformat() for one in t.tolist()]

    odometry = {"datetime": dates(s.t), "speed": s.v, "yaw_rate": s.omega}
    seen = {"datetime": dates(s.seen.t), "marker_id": s.seen.id, "bearing": s.seen.bearing}
    return {"odometry.csv": table(odometry), "bearings.csv": table(seen)}


@kind("wide table, a column for each landmark in degrees", "import odometry.csv wide.csv home.csv")
def _(s: Sample) -> Files:
    times, row = np.unique(s.seen.t, return_inverse=True)
    wide = {f"bearing_{i}_deg": np.full(times.size, np.nan) for i in np.unique(s.seen.id)}
    for k, i, bearing in zip(row, s.seen.id, s.seen.bearing, strict=True):
        wide[f"bearing_{i}_deg"][k] = np.degrees(bearing)
    return {"wide.csv": table({"time": times} | wide)}


@kind("odometry and sightings in one file", "import log.csv home.csv")
def _(s: Sample) -> Files:
    t = np.concatenate([s.t, s.seen.t])
    order, n, m = np.argsort(t, kind="stable"), s.t.size, s.seen.t.size
    columns = {"t": t}
    for name, values in (("v", s.v), ("omega", s.omega)):
        columns[name] = np.append(values, np.full(m, np.nan))
    columns["tag"] = np.array([""] * n + list(map(str, s.seen.id)))
    columns["bearing"] = np.append(np.full(n, np.nan), s.seen.bearing)
    return {"log.csv": table({name: values[order] for name, values in columns.items()})}


@kind("clockwise bearings, in degrees", ALL)
def _(s: Sample) -> Files:
    def clockwise(seen: Seen) -> dict[str, np.ndarray]:
        return {"id": seen.id, "azimuth_deg": -np.degrees(seen.bearing)}

    seen = table({"t": s.seen.t} | clockwise(s.seen))
    return {"bearings.csv": seen, "home.csv": table(clockwise(s.home))}


@kind("distances along with bearings, in mm", ALL)
def _(s: Sample) -> Files:
    seen = {"t": s.seen.t, "id": s.seen.id, "bearing": s.seen.bearing}
    return {"bearings.csv": table(seen | {"distance": 1e3 * s.seen.range})}


def robot_axes(
    s: Sample, seen: Seen, unit: float = 1.0, left: float = 1.0
) -> dict[str, np.ndarray]:
    """Return positions in the robot's axes."""
    y, z = left * unit * seen.left, unit * (0.3 + 0.01 * seen.id)
    return {"id": seen.id, "x": unit * (seen.forward + s.camera), "y": y, "z": z}


def optical_axes(seen: Seen, unit: float = 1.0) -> dict[str, np.ndarray]:
    """Return positions in the camera's optical axes."""
    y = -unit * (0.3 + 0.01 * seen.id)
    return {"tag_id": seen.id, "x": -unit * seen.left, "y": y, "z": unit * seen.forward}


@kind("tag positions, optical axes", TAGS)
def _(s: Sample) -> Files:
    return {"tags.csv": table({"timestamp": s.seen.ahead.t} | optical_axes(s.seen.ahead))}


@kind("tag poses in cm with quaternions, optical frame", TAGS)
def _(s: Sample) -> Files:
    a = s.seen.ahead
    turn = {
        f"q{k}": np.full(a.t.size, q) for k, q in zip("xyzw", (1.0, 0.0, 0.0, 0.0), strict=True)
    }
    tags = {f"{k} [cm]" if k in "xyz" else k: v for k, v in optical_axes(a, 100.0).items()}
    frame = {"frame_id": ["camera_color_optical_frame"] * a.t.size}
    return {"tags.csv": table({"time": a.t} | frame | tags | turn)}


@kind("OpenCV tvec and rvec", TAGS)
def _(s: Sample) -> Files:
    a = s.seen.ahead
    x, y, z = (v for k, v in optical_axes(a).items() if k in "xyz")
    tags = {"frame": np.round(a.t * 30).astype(int), "time": a.t, "id": a.id}
    tags |= {f"rvec_{k}": np.full(a.t.size, r) for k, r in zip("xyz", (3.1, 0.0, 0.1), strict=True)}
    return {"tags.csv": table(tags | {"tvec_x": x, "tvec_y": y, "tvec_z": z})}


@kind("pupil_apriltags: pixels of the centre and pose_t", TAGS)
def _(s: Sample) -> Files:
    a = s.seen.ahead
    x, y, z = (v for k, v in optical_axes(a).items() if k in "xyz")
    tags = {"timestamp": a.t, "tag_family": ["tag36h11"] * a.t.size, "tag_id": a.id}
    tags |= {"center_x": 640 + 600 * x / z, "center_y": 360 + 600 * y / z}
    return {"tags.csv": table(tags | {"pose_t_x": x, "pose_t_y": y, "pose_t_z": z})}


@kind("tag positions, robot axes, in mm", TAGS)
def _(s: Sample) -> Files:
    home = robot_axes(s, s.home, 1e3) | {"frame_id": ["base_link"] * s.home.t.size}
    tags = {"stamp": s.seen.t} | robot_axes(s, s.seen, 1e3)
    return {"tags.csv": table(tags), "home.csv": table(home)}


@kind("tag positions, x ahead and y to the right", TAGS)
def _(s: Sample) -> Files:
    home = robot_axes(s, s.home, 1.0, -1.0) | {"frame_id": ["base_link"] * s.home.t.size}
    tags = {"stamp": s.seen.t} | robot_axes(s, s.seen, 1.0, -1.0)
    return {"tags.csv": table(tags), "home.csv": table(home)}


PIXELS = "import odometry.csv tags.csv home.csv --camera camera.yaml"
PINHOLE = "model: pinhole\nfx: 200\nfy: 200\ncx: 750\ncy: 240\nwidth: 1500\nheight: 480\n"


def boxes(seen: Seen, names: str, form: str) -> dict[str, np.ndarray]:
    """Return boxes of 24 by 80 pixels round the landmarks, with these names of columns."""
    u, v = 750.0 - 200.0 * np.tan(seen.bearing), np.full(seen.t.size, 240.0)
    width, height = np.full(seen.t.size, 24.0), np.full(seen.t.size, 80.0)
    forms = {
        "ends": (u - 12.0, v - 40.0, u + 12.0, v + 40.0),
        "corner": (u - 12.0, v - 40.0, width, height),
        "share": (u / 1500.0, v / 480.0, width / 1500.0, height / 480.0),
    }
    return {"class": seen.id} | dict(zip(names.split(), forms[form], strict=True))


def box_kind(names: str, form: str, refused: str = "") -> None:
    """Register boxes of a detector."""

    def files(s: Sample) -> Files:
        tags = table({"t": s.seen.ahead.t} | boxes(s.seen.ahead, names, form))
        return {"tags.csv": tags, "camera.yaml": PINHOLE}

    kind(f"boxes, {names}", PIXELS, refused=refused)(files)


box_kind("xmin ymin xmax ymax", "ends")
box_kind("x1 y1 x2 y2", "ends")
box_kind("left top right bottom", "ends")
box_kind("x_center y_center width height", "share")
box_kind("x y w h", "corner", "may be the centre or a corner of a box")  # all fit in the image


@kind("OpenCV arrays in a cell", TAGS)
def _(s: Sample) -> Files:
    a = s.seen.ahead
    x, y, z = (v for k, v in optical_axes(a).items() if k in "xyz")
    cells = [f'"[[{p:.6f} {q:.6f} {r:.6f}]]"' for p, q, r in zip(x, y, z, strict=True)]
    return {"tags.csv": table({"time": a.t, "id": a.id, "tvec": cells})}


@kind(
    "exchanged encoders with pixels",
    f"{PIXELS} --wheels track_width=0.3",
    refused="turns the wrong way.*left_wheel=right",
)
def _(s: Sample) -> Files:
    step = np.diff(s.t, append=s.t[-1:])
    left, right = (np.cumsum((s.v + k * 0.15 * s.omega) * step) for k in (1.0, -1.0))
    wheels = table({"t": s.t, "left_distance": left, "right_distance": right})
    seen = s.seen.ahead
    tags = table({"t": seen.t} | boxes(seen, "xmin ymin xmax ymax", "ends"))
    return {"odometry.csv": wheels, "tags.csv": tags, "camera.yaml": PINHOLE}


@kind("bearings in a fixed frame", ALL, refused="fixed frame.*bearing=bearing")
def _(s: Sample) -> Files:
    bearing = s.seen.bearing + s.truth.at(s.seen.t).heading
    seen = {"t": s.seen.t, "landmark": s.seen.id, "bearing": np.angle(np.exp(1j * bearing))}
    return {"bearings.csv": table(seen)}


@kind("stamps made equal by a spreadsheet", ALL, refused="different stamps")
def _(s: Sample) -> Files:
    return {"odometry.csv": table({"t": 0 * s.t + 1.7639e9, "v": s.v, "omega": s.omega})}


@kind("clock set during the drive", ALL, refused="the clock was set")
def _(s: Sample) -> Files:
    late = [t + 1e9 * (t > 4.0) for t in (s.t, s.seen.t)]
    seen = {"t": late[1], "landmark": s.seen.id, "bearing": s.seen.bearing}
    odometry = {"t": late[0], "v": s.v, "omega": s.omega}
    return {"odometry.csv": table(odometry), "bearings.csv": table(seen)}


@kind("a role without a name", ALL, refused="give omega, as in --columns 'omega=qq'")
def _(s: Sample) -> Files:
    return {"odometry.csv": table({"t": s.t, "v": s.v, "qq": s.omega})}
