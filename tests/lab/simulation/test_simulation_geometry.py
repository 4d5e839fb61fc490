"""What a camera has in view, by cases drawn by hand."""

import math

import numpy as np
import pytest

from homeward.geometry.frames import Pose
from homeward.lab.simulation.scenario import Room, Visibility
from homeward.lab.simulation.world import first_surface, hidden, in_view

ROOM = Room(bounds=(0, 0, 10, 6), shelves=((4, 2, 6, 3),))


@pytest.mark.parametrize(
    ("camera", "point", "is_hidden"),
    [
        ((1, 2.5), (9, 2.5), True),  # straight through
        ((1, 2.5), (3.9, 2.5), False),  # in front of it
        ((1, 2.5), (5, 2.5), True),  # inside
        ((1, 1), (9, 1), False),  # past it, parallel to its side
        ((1, 2), (9, 2), False),  # along its face
        ((5, 0), (5, 6), True),  # straight up
        ((3, 0), (3, 6), False),
        ((1, 2.5), (4, 2.5), False),  # hangs on the near face
        ((1, 2.5), (4.00005, 2.5), False),  # and was measured to a tenth of a millimetre
        ((1, 2.5), (6, 2.5), True),  # hangs on the far face
        ((5, 5), (5, 3), False),  # hangs on the upper face, seen from above
        ((5, 1), (5, 3), True),  # and from below
        ((3, 1), (5, 3.5), True),  # across the upper left corner region
        ((3, 2.2), (4.5, 3.5), False),  # just over the corner
        ((1, 2.5), (-5, 2.5), False),  # the shelf is behind the camera
    ],
)
def test_shelves_hide_what_is_behind_them(camera, point, is_hidden):
    assert hidden(np.array(camera, float), np.array([point], float), ROOM)[0] == is_hidden
    # Seen backwards through the same shelf; a point on a face is not a camera's place.
    if not any(math.isclose(p, f, rel_tol=1e-3) for p, f in zip(point, (4, 3), strict=True)):
        assert hidden(np.array(point, float), np.array([camera], float), ROOM)[0] == is_hidden


def test_hidden_agrees_with_walking_along_the_line():
    rng = np.random.default_rng(3)
    cameras, points = rng.uniform([0, 0], [10, 6], (2, 300, 2))
    room = Room(bounds=ROOM.bounds, shelves=((4, 2, 6, 3), (1, 4, 1.5, 5.5), (7, 0.5, 9, 1)))
    steps = np.linspace(0, 1, 4001)[:, None]
    for camera, point in zip(cameras, points, strict=True):
        way = camera + steps * (point - camera)
        # The shortest chord that the walk must not step over is 4 mm.
        inside = [
            ((way > np.add(s[:2], d)) & (way < np.subtract(s[2:], d))).all(axis=1).any()
            for s in room.shelves
            for d in (0.0, 0.004)
        ]
        blocked = hidden(camera, point[None], room)[0]
        if any(inside[0::2]) == any(inside[1::2]):  # not a mere graze
            assert blocked == any(inside)


def test_the_field_of_view_ends_at_its_edges():
    camera = Pose(1.0, 2.0, 0.5)
    angles = np.array([-1.01, -0.99, 0.0, 0.99, 1.01, math.pi])
    points = np.stack([1 + 3 * np.cos(0.5 + angles), 2 + 3 * np.sin(0.5 + angles)], axis=-1)
    view = in_view(camera, points, Visibility(field_of_view=2.0), None)
    np.testing.assert_array_equal(view, [False, True, True, True, False, False])
    assert in_view(camera, points, Visibility(), None).all()


def test_the_range_has_a_near_and_a_far_end():
    points = np.array([[0.49, 0], [0.51, 0], [2.99, 0], [3.01, 0]])
    view = in_view(Pose(0, 0, 0), points, Visibility(range=(0.5, 3.0)), None)
    np.testing.assert_array_equal(view, [False, True, True, False])


def test_many_cameras_at_once_are_each_as_alone():
    rng = np.random.default_rng(1)
    cameras = Pose(rng.uniform(0, 10, 40), rng.uniform(0, 6, 40), rng.uniform(-3, 3, 40))
    points = rng.uniform([0, 0], [10, 6], (9, 2))
    visibility = Visibility(field_of_view=3.0, range=(0.2, 6.0))
    together = in_view(cameras, points, visibility, ROOM)
    alone = [in_view(Pose(*c), points, visibility, ROOM) for c in zip(*cameras, strict=True)]
    assert together.shape == (40, 9)
    assert 0 < together.sum() < together.size
    np.testing.assert_array_equal(together, alone)


def test_occlusion_can_be_off():
    points, camera = np.array([[9.0, 2.5]]), Pose(1.0, 2.5, 0.0)
    assert not in_view(camera, points, Visibility(), ROOM)[0]
    assert in_view(camera, points, Visibility(occlusion=False), ROOM)[0]


@pytest.mark.parametrize(
    ("x", "y", "direction", "distance"),
    [
        (1.0, 2.5, 0.0, 3.0),  # the shelf
        (1.0, 2.5, math.pi, 1.0),  # the wall behind
        (1.0, 1.0, 0.0, 9.0),  # past the shelf to the far wall
        (8.0, 2.5, math.pi, 2.0),
        (5.0, 0.0, math.pi / 2, 2.0),
        (1.0, 1.0, math.pi / 4, 5.0 * math.sqrt(2)),  # the upper wall, at (6, 6)
        (9.0, 5.0, math.pi / 4, math.sqrt(2)),  # into the corner
    ],
)
def test_the_first_surface_in_a_direction(x, y, direction, distance):
    room = ROOM if y != 1.0 or direction == 0.0 else Room(bounds=ROOM.bounds)
    assert first_surface(x, y, direction, room) == pytest.approx(distance)
