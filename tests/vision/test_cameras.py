"""Which direction a pixel looks in, for every camera, and rings unwrapped."""

import numpy as np
import pytest

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.io.checks import ValidationError
from homeward.vision.cameras.panoramic import SECTORS, Cylindrical, Equirectangular, sector_of
from homeward.vision.cameras.ring import BLURRED_EDGE, Ring, find_ring

cv2 = pytest.importorskip("cv2")
SHAPE = (100, 360)


def looks(camera, column, row, shape=SHAPE):
    azimuth, elevation = camera.directions(np.array([column]), np.array([row]), shape)
    return np.degrees([azimuth[0], elevation[0]])


def test_the_middle_of_the_image_looks_along_the_axis():
    assert looks(Equirectangular(), 179.5, 49.5) == pytest.approx([0, 0])


def test_left_of_the_axis_is_positive_and_above_the_horizon_too():
    assert looks(Equirectangular(), 179.5 - 90, 49.5 - 20) == pytest.approx([90, 20])


def test_columns_wrap_round():
    before, after = looks(Equirectangular(), -0.5, 49.5), looks(Equirectangular(), 359.5, 49.5)
    assert before == pytest.approx([180, 0])
    assert after == pytest.approx([180, 0])


def test_axis_and_horizon_may_stand_elsewhere():
    assert looks(Equirectangular(axis=0, horizon=0.8), -0.5, 79.5) == pytest.approx([0, 0])


def test_a_cylinder_has_the_tangent_of_the_elevation():
    camera = Cylindrical()
    above = np.tan(np.radians(20)) * 360 / (2 * np.pi)
    assert looks(camera, 179.5, 49.5 - above) == pytest.approx([0, 20])


def test_known_tilt_is_taken_out():
    """A camera that looks down by 10 deg sees the horizon 10 deg above its middle."""
    camera = Equirectangular(pitch=np.radians(10))
    assert looks(camera, 179.5, 49.5 - 10) == pytest.approx([0, 0], abs=1e-9)
    leaning = Equirectangular(roll=np.radians(10))
    # Its left side is raised: the direction straight left is 10 deg up.
    assert looks(leaning, 179.5 - 90, 49.5) == pytest.approx([90, 10], abs=1e-9)


def test_a_rotated_or_square_image_is_no_panorama():
    with pytest.raises(InputError, match="rotated"):
        Equirectangular().panorama(np.zeros((300, 100), np.uint8))
    with pytest.raises(InputError, match="specify its camera"):
        Equirectangular().panorama(np.zeros((300, 300), np.uint8))


def ring_picture(mark_direction_deg, mark_radius, centre=(250.0, 240.0), inner=50, outer=220):
    image = np.zeros((500, 500), np.uint8)
    spot = (round(centre[0]), round(centre[1]))
    cv2.circle(image, spot, outer, 150, -1)
    cv2.circle(image, spot, inner, 0, -1)
    a = np.radians(mark_direction_deg)
    x, y = centre[0] + mark_radius * np.cos(a), centre[1] - mark_radius * np.sin(a)
    cv2.circle(image, (round(x), round(y)), 5, 255, -1)
    return image


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize(
    "model",
    [
        {"elevations": (-0.9, 0.3)},
        {"polynomial": (-150.0, 0.0, 0.004)},
        {"mirror": (1.3, 400.0)},
    ],
)
def test_a_mark_on_the_ring_comes_out_where_it_is(mirrored, model):
    ring = Ring(
        centre=(250, 240), inner=50, outer=220, axis_direction=np.pi / 2, mirrored=mirrored, **model
    )
    panorama = ring.panorama(ring_picture(90 + 40, 150))
    assert panorama.shape[1] % 16 == 0
    row, column = np.argwhere(panorama > 200).mean(axis=0)
    azimuth, elevation = looks(ring, column, row, panorama.shape)
    assert azimuth == pytest.approx(-40 if mirrored else 40, abs=0.5)
    radii, table = ring.elevation_table()
    assert np.radians(elevation) == pytest.approx(np.interp(150, radii, table), abs=0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        {"elevations": (-0.9, 0.3), "outer": 55},
        {"elevations": (-0.9, 0.3), "mirror": (1.3, 400)},
        {},
        {"mirror": (0.9, 400)},
        {"elevations": (0.2, 0.2)},
        {"elevations": (-0.9, 0.3), "horizon": 0.3},
    ],
)
def test_a_ring_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValidationError):
        Ring(**{"centre": (250, 240), "inner": 50, "outer": 220, **wrong})


def test_a_ring_must_lie_in_the_image():
    ring = Ring(centre=(250, 240), inner=50, outer=220, elevations=(-0.9, 0.3))
    with pytest.raises(InputError, match="do not contain a ring"):
        ring.panorama(np.zeros((300, 400), np.uint8))


def test_centre_and_radii_are_found():
    found = find_ring(ring_picture(0, 100, centre=(260, 235)))
    assert found.centre == pytest.approx((260, 235), abs=0.5)
    assert found.inner - BLURRED_EDGE == pytest.approx(50, abs=0.7)
    assert found.outer + BLURRED_EDGE == pytest.approx(220, abs=0.7)


def test_no_rim_is_left_in_the_panorama_of_a_ring_that_was_found():
    image = cv2.GaussianBlur(ring_picture(0, 135), (0, 0), 0.6)
    found = find_ring(image)
    ring = Ring(**found._asdict(), elevations=(-0.9, 0.3))
    panorama = ring.panorama(image)
    assert panorama[[0, -1]].min() > 140


def test_no_ring_is_said():
    with pytest.raises(InputError, match="no bright ring"):
        find_ring(np.full((200, 200), 128, np.uint8))


@pytest.mark.parametrize("kind", [Equirectangular, Cylindrical])
def test_slopes_are_the_derivatives_of_directions_across_the_seam_too(kind):
    camera, shape = kind(roll=0.1, pitch=-0.05), (100, 400)
    columns, rows = np.array([-0.4, 120.3, 399.2]), np.array([30.0, 52.5, 80.1])
    here, slope = camera.directions_and_slope(columns, rows, shape)
    assert np.array_equal(here, np.column_stack(camera.directions(columns, rows, shape)))
    step = np.array([0.03, -0.02])
    there = np.column_stack(camera.directions(columns + step[0], rows + step[1], shape))
    assert np.allclose(slope @ step, wrap(there - here), atol=1e-6)


def test_sectors_go_all_round_and_are_alike():
    azimuth = np.linspace(-np.pi, np.pi, 24 * 100, endpoint=False) + 1e-6
    sector = sector_of(azimuth)
    assert np.bincount(sector).tolist() == [100] * SECTORS
    assert (np.diff(sector) >= 0).all()
    assert sector_of(np.array([np.pi]))[0] == 0  # where -pi lies, too
