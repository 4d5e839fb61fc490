"""The renderer's geometry against closed forms: what each ray meets, and where."""

import math

import numpy as np
import pytest

from homeward.drives.cameras.camera import unit_vectors
from homeward.lab.simulation.render.rays import raycast
from homeward.lab.simulation.render.rays.raycast import compiled, points, trace, viewpoint
from homeward.lab.simulation.render.rays.surfaces import Skin, Surfaces, block, rectangle, upright

SKIN = Skin(0, 1.0)
ROOM = np.array([[0, 0], [6, 0], [6, 4], [0, 4]], float)


def shell(height=2.5):
    """Return floor (0), ceiling (1) and walls (2 and on) of a room of 6 x 4 m."""
    x, y = np.array([6.0, 0, 0]), np.array([0, 4.0, 0])
    walls = [
        upright(b, a, 0.0, height, SKIN, 2 + i)
        for i, (a, b) in enumerate(zip(ROOM, np.roll(ROOM, -1, axis=0), strict=True))
    ]
    floor = rectangle(np.zeros(3), x, y, SKIN, 0)
    return [floor, rectangle(np.array([0, 0, height]), y, x, SKIN, 1), *walls]


def panorama(width, height, dtype=np.float64):
    """Return the directions of a panorama's pixels."""
    azimuth = math.pi - 2 * math.pi * (np.arange(width) + 0.5) / width
    elevation = (height / 2 - np.arange(height) - 0.5) * 2 * math.pi / width
    return unit_vectors(*np.meshgrid(azimuth, elevation)).astype(dtype)


def slabs(origin, direction):
    """Return where a ray leaves the box of 6 x 4 x 2.5 m, by hand."""
    with np.errstate(divide="ignore"):
        exits = np.maximum((0 - origin) / direction, ([6, 4, 2.5] - origin) / direction)
    return origin + exits.min(axis=-1, keepdims=True) * direction


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.12, -0.2)])
def test_every_pixel_shows_the_point_where_its_ray_meets_the_room(tilt):
    view = viewpoint(2.2, 1.3, 0.5, 0.7, *tilt)
    rays = panorama(256, 64)
    hits = trace(Surfaces.joined(shell()), view, rays)
    expected = slabs(view.position, rays @ view.rotation.T)
    np.testing.assert_allclose(points(hits, view, rays), expected, atol=1e-9)


def test_a_ray_straight_ahead_goes_where_the_camera_points():
    view = viewpoint(2.0, 2.0, 0.5, math.pi / 2)
    hits = trace(Surfaces.joined(shell()), view, np.array([1.0, 0, 0]))
    np.testing.assert_allclose(points(hits, view, np.array([1.0, 0, 0])), [2, 4, 0.5], atol=1e-12)
    left = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(
        points(trace(Surfaces.joined(shell()), view, left), view, left), [0, 2, 0.5], atol=1e-12
    )


def test_pitch_is_nose_down_and_roll_turns_left_up():
    axis, left = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    assert (viewpoint(0, 0, 0, 0.3, pitch=0.1).rotation @ axis)[2] == pytest.approx(-math.sin(0.1))
    assert (viewpoint(0, 0, 0, 0.3, roll=0.1).rotation @ left)[2] == pytest.approx(math.sin(0.1))
    turned = viewpoint(0, 0, 0, 0.3, 0.1, 0.2).rotation
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-15)


def test_the_nearer_of_two_boxes_hides_the_other_in_either_order():
    near = block((4.0, 2.0), 0.2, (0.4, 0.4, 1.0), 0.0, SKIN, 7, 0)
    far = block((5.0, 2.0), 0.0, (0.4, 2.0, 2.0), 0.0, SKIN, 8, 0)
    view, ahead = (
        viewpoint(2.0, 2.0, 0.5, 0.0),
        np.array([[1.0, 0, 0], [1.0, 0.25, 0], [1, 0, 0.4]]),
    )
    for order in (near + far, far + near):
        surfaces = Surfaces.joined([*shell(), *order])
        met = surfaces.thing[trace(surfaces, view, ahead).surface]
        assert met.tolist() == [7, 8, 8]


def test_single_precision_sees_the_same_room():
    surfaces, view = Surfaces.joined(shell()), viewpoint(2.2, 1.3, 0.5, 0.7)
    exact = trace(surfaces, view, panorama(256, 64))
    quick = trace(surfaces, view, panorama(256, 64, np.float32))
    np.testing.assert_allclose(quick.distance, exact.distance, rtol=1e-5)
    assert np.mean(quick.surface != exact.surface) < 1e-3


@pytest.mark.skipif(compiled() is None, reason="no C compiler, nothing to compare")
@pytest.mark.parametrize("height", [62, 14])
def test_compiled_code_sees_the_same_room(monkeypatch, height):
    parts = shell()
    for i in range(3):
        parts += block((4.0, 1.0 + i), 0.4, (0.4, 0.5, 0.9), 0.3, SKIN, 6 + i, i)
    surfaces = Surfaces.joined(parts)
    for heading in np.linspace(-3, 3, 7):
        view = viewpoint(2.2, 1.3, 0.5, heading, 0.1, -0.05)
        native = trace(surfaces, view, panorama(128, height, np.float32))
        with monkeypatch.context() as patch:
            patch.setattr(raycast, "compiled", lambda: None)
            plain = trace(surfaces, view, panorama(128, height, np.float32))
        same = native.surface == plain.surface
        # On an edge, rounding decides.
        assert same.mean() > 0.999
        for field in ("distance", "across", "along"):
            found, expected = getattr(native, field)[same], getattr(plain, field)[same]
            np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_turning_the_camera_rolls_the_image():
    """Nothing is special at the seam: a turn by whole columns moves the picture round it."""
    surfaces = Surfaces.joined(shell() + block((4, 1), 0.3, (0.5, 0.5, 1), 0.0, SKIN, 7, 0))
    headings = 0.1, 0.1 + math.radians(51)
    ahead, turned = (
        trace(surfaces, viewpoint(2.2, 1.3, 0.5, h), panorama(120, 30)) for h in headings
    )
    np.testing.assert_allclose(np.roll(ahead.distance, 17, axis=1), turned.distance, rtol=1e-9)


def test_a_surface_is_seen_from_the_right_of_its_ground_line_alone():
    a, b, ahead = np.array([1.0, 1.0]), np.array([1.0, -1.0]), np.array([1.0, 0.0, 0.0])
    assert trace(upright(a, b, -1.0, 1.0, SKIN, 0), viewpoint(0, 0, 0, 0), ahead).surface == 0
    assert trace(upright(b, a, -1.0, 1.0, SKIN, 0), viewpoint(0, 0, 0, 0), ahead).surface == -1


def test_tile_coordinates_grow_to_the_right_and_up():
    wall = upright(np.array([2.0, 1.0]), np.array([2.0, -1.0]), 0.0, 2.0, Skin(0, 0.5), 0)
    right_and_up = np.array([1.0, -0.1, 0.2])
    hits = trace(wall, viewpoint(0, 0, 1, 0), right_and_up)
    assert (hits.across, hits.along) == (pytest.approx(2.4), pytest.approx(2.8))
