"""No dead or wrong sensor drives a robot far, or makes it stop and go: a part of the long table."""

import pytest

from benchmarks.closed_loop import FAULTS, outcome
from homeward.control.driver import RESUME_S

MAX_M = 0.3


@pytest.mark.parametrize(
    "name",
    [
        "odometry is silent",
        "camera sees nothing",
        "camera is frozen",
        "camera is silent for 0.2 of 0.8 s",
        "camera loses half of the frames",
        "camera is turned by 1.0 rad",
        "bearings are all equal",
    ],
)
def test_a_robot_with_a_fault_drives_no_farther_and_does_not_stop_and_go(name):
    found = outcome(FAULTS[name], seed=2000, seconds=5.0)
    assert max(found.wrong, found.unseen) <= MAX_M
    assert found.between >= RESUME_S
    if FAULTS[name].is_dead:
        assert found.to_stop <= MAX_M
