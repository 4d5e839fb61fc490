"""A pose that the newest bearings contradict, or that few landmarks confirm, is not localised."""

import pytest

from benchmarks.monte_carlo import Run
from benchmarks.random_faults import measured


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("ids are rotated", 0),  # the robot seems to be elsewhere in a ring of landmarks
        ("odometry is zero", 4),  # one landmark is in view
        ("odometry is reversed", 4),
        ("landmarks move together, for good", 5003),  # as if the robot were displaced
        ("landmarks move together, for good", 5007),
        ("one wheel is dead", 5107),  # as if the camera's yaw were wrong
    ],
)
def test_a_pose_is_not_wrong_and_localised_for_more_than_a_second(kind, seed):
    found = measured(Run(kind, "robust", seed))
    assert found["longest"] <= 1.0
    assert found["after"] > 0.7
