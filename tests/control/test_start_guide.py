"""Advice for the start: which motion brings the most information."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.guided import first_pose
from homeward.control.start_guide import Manoeuvre, StartGuide
from homeward.geometry.frames import Pose

ORIGIN = Pose(0.0, 0.0, 0.0)
NAMES = "abcdef"


def guide(bearings, home=NAMES, camera=ORIGIN, robot=ORIGIN):
    found = StartGuide(home, camera)
    found.add(robot, dict(zip(NAMES, bearings, strict=False)))
    return found


def test_there_is_no_advice_before_the_first_image():
    assert StartGuide("abc", ORIGIN).advice() is None


def test_a_narrow_camera_that_sees_too_few_landmarks_turns_once_around():
    found = guide([-0.3, 0.2])
    assert found.advice() == Manoeuvre(math.tau, 0.0, 0.0)
    assert found.advice().words == "turn once around on the spot"
    for k in range(1, 12):
        found.add(Pose(0.0, 0.0, math.remainder(k * math.tau / 11, math.tau)), {})
    assert found.advice().distance > 0.0


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_a_robot_drives_across_its_sight_lines(heading):
    """All landmarks are ahead and astern: towards them there is no parallax."""
    ahead = [0.0, 0.05, -0.05, math.pi, 3.1, -3.1]
    turn, distance, _ = guide(ahead, robot=Pose(1.0, 2.0, heading)).advice()
    assert abs(turn) == pytest.approx(math.pi / 2, abs=0.3)
    assert distance > 0.0


def test_a_narrow_camera_looks_back_at_what_it_saw_before():
    found = guide([-0.3, -0.1, 0.0, 0.1, 0.3]).advice()
    assert abs(found.turn) > 0.7
    assert found.turn_after == -found.turn
    left = Manoeuvre(math.pi / 2, 1.0, -math.pi / 2).words
    assert left == "turn left 90 degrees, then drive 1 m, then turn right 90 degrees"


def test_landmarks_that_have_parallax_count_less():
    """The sight lines of two were crossed already: the motion is for the other three."""
    found = StartGuide(NAMES, ORIGIN)
    found.add(ORIGIN, {"a": 0.5, "b": -2.6, "c": 1.6, "d": 1.5, "e": -1.6})
    found.add(Pose(0.5, 0.0, 0.0), {"a": 1.2, "b": -1.9, "c": 1.6, "d": 1.5, "e": -1.6})
    assert abs(math.sin(found.advice().turn)) < 0.5


def test_landmarks_without_ids_are_not_taken_for_those_of_another_image():
    keys = ["class:#1", "class:#2", "class:#3"]
    found = StartGuide(keys, ORIGIN)
    found.add(ORIGIN, dict(zip(keys, [0.0, 0.1, -0.1], strict=True)))
    assert found.advice() == Manoeuvre(0.0, 1.0, 0.0)


def test_other_landmarks_and_bad_bearings_do_not_matter():
    bearings = [0.0, 0.05, -0.05, math.pi, 3.1]
    found, other = guide(bearings), guide(bearings)
    other.add(ORIGIN, {"stranger": 1.5, "b": math.nan})
    assert other.advice() == found.advice()


def test_a_robot_that_follows_the_advice_has_a_pose_within_two_metres():
    """With a camera of 60 degrees, and two of twelve landmarks moved; `benchmarks.guided`."""
    _, path, off = first_pose(1, "guided", math.radians(60.0))
    assert path <= 2.1
    assert off < 0.5


@given(
    st.sampled_from([(0.0,), (0.3, -0.3, 0.6, -0.6), (0.5, -0.5, 2.6, -2.6)]),
    st.lists(st.floats(-1e-15, 1e-15), min_size=4, max_size=4),
)
def test_rounding_does_not_choose_between_motions_of_equal_information(bearings, errors):
    def advice(errors):
        some = StartGuide([f"L{k}" for k in range(4)], ORIGIN)
        seen = {f"L{k}": b + e for k, (b, e) in enumerate(zip(bearings, errors, strict=False))}
        some.add(ORIGIN, {**seen, "other": math.pi})
        return some.advice()

    assert advice(errors) == advice([0.0] * 4)
