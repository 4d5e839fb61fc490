"""Views: a landmark is missed only where it was seen before."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from visited import new_place, room, visit_data

from homeward.drives.settings import DriveSettings
from homeward.geometry.frames import Pose
from homeward.places.files import load_place, save_place
from homeward.places.joint_map import JointMap
from homeward.places.views import SECTORS, Views, VisitFrames
from homeward.places.visit_data import visit_frames
from homeward.places.visiting import merged

HOME = Pose(0.0, 0.0, 0.0)
PLACES = {"near": (2.0, 0.1), "far": (6.0, 0.0)}


def joint(sigma=0.01):
    xy = np.array([*PLACES.values()]).ravel()
    return JointMap(tuple(PLACES), (), xy, sigma**2 * np.eye(xy.size))


def around(radius, seen, sigma=0.0, begin=-1.4, end=1.4):
    """Frames on an arc around the near landmark, facing it."""
    angles = np.linspace(begin, end, 40)
    x, y = 2.0 + radius * np.cos(angles), 0.1 + radius * np.sin(angles)
    cameras = np.column_stack([x, y, angles + math.pi])
    return VisitFrames(cameras, 40 * [seen], 2.0, np.full(40, sigma))


def in_sight(visit, before=None, places=None):
    """The number of views with the near landmark in sight, as it was seen before."""
    known = (before or around(1.5, ["near"])).views(joint(), HOME).seen
    views = visit.views(places or joint(), HOME)
    return views.in_sight(known)[0].get("near", 0)


def test_a_landmark_is_in_sight_where_it_was_seen_before():
    assert in_sight(around(1.4, ["far"])) > 8
    assert in_sight(around(1.4, ["far"], end=-1.2)) in (1, 2)
    assert in_sight(around(1.7, ["far"])) == 0  # farther away: a wall may be there
    opposite = around(1.4, ["far"], begin=math.pi - 1.0, end=math.pi + 1.0)
    assert in_sight(opposite) == 0  # from its other side


@pytest.mark.parametrize("sigma", [0.5, math.nan])
def test_uncertain_poses_and_landmarks_prove_nothing(sigma):
    assert in_sight(around(1.4, ["far"], sigma)) == 0
    if math.isfinite(sigma):
        assert in_sight(around(1.4, ["far"]), places=joint(sigma)) == 0


def test_a_landmark_out_of_the_range_of_this_camera_is_not_in_sight():
    before = around(1.5, ["near"])
    far = around(1.4, [])  # sees nothing at all
    assert in_sight(far, before) == 0


def test_frames_may_be_added_one_by_one():
    frames, one = around(1.4, ["near"]), Views()
    both = frames.views(joint(), HOME)
    for k in range(len(frames.seen)):
        about = frames.seen[k : k + 1], 2.0, frames.sigmas[k : k + 1]
        one.add(joint(), VisitFrames(frames.cameras[k : k + 1], *about), HOME)
    assert np.array_equal(one.seen["near"], both.seen["near"])
    assert both.seen["near"].shape == (SECTORS,)
    assert both.in_sight(one.seen) == one.in_sight(one.seen)
    assert both.in_sight(one.seen)[1] == 1.0


def test_a_landmark_behind_is_in_view_of_a_rear_camera_only():
    settings = DriveSettings(
        sensor={"x": 0.1, "field_of_view": 1.0}, cameras={"rear": {"x": -0.2, "yaw": math.pi}}
    )
    localizer = SimpleNamespace(mount=None)
    poses = np.array(2 * [(4.0, 0.0, 0.0, 0.01)])
    seen = [["far"], ["near"]], ["", "rear"]
    views = visit_frames(localizer, settings, poses, *seen).views(joint(), HOME)
    for name, at in (("far", 6.0 - 4.1), ("near", 3.8 - 2.0)):
        distances = views.passed[name][np.isfinite(views.passed[name])]
        assert distances == pytest.approx([at], abs=0.01)


def test_a_place_keeps_the_directions_from_which_landmarks_were_seen(tmp_path):
    rng, places = np.random.default_rng(0), room()
    cameras = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    frames = VisitFrames(cameras, 2 * [list(places)], None)
    place = merged(new_place(places, rng), visit_data(places, rng, pose=HOME, frames=frames))
    save_place(place, tmp_path)
    again = load_place(tmp_path).persistence
    for name, landmark in place.persistence.items():
        assert sum(d > 0.0 for d in landmark.seen_from) in (1, 2)
        assert again[name].seen_from == pytest.approx(landmark.seen_from, abs=0.01)
    moved = {**places, "L3": places["L3"] + 1.0}
    assert merged(place, visit_data(moved, rng)).persistence["L3"].seen_from == ()
