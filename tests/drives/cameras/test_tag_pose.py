"""Poses of tags: consistent covariances at all distances and angles, also where two poses fit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from homeward.drives.cameras.camera import angles, tag_bearings
from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tag_pose import SQUARE, tag_poses

SHAPE = (720, 1280)
PINHOLE = Lens(fx=600, fy=600, cx=640, cy=360, distortion=(-0.1, 0.02, 0.001, -0.001))
FISHEYE = Lens(fx=400, fy=400, cx=640, cy=360, model="equidistant", distortion=(0.02, 0, 0, 0))
SIZE, SIGMA, N = 0.16, 0.3, 150


def scene(distance, tilt, camera=PINHOLE, n=N, seed=0):
    """Positions, rotations and corners of tags in view, tilted in random directions."""
    rng = np.random.default_rng(seed)
    ahead = np.hstack([np.ones((n, 1)), rng.uniform(-0.4, 0.4, (n, 2))])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    frontal = np.stack([right, np.cross(ahead, right), ahead], axis=-1)
    about = rng.uniform(-np.pi, np.pi, (2, n))
    axis = np.stack([np.cos(about[0]), np.sin(about[0]), 0 * about[0]], axis=-1)
    roll = Rotation.from_rotvec(about[1][:, None] * [0.0, 0.0, 1.0]).as_matrix()
    rotation = frontal @ Rotation.from_rotvec(tilt * axis).as_matrix() @ roll
    position = distance * ahead
    points = position[:, None] + SIZE * SQUARE @ np.swapaxes(rotation, -1, -2)
    pixels = camera.pixels(*angles(points.reshape(-1, 3)), SHAPE)
    return position, rotation, np.stack(pixels, axis=-1).reshape(-1, 4, 2)


def errors(position, rotation, poses):
    """Errors of position and rotation vector, (n, 6)."""
    turn = [r @ p.rotation.T for r, p in zip(rotation, poses, strict=True)]
    shift = position - [p.position for p in poses]
    return np.hstack([shift, Rotation.from_matrix(turn).as_rotvec()])


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0]])
def test_without_noise_the_pose_is_exact_for_the_corners_of_opencv_and_apriltag(camera, order):
    position, rotation, corners = scene(1.5, 0.7, camera, 20)
    poses = tag_poses(corners[:, order], 0.01, np.full(20, SIZE), camera, SHAPE)
    assert np.abs(errors(position, rotation, poses)).max() < 1e-5


@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("tilt", [0, 5, 20, 50])
def test_nees_of_the_pose_is_that_of_chi_square(distance, tilt):
    position, rotation, corners = scene(distance, np.radians(tilt))
    corners += np.random.default_rng(1).normal(0.0, SIGMA, corners.shape)
    poses = tag_poses(corners, SIGMA, np.full(N, SIZE), PINHOLE, SHAPE)
    off = errors(position, rotation, poses)
    nees = np.array([e @ np.linalg.solve(p.covariance, e) for e, p in zip(off, poses, strict=True)])
    is_clear = np.array([p.other is None for p in poses])
    assert 4.2 < nees.mean() < 7.0  # 6 +- 3 sigma is 5.2 to 6.8; ambiguous tags are conservative
    assert np.mean(nees > 16.81) < 0.05  # 1 % if it were Gaussian
    if is_clear.all() and tilt > 10:
        assert 5.2 < nees.mean() < 6.9


def test_both_poses_of_a_small_tag_are_given_and_the_covariance_covers_both():
    position, rotation, corners = scene(4.0, np.radians(30))
    corners += np.random.default_rng(1).normal(0.0, SIGMA, corners.shape)
    poses = tag_poses(corners, SIGMA, np.full(N, SIZE), PINHOLE, SHAPE)
    assert np.mean([p.other is not None for p in poses]) > 0.9
    wrong = 0
    for k, pose in enumerate(poses):
        if pose.other is None:
            continue
        (off,) = errors(position[k : k + 1], rotation[k : k + 1], [pose])
        wrong += np.linalg.norm(off[3:]) > 0.5
        turn = Rotation.from_matrix(pose.other[1] @ pose.rotation.T).as_rotvec()
        shift = np.hstack([pose.other[0] - pose.position, turn])
        assert shift @ np.linalg.solve(pose.covariance, shift) < 16.82
    assert wrong > 5  # the better solution is often the wrong one


def test_nis_of_bearings_is_that_of_chi_square():
    level = PINHOLE.model_copy(update={"tilt_sigma": 1e-6})
    for distance, tilt in ((0.5, 0.0), (2.0, 0.9), (4.0, 0.4)):
        position, _, corners = scene(distance, tilt, level, 400)
        corners += np.random.default_rng(2).normal(0.0, SIGMA, corners.shape)
        bearing, sigma = tag_bearings(corners, SIGMA, level, SHAPE)
        off = np.arctan2(position[:, 1], position[:, 0]) - bearing
        assert 0.79 < np.mean((off / sigma) ** 2) < 1.21  # 3 sigma


def test_errors_of_corners_beyond_their_sigma_widen_the_covariance():
    position, rotation, corners = scene(1.0, 0.7)
    corners += np.random.default_rng(1).normal(0.0, 5 * SIGMA, corners.shape)
    poses = tag_poses(corners, SIGMA, np.full(N, SIZE), PINHOLE, SHAPE)
    off = errors(position, rotation, poses)
    nees = [e @ np.linalg.solve(p.covariance, e) for e, p in zip(off, poses, strict=True)]
    assert np.median(nees) < 12  # 150 if the covariance were that of SIGMA


@pytest.mark.parametrize(
    ("corners", "size"),
    [
        (np.full((4, 2), np.nan), SIZE),
        (np.full((4, 2), 300.0), SIZE),
        (np.array([[0.0, 0.0], [10, 10], [20, 20], [30, 30]]), SIZE),
        (np.array([[0.0, 0.0], [10, 0], [10, 10], [0, 10]]), np.nan),
        (np.array([[0.0, 0.0], [10, 10], [10, 0], [0, 10]]), SIZE),
    ],
)
def test_what_is_no_tag_of_known_size_has_no_pose_and_does_not_spoil_others(corners, size):
    position, _, good = scene(1.0, 0.7, n=1)
    both = tag_poses(np.stack([corners, good[0]]), SIGMA, np.array([size, SIZE]), PINHOLE, SHAPE)
    assert both[0] is None
    assert np.linalg.norm(both[1].position - position[0]) < 0.01
