"""Lens models against OpenCV's, and what no lens can be."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.io.checks import ValidationError

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
NUMBERS = {"fx": 500, "fy": 510, "cx": 320, "cy": 240}
LENSES = {
    "plumb_bob": (-0.28, 0.07, 2e-4, 1e-5, 0.0),
    "rational_polynomial": (0.5, 0.1, 1e-4, 2e-4, 0.01, 0.8, 0.2, 0.03),
    "equidistant": (-0.02, 0.005, -0.001, 0.0002),
}
FOLDED = (0.392, -4.428, 0.0, 0.0, 0.0)
"""Of a real camera of 44 degrees, without its last coefficient."""


@pytest.fixture(params=LENSES)
def lens(request):
    return Lens(**NUMBERS, model=request.param, distortion=LENSES[request.param])


def drawn_by_opencv(lens, points):
    """Pixels (n, 2) of points (n, 3), optical axes."""
    k, still = np.array(lens.distortion), np.zeros(3)
    if lens.model == "equidistant":
        return cv2.fisheye.projectPoints(points[:, None], still, still, K, k)[0][:, 0]
    return cv2.projectPoints(points, still, still, K, k)[0][:, 0]


def random_points(seed=0, n=400):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.7, 0.7, (n, 2)), np.ones(n)])


def directions_of(points):
    x, y, z = points.T
    return np.arctan2(-x, z), np.arctan2(-y, np.hypot(x, z))


def test_rays_fall_where_opencv_draws_them(lens):
    points = random_points()
    ours = np.column_stack(lens.pixels(*directions_of(points)))
    assert ours == pytest.approx(drawn_by_opencv(lens, points), abs=1e-9)


@given(
    st.sampled_from(list(LENSES)),
    st.floats(-0.6, 0.6),
    st.floats(-0.4, 0.4),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
)
def test_there_and_back(model, azimuth, elevation, roll, pitch):
    lens = Lens(**NUMBERS, model=model, distortion=LENSES[model], roll=roll, pitch=pitch)
    ray = unit_vectors(azimuth, elevation) @ tilt_matrix(roll, pitch).T
    level = np.arctan2(ray[1], ray[0]), np.arcsin(ray[2])
    u, v = lens.pixels(np.array([level[0]]), np.array([level[1]]))
    back = lens.directions(u, v)
    assert np.concatenate(back) == pytest.approx(level, abs=1e-8)


def test_a_fisheye_sees_behind_itself():
    lens = Lens(**NUMBERS, model="equidistant", distortion=(0.0, 0.0, 0.0, 0.0))
    u, v = lens.pixels(np.array([1.9]), np.array([0.0]))
    assert (u[0] - 320) / 500 == pytest.approx(-1.9)
    assert lens.directions(u, v)[0] == pytest.approx([1.9])


def test_beyond_the_fold_there_is_nothing():
    lens = Lens(fx=210, fy=210, cx=107, cy=87, distortion=FOLDED)
    columns = np.linspace(-2000, 2000, 501)
    azimuth, _ = lens.directions(columns, np.full(501, 87.0))
    there = np.isfinite(azimuth)
    assert there[np.abs(columns - 107) < 70].all()
    assert not there[np.abs(columns - 107) > 150].any()
    assert (np.diff(azimuth[there]) < 0).all()
    back, _ = lens.pixels(azimuth[there], np.zeros(there.sum()))
    assert back == pytest.approx(columns[there], abs=1e-4)
    assert np.isnan(lens.pixels(np.array([2.0]), np.array([0.0]))[0])


def test_nan_stays_nan(lens):
    azimuth, elevation = lens.directions(np.array([np.nan, 320.0]), np.array([1.0, 240.0]))
    assert np.isnan(azimuth[0])
    assert (azimuth[1], elevation[1]) == (0.0, 0.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"fx": 0},
        {"fx": float("nan")},
        {"cx": 700, "width": 640},
        {"distortion": (1.0, 2.0, 3.0)},
        {"distortion": (float("inf"), 0.0, 0.0, 0.0)},
        {"distortion": (-5e3, 0.0, 0.0, 0.0)},
        {"model": "equidistant", "distortion": (1.0,) * 5},
        {"model": "mei"},
        {"width": -1},
    ],
)
def test_what_is_no_lens(wrong):
    with pytest.raises(ValidationError):
        Lens(**{**NUMBERS, **wrong})


def test_pictures_of_another_size_are_refused():
    lens = Lens(**NUMBERS, width=640, height=480)
    lens.require_shape((480, 640))
    with pytest.raises(InputError, match="1280x960 pixels, but the camera is calibrated for 640x4"):
        lens.require_shape((960, 1280))
