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


@kind("tag positions, optical axes", TAGS)
def _(s: Sample) -> Files:
    a = s.seen.ahead
    tags = {"timestamp": a.t, "tag_id": a.id, "x": -a.left, "y": -0.3 - 0.01 * a.id, "z": a.forward}
    return {"tags.csv": table(tags)}


@kind("tag positions, robot axes, in mm", TAGS)
def _(s: Sample) -> Files:
    def tags(seen: Seen) -> dict[str, np.ndarray]:
        ahead, up = seen.forward + s.camera, 0.3 + 0.01 * seen.id
        return {"marker": seen.id, "x": 1e3 * ahead, "y": 1e3 * seen.left, "z": 1e3 * up}

    home = tags(s.home) | {"frame_id": ["base_link"] * s.home.t.size}
    return {"tags.csv": table({"stamp": s.seen.t} | tags(s.seen)), "home.csv": table(home)}
