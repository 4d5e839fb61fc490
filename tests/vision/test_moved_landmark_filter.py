"""What may be a wrong match is not called moved; what goes along with a thing that was moved is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_visual_homing import Map, compared, scene
from vision_scene import look as draw
from vision_scene import make_room

from homeward.estimator import LandmarkEstimate
from homeward.geometry.frames import Pose
from homeward.vision import Equirectangular, VisualHoming, compare, extract
from homeward.vision.front_end import home_name
from homeward.vision.homing.visual_homing import MovedLandmarkFilter

STILL = LandmarkEstimate("h9", 2.0, 0.0, 2.0, 0.05, 0.0, 0.0, 0.01, moved=False)


def gone(name, by, at=0.0, distance=2.0):
    """Return a landmark that home saw in direction `at`, with an error of `by` [rad]."""
    return replace(
        STILL,
        landmark=name,
        distance=distance,
        home_bearing_stored=at,
        home_bearing_estimated=at + by,
        moved_probability=1.0,
        moved=True,
    )


def verdicts(moved_filter, *landmarks):
    return {m.landmark: m.moved for m in moved_filter.filtered(list(landmarks))}


@pytest.mark.parametrize(
    ("sightings", "frames", "off", "moved"),
    [(40, 50, 0.3, True), (5, 50, 0.3, None), (15, 60, 0.3, None), (40, 50, 0.02, None)],
)
def test_what_may_be_a_wrong_match_is_not_called_moved(sightings, frames, off, moved):
    inner = Map(scene(n=1))
    inner.found = [gone("h0", off), STILL]
    sight = VisualHoming(inner)
    for k in range(frames):
        sight.bearings(0.2 * k, {"h0": 0.1} if k < sightings else {"h9": 0.2})
    first, second = sight.landmarks()
    assert first.moved is moved
    assert math.isnan(first.moved_probability) == (moved is None)
    assert second == STILL


def test_features_of_a_box_that_was_moved_are_called_moved_after_some_pictures():
    """Not after the first of them, and no other feature that contradicts the motion."""
    room, camera, moved_filter = make_room(6), Equirectangular(), MovedLandmarkFilter()
    home = extract(draw(room, 3.0, 3.0, 0.4), camera)
    low, high, texture = room.boxes[3]
    away = np.array([0.5 if low[0] < 4 else -0.5, 0.3 if low[1] < 3 else -0.3, 0.0])
    room.boxes[3] = low + away, high + away, texture
    moved, stray = [], set()
    for k in range(4):
        now = extract(draw(room, 3.1 + 0.05 * k, 3.1, 0.9, seed=k), camera)
        seen = compare(home, now, camera)
        moved_filter.add_comparison(seen)
        moved.append(set(seen.home_row[seen.moved].tolist()))
        stray |= set(seen.home_row[~seen.agrees & ~seen.moved].tolist())
        called = [home_name(row) for row in set.intersection(*moved)]
        found = verdicts(moved_filter, *(gone(landmark, 0.05) for landmark in called))
        assert called
        assert set(found.values()) == {None if k < 2 else True}
    others = [home_name(row) for row in stray - set.union(*moved)]
    assert others
    found = verdicts(moved_filter, *(gone(landmark, 0.05) for landmark in others))
    assert set(found.values()) == {None}


def test_what_has_gone_where_its_neighbour_has_is_moved_like_that_one():
    moved_filter = MovedLandmarkFilter()
    for _ in range(20):
        moved_filter.add_frame(["h0"])
    found = verdicts(
        moved_filter,
        gone("h0", 0.3, at=math.pi - 0.05),
        gone("h1", 0.28, at=-math.pi + 0.05, distance=2.2),
        gone("far aside", 0.3, at=2.0),
        gone("otherwise", 0.1, at=3.0),
        gone("before it", 0.3, at=3.0, distance=1.0),
        STILL,
    )
    assert [name for name, moved in found.items() if moved] == ["h0", "h1"]
    assert found["h9"] is False


def test_a_share_counts_of_the_frames_since_it_was_first_seen():
    moved_filter = MovedLandmarkFilter()
    for k in range(60):
        moved_filter.add_frame(["h0"] if k >= 40 else [])
    assert verdicts(moved_filter, gone("h0", 0.3))["h0"]


def test_what_goes_along_with_others_now_and_then_is_not_on_a_thing():
    points = scene()
    inner = Map(points)
    inner.found = [gone("h0", 0.05)]
    sight, seen = VisualHoming(inner), compared(points, Pose(0.5, 0.2, 0.3))
    seen.moved[0] = True
    for k in range(3):
        sight.home(float(k), seen)
    for k in range(100):
        sight.bearings(float(k), {"h0": 0.1})
    assert sight.landmarks()[0].moved is None


def test_half_a_turn_is_half_a_turn_either_way():
    moved_filter = MovedLandmarkFilter()
    for _ in range(20):
        moved_filter.add_frame(["h0"])
    assert verdicts(moved_filter, gone("h0", math.pi - 0.01), gone("h1", math.pi + 0.01))["h1"]


def test_two_that_are_not_sure_do_not_make_each_other_sure():
    assert not any(verdicts(MovedLandmarkFilter(), gone("h0", 0.3), gone("h1", 0.3)).values())


def test_what_moved_before_the_robot_s_eyes_is_called_moved():
    assert verdicts(MovedLandmarkFilter(), replace(gone("h0", 0.01), moved_at=12.0))["h0"]
