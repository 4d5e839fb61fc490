"""The benchmark of kinds of data in short: files of other tools give the right answer."""

import pytest

import benchmarks.inputs.__main__  # noqa: F401
from benchmarks.inputs.kinds import KINDS
from benchmarks.inputs.trial import attempt

KEPT = (
    "ms, mm/s, deg; semicolon, decimal comma",
    "tag positions, robot axes, in mm",
    "aruco_opencv_msgs/ArucoDetection, .mcap",
)


@pytest.mark.parametrize("name", [*KEPT, *(n for n, kind in KINDS.items() if kind.refused)])
def test_a_kind_of_data_gives_the_right_answer_or_one_line(name, tmp_path):
    result = attempt(name, tmp_path / "kind")
    assert result.is_right, result.answer
