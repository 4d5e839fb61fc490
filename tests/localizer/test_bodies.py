"""Landmarks that move together, such as two tags on one box."""

import math

import numpy as np
from rig import Rig, ring

from homeward.estimator import Status
from homeward.geometry.frames import Twist
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.bodies import find_bodies
from homeward.localizer.output.faces import moved_probabilities
from homeward.localizer.tunables import MAX_TESTED

PRIOR, SIZE = 0.1, 8.0
CORNERS = [(-4.0, -3.0), (4.0, -3.0), (4.0, 3.0), (-4.0, 3.0)]
BOX = [(1.0, 2.0), (1.3, 2.0)]


def moved(places, now, sigma=0.02):
    """Return the probability of each landmark to have moved between two maps."""
    covariance = sigma**2 * np.eye(2 * len(places))
    before, after = (np.array(places), covariance), (np.array(now), covariance)
    names = [f"{i}" for i in range(len(places))]
    return moved_probabilities(before, after, np.full(len(places), PRIOR), SIZE, names, ())


def bodies(places, size=SIZE, together=()):
    return find_bodies([f"{i}" for i in range(len(places))], places, together, size)


def test_two_tags_on_one_box_do_not_confirm_each_other():
    assert moved(BOX, BOX).min() > 0.05
    apart = [(-2.0, 2.0), (2.0, 2.0)]
    assert moved(apart, apart).max() < 0.05


def test_a_box_that_was_carried_and_turned_outvotes_no_landmark_in_place():
    carried = [(-2.0, 0.5), (-2.0, 0.8)]
    found = moved([*CORNERS[:3], *BOX], [*CORNERS[:3], *carried])
    assert found[:3].max() < 0.05
    assert found[3:].min() > 0.95


def test_a_box_in_place_among_others_is_still_evidence():
    assert moved([*CORNERS, *BOX], [*CORNERS, *BOX]).max() < 0.01


def test_one_of_two_tags_on_a_box_may_move_alone():
    found = moved([*CORNERS, *BOX], [*CORNERS, BOX[0], (2.0, 0.0)])
    assert found[:5].max() < 0.05
    assert found[5] > 0.95


def test_moves_are_found_on_a_site_with_more_landmarks_than_are_tested_together():
    middles = np.random.default_rng(2).uniform(0.0, SIZE, (2 * MAX_TESTED, 2))
    places = np.concatenate([middles, np.add(middles, (0.2, 0.0))])  # the other tags of the boxes
    box = np.tile(np.arange(len(middles)), 2)
    now, wrong = places.copy(), np.isin(box, [3, MAX_TESTED - 1, MAX_TESTED + 1, 70, 95])
    now[box == 3] += (0.5, 0.4)
    now[wrong] += (0.4, -0.5)
    wrong[MAX_TESTED + 5] = True  # a tag that moved alone
    now[MAX_TESTED + 5] += (-0.6, 0.2)
    found = moved(places, now)
    assert found[wrong].min() > 0.95
    assert found[~wrong].max() < 0.05


def test_at_another_site_no_landmark_of_many_is_in_place():
    rng = np.random.default_rng(3)
    places, others = rng.uniform(0.0, SIZE, (2, 2 * MAX_TESTED, 2))
    assert moved(places, others).mean() > 0.9


def test_a_survey_reports_moves_of_all_its_landmarks():
    rig = Rig(ring(MAX_TESTED + 12, 4), 4)
    survey = {n: {"x": x, "y": y} for n, (x, y) in rig.landmarks.items()}
    for name in ("L5", f"L{MAX_TESTED + 4}"):
        x, y = rig.landmarks[name]
        rig.landmarks[name] = (x - 0.5, y + 0.6)
    known = {"frame": "home", "sigma": 0.02, "landmarks": survey}
    odometry = rig.settings.odometry.model_copy(update={"delay_sigma": 0.0})
    rig.localizer = Localizer({}, known=known, sensor=rig.settings.sensor, odometry=odometry)
    rig.drive(10.0)  # `Rig.check` compares the reported moves


def test_bodies_are_small_and_disjoint():
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, 4.0, (40, 2))
    found = bodies(places)
    assert len(found.members) > 3
    assert found.members.sum(axis=0).max() == 1
    for members in found.members:
        apart = places[members][:, None] - places[members]
        assert np.hypot(*apart.T).max() <= 0.5


def test_all_landmarks_of_a_small_site_are_no_body():
    places = np.random.default_rng(1).uniform(0.0, 0.4, (6, 2))
    assert not bodies(places, 0.4).members.all(axis=1).any()


def test_a_robot_that_first_sees_a_moved_box_is_not_led_astray():
    """As two tags at a fixed distance from each other, they fit the survey in a wrong place."""
    rig = Rig(ring(12, 3) | {"box a": (1.5, 0.8), "box b": (1.8, 0.7)}, 3, promise=None)
    survey = {n: {"x": x, "y": y} for n, (x, y) in rig.landmarks.items()}
    for name in ("box a", "box b"):
        x, y = rig.landmarks[name]
        rig.landmarks[name] = (x - 0.4, y + 1.0)
    known = {"frame": "home", "sigma": 0.05, "landmarks": survey}
    rig.localizer = Localizer({}, known=known, **rig.settings.robot)

    def box_first(seen):
        names = ("box a", "box b") if rig.t < 106.0 else seen
        return {n: seen[n] for n in names}

    rig.drive(20.0, lambda _: Twist(0.2, 0.3), box_first)
    posed = [(a, p) for a, p in rig.answers if a.pose is not None]
    off = [math.hypot(a.pose.x - p.x, a.pose.y - p.y) for a, p in posed]
    assert max(off) < 0.3
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.moved() == {"box a", "box b"}


def test_tags_that_are_given_as_one_body_are_one_wherever_they_are():
    apart = np.array([(-2.0, 2.0), (2.0, 2.0), (2.1, 2.0), *CORNERS])
    assert [list(np.flatnonzero(m)) for m in bodies(apart).members] == [[1, 2]]
    given = bodies(apart, together=[["0", "3"], ["3", "4"], ["1"]])
    assert [list(np.flatnonzero(m)) for m in given.members] == [[0, 3, 4]]


def boxes(moved, together=()):
    """Drive among three landmarks and two boxes of two tags, `moved` of which were carried."""
    landmarks = {"A": (3.0, 0.5), "B": (-1.0, 3.0), "C": (-2.5, -1.5)}
    landmarks |= {"p": (0.5, -2.5), "q": (0.8, -2.4), "r": (2.0, 2.2), "s": (2.1, 1.9)}
    rig = Rig(landmarks, 1, promise=None)
    for name in moved:
        x, y = rig.landmarks[name]
        rig.landmarks[name] = (x + 0.9, y - 0.3)
    rig.localizer = Localizer(rig.home, **rig.settings.robot | {"together": together})
    rig.drive(30.0)
    return rig


def test_a_box_that_was_carried_is_found_by_home_bearings():
    rig = boxes(["p", "q"])
    assert rig.moved() == {"p", "q"}
    assert rig.error() < 0.1


def test_two_boxes_alone_verify_no_pose():
    rig = boxes([], [["A", "p", "q"], ["B", "C", "r", "s"]])
    last = rig.answers[-1][0]
    assert last.status is Status.UNVERIFIED
    assert "only 2 are independent" in last.reason
