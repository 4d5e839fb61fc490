"""Data that homeward refuses, with one line that names the problem."""

from benchmarks.inputs.kinds import Files, Sample, kind

ALL = "import odometry.csv bearings.csv home.csv"


@kind("empty file", ALL, refused="empty")
def _(s: Sample) -> Files:
    return {"bearings.csv": ""}


@kind("odometry alone", "import odometry.csv", refused="no bearings found")
def _(s: Sample) -> Files:
    return {}
