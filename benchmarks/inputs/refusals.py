"""Data that homeward refuses, with one line that names the problem."""

from benchmarks.inputs.kinds import Files, Sample, kind

ALL = "import odometry.csv bearings.csv home.csv"


@kind("empty file", ALL, refused="empty")
def _(s: Sample) -> Files:
    return {"bearings.csv": ""}


@kind("odometry alone", "import odometry.csv", refused="no bearings found")
def _(s: Sample) -> Files:
    return {}


@kind("LCM event log", "run lcmlog-2024-04-15.00", refused="LCM event log.*CSV")
def _(s: Sample) -> Files:
    return {"lcmlog-2024-04-15.00": b"\xed\xa1\xda\x01" + bytes(19) + b"\x08\0\0\0\x04MBOT_VELdata"}


@kind("MATLAB file", "import log.mat bearings.csv home.csv", refused="binary")
def _(s: Sample) -> Files:
    return {"log.mat": b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\1IM\x0e\0\0\0"}
