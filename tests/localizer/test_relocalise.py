"""Relocalisation by Bayes factors: what proves a pose in the map, and what does not."""

import math

import numpy as np
import pytest

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between, compose
from homeward.localizer.inputs.bearing_noise import CorrelatedErrors, WeighedFrame
from homeward.localizer.map.landmarks import Landmark, Landmarks
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD, NC, Motion
from homeward.localizer.recovery.relocalise import Search, relocalise
from homeward.localizer.resection import SightLines

LOST = Pose(0.4, 0.8, 2.1)
MARKS = np.array([[2.0, 1.0], [-1.0, 2.0], [0.5, -2.0], [-2.0, -1.0], [3.0, -0.5]])


def lines_of(names, cameras, wrong_place=()):
    """Sight lines from `LOST`; some landmarks are mapped 1.5 m from where they stand."""
    rng = np.random.default_rng(2)
    seen = [bearing(compose(LOST, c), *MARKS[n]) for c, n in zip(cameras, names, strict=True)]
    mapped = MARKS.copy()
    mapped[list(wrong_place)] += [1.2, -0.9]
    m = len(names)
    return SightLines(
        np.array(cameras),
        wrap(np.array(seen) + 0.005 * rng.normal(size=m)),
        np.full(m, 0.01),
        np.array(names),
        mapped[names],
        np.tile(1e-4 * np.eye(2), (m, 1, 1)),
    )


def way(n, step=0.05):
    return [Pose(step * k, 0.0, 0.4 * step * k) for k in range(n)]


def within(metres, radians):
    return np.diag([metres, metres, radians]) ** 2


@pytest.mark.parametrize("step", [0.05, 0.25])  # a path of up to the distance of the landmarks
def test_a_lost_robot_is_found_in_its_map(step):
    found = relocalise(lines_of(np.arange(12) % 4, way(12, step)))
    assert found is not None
    off = between(LOST, Pose(*found[0]))
    assert math.hypot(off.x, off.y) < 0.05
    assert abs(off.heading) < 0.03


def test_three_landmarks_seen_again_from_one_place_prove_no_pose():
    assert relocalise(lines_of(np.arange(12) % 3, way(12, step=0.0))) is None
    assert relocalise(lines_of(np.arange(12) % 3, way(12, step=0.2))) is not None


def test_a_robot_is_not_moved_from_where_it_should_be_if_that_fits():
    lines = lines_of(np.arange(10) % 5, way(10))
    assert relocalise(lines, (np.array(LOST), within(0.1, 0.05))) is None
    elsewhere = np.add(LOST, [1.5, -1.0, 0.4])
    assert relocalise(lines, (elsewhere, within(0.1, 0.05))) is not None


def test_a_landmark_in_a_wrong_place_moves_no_robot_however_often_it_is_seen():
    lines = lines_of([0, 1, 2, 3, 3, 3, 3, 3, 3], way(9, step=0.01), wrong_place=[3])
    assert relocalise(lines, (np.array(LOST), within(0.1, 0.05))) is None


def mapped():
    """A smoother's state and landmarks, the five of `MARKS`, well known."""
    smoother = Smoother(np.ones(7), np.ones(NC), np.ones(3), CorrelatedErrors(), 0.0)
    landmarks = Landmarks(smoother, 0.06)
    for place in MARKS:
        number = smoother.add_landmark(place)
        landmarks.mapped[str(number)] = Landmark(str(number), number)
    mean = np.concatenate([np.zeros(HEAD), MARKS.ravel()])
    smoother.state = Marginal(mean, 1e-4 * np.eye(mean.size))
    return smoother, landmarks


def test_equal_bearings_from_two_headings_are_two_sight_lines():
    """As of a camera whose bearings are whole degrees: the robot turns, and says the same again."""
    smoother, landmarks = mapped()
    search = Search()
    frame = WeighedFrame(0.0, ["0"], np.array([0.5]), np.array([0.01]))
    for heading in (0.0, 0.5, 0.51, 0.0):
        camera = Motion(np.array([0.0, 0.0, heading]), np.zeros((3, 3)), np.zeros((3, NC)))
        search.add_bearings(frame, camera, landmarks)
    assert search.find(landmarks, smoother.state) is None  # one landmark tells no pose


def test_a_sight_line_seen_again_takes_no_place_of_others():
    cameras = [*way(5, step=0.1), *(5 * [Pose(0.4, 0.0, 0.16)])]
    whole = lines_of([0, 1, 2, 3, 4, 0, 0, 0, 0, 0], cameras)
    search = Search()
    smoother, landmarks = mapped()
    for name, camera, seen in zip(whole.names, cameras, whole.bearings, strict=True):
        frame = WeighedFrame(0.0, [str(name)], np.array([seen]), np.array([0.01]))
        for _ in range(20):
            motion = Motion(np.array(camera), np.zeros((3, 3)), np.zeros((3, NC)))
            search.add_bearings(frame, motion, landmarks)
    found = search.find(landmarks, smoother.state)
    assert found is not None
    assert found[0][:2] == pytest.approx(LOST[:2], abs=0.1)


def slipped(expected, seed, sigma=0.015):
    """Find a robot at `LOST` that is expected elsewhere, to 1 cm and 0.01 rad."""
    smoother, landmarks = mapped()
    mean = smoother.state.mean.copy()
    mean[:3] = expected
    smoother.state = Marginal(mean, smoother.state.covariance)
    rng, search = np.random.default_rng(seed), Search(Motion.identity())
    names, sigmas = [str(i) for i in range(len(MARKS))], np.full(len(MARKS), sigma)
    for camera in way(2, step=0.5):
        seen = np.array([bearing(compose(LOST, camera), *mark) for mark in MARKS])
        frame = WeighedFrame(0.0, names, wrap(seen + sigma * rng.normal(size=5)), sigmas)
        motion = Motion(np.array(camera), np.zeros((3, 3)), np.zeros((3, NC)))
        search.add_bearings(frame, motion, landmarks)
    found = search.find(landmarks, smoother.state)
    assert found is not None
    off = found[0] - LOST
    return math.hypot(off[0], off[1]), off @ np.linalg.solve(found[1], off)


def test_a_robot_that_only_turned_keeps_its_position():
    found = [slipped(np.add(LOST, [0.005, -0.005, 0.5]), seed) for seed in range(10)]
    assert np.mean([error for error, _ in found]) < 0.015  # 2 cm by the lines alone
    assert np.mean([nees for _, nees in found]) < 6.0


def test_a_robot_that_slipped_away_does_not_keep_its_position():
    found = [slipped(np.add(LOST, [-0.3, 0.2, 0.4]), seed) for seed in range(10)]
    assert np.mean([error for error, _ in found]) < 0.1
    assert np.mean([nees for _, nees in found]) < 6.0
