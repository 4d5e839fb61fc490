"""Estimates are values: they compare, hash and pickle, and hold plain floats."""

import dataclasses
import math
import pickle

import numpy as np
import pytest

from benchmarks.fuzz import small_drive
from homeward.drives.drive import HomeBearing
from homeward.estimator import Estimate, Innovation, LandmarkEstimate, Status
from homeward.geometry.frames import Pose
from homeward.registry import ESTIMATORS, make_estimator

HERE = Estimate(
    1.0,
    Status.LOCALISED,
    "as told",
    Pose(1.0, 2.0, 0.5),
    np.diag([0.1, 0.2, 0.3]),
    (Innovation("door", 0.01, 0.02, True),),
)
CHANGES = {
    "t": 2.0,
    "status": Status.COASTING,
    "reason": "otherwise",
    "pose": Pose(1.0, 2.0, 0.25),
    "covariance": np.diag([0.1, 0.2, 0.4]),
    "innovations": (),
}


def copied(value):
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize(
    "value",
    [
        HERE,
        Estimate(0.0, Status.WAITING, "no samples yet"),
        LandmarkEstimate("door", x=1.0),
        HomeBearing(0.3, math.nan),
        HERE.innovations[0],
    ],
)
def test_a_copy_is_equal_and_the_same_in_a_set(value):
    assert copied(value) == value
    assert {value, copied(value), dataclasses.replace(value)} == {value}
    assert value != "another"


@pytest.mark.parametrize("name", CHANGES)
def test_one_field_makes_an_estimate_another(name):
    other = dataclasses.replace(HERE, **{name: CHANGES[name]})
    assert other != HERE
    assert len({other, HERE}) == 2


def test_an_estimate_keeps_its_covariance_whoever_wrote_it():
    covariance = np.eye(3)
    estimate = Estimate(0.0, Status.LOCALISED, "", Pose(0.0, 0.0, 0.0), covariance)
    covariance[0, 0] = 7.0
    assert estimate.covariance[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.covariance[0, 0] = 7.0


@pytest.mark.parametrize("name", ESTIMATORS)
def test_answers_are_of_plain_floats(name):
    estimator = make_estimator(name, small_drive())
    for k in range(100):
        estimator.odometry(k / 10, 0.2, 0.3)
        answer = estimator.bearings(k / 10, {"a": 0.1, "crate 7": -1.0, "b": 2.0})
    told = [answer.t, *(answer.pose or ()), *(answer.polar or ())]
    told += [number for i in answer.innovations for number in (i.value, i.sigma)]
    for m in estimator.landmarks():
        told += [v for v in dataclasses.astuple(m) if isinstance(v, (float, np.generic))]
    assert {type(number) for number in told} == {float}
    assert copied(answer) == answer
    assert copied(estimator.landmarks()) == estimator.landmarks()
    assert hash(answer) == hash(copied(answer))


def test_a_pose_of_other_numbers_becomes_one_of_floats():
    pose = Pose(np.float32(0.5), np.int64(1), np.array(2.0))
    told = Estimate(0.0, Status.LOCALISED, "", pose, np.eye(3)).pose
    assert told == (0.5, 1.0, 2.0)
    assert [type(part) for part in told] == [float] * 3
