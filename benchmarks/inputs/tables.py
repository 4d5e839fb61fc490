"""Tables, as other programs write them."""

import numpy as np

from benchmarks.inputs.kinds import Files, Sample, Seen, kind, table

ALL = "import odometry.csv bearings.csv home.csv"
TAGS = "import odometry.csv tags.csv home.csv"


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


@kind("clockwise bearings, in degrees", ALL)
def _(s: Sample) -> Files:
    def clockwise(seen: Seen) -> dict[str, np.ndarray]:
        return {"id": seen.id, "azimuth_deg": -np.degrees(seen.bearing)}

    seen = table({"t": s.seen.t} | clockwise(s.seen))
    return {"bearings.csv": seen, "home.csv": table(clockwise(s.home))}


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
