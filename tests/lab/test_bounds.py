"""The bound against dense information, and its properties."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.lab.bounds import RunningBound, posterior_bound

SIGMAS = {"bearing_sigma": 0.05, "home_sigma": 0.01, "speed_sigma": 0.02, "turn_sigma": 0.05}


STEPS, DT, SPEED = 6, 0.8, 0.25
STEP = 1e-6


class Arc:
    """An arc among landmarks all round home, and its measurements."""

    def __init__(self, bearing: float, turn: float, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.twists = np.tile([SPEED, turn], (STEPS, 1))
        angles = 2 * np.pi * np.arange(6) / 6 + rng.uniform(-0.3, 0.3, 6)
        far = rng.uniform(1.5, 3.0, 6)
        self.marks = np.stack([far * np.cos(angles), far * np.sin(angles)], axis=1)
        self.visible = rng.random((STEPS + 1, 6)) < 0.8
        self.sigmas = {
            "bearing_sigma": bearing,
            "home_sigma": bearing,
            "speed_sigma": 0.01,
            "turn_sigma": 0.01,
        }
        self.truth = np.concatenate([[0.7, -0.5, 0.3], np.zeros(2 * STEPS), self.marks.ravel()])
        self.scale = np.repeat(
            [0.01 / np.sqrt(DT), bearing], [2 * STEPS, int(self.visible.sum()) + 6]
        )

    def poses(self, unknowns: np.ndarray) -> np.ndarray:
        """Return all poses (..., steps + 1, 3) of unknowns (..., 3 + 2 steps + 2 q)."""
        poses = [unknowns[..., :3]]
        errors = unknowns[..., 3 : 3 + 2 * STEPS].reshape(*unknowns.shape[:-1], STEPS, 2)
        for k in range(STEPS):
            v, omega = np.moveaxis(self.twists[k] + errors[..., k, :], -1, 0)
            x, y, heading = np.moveaxis(poses[-1], -1, 0)
            chord = v * DT * np.sinc(omega * DT / 2 / np.pi)
            middle = heading + omega * DT / 2
            ahead = x + chord * np.cos(middle), y + chord * np.sin(middle)
            poses.append(np.stack([*ahead, heading + omega * DT], axis=-1))
        return np.stack(poses, axis=-2)

    def measured(self, unknowns: np.ndarray) -> np.ndarray:
        """Return odometry errors, bearings on the arc and at home, shape (..., m)."""
        poses, q = self.poses(unknowns), len(self.marks)
        marks = unknowns[..., 3 + 2 * STEPS :].reshape(*unknowns.shape[:-1], 1, q, 2)
        d = marks - poses[..., :, None, :2]
        seen = wrap(np.arctan2(d[..., 1], d[..., 0]) - poses[..., 2:3])[..., self.visible]
        home = np.arctan2(marks[..., 0, :, 1], marks[..., 0, :, 0])
        return np.concatenate([unknowns[..., 3 : 3 + 2 * STEPS], seen, home], axis=-1)

    def estimate(self, data: np.ndarray) -> np.ndarray:
        """Return the unknowns of greatest likelihood."""
        x = self.truth.copy()
        for _ in range(8):
            both = x + STEP * np.stack([np.eye(x.size), -np.eye(x.size)])
            ahead, back = self.measured(both)
            jacobian = wrap(ahead - back).T / (2 * STEP) / self.scale[:, None]
            residual = wrap(data - self.measured(x)) / self.scale
            x = x + np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        return x

    def bound(self) -> np.ndarray:
        """Return the bound of the last pose, shape (3, 3)."""
        poses = self.poses(self.truth)
        dt = np.full(STEPS, DT)
        return posterior_bound(poses, self.twists, dt, self.marks, self.visible, **self.sigmas)[-1]


def scene(n=30, q=5):
    poses, pose = [], Pose(0.7, -0.5, 0.3)
    for _ in range(n):
        poses.append(pose)
        pose = compose(pose, Pose(0.02, 0.0, 0.05))
    angles = 2 * math.pi * np.arange(q) / q
    marks = 1.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    twists = np.tile([0.2, 0.5], (n - 1, 1))
    visible = np.random.default_rng(0).random((n, q)) < 0.7
    return np.array(poses), twists, np.full(n - 1, 0.1), marks, visible


def test_without_noise_of_the_odometry_it_is_the_static_bound():
    poses, twists, dt, marks, visible = scene()
    sigmas = {**SIGMAS, "speed_sigma": 0.0, "turn_sigma": 0.0}
    bound = posterior_bound(
        poses, twists, dt, marks, visible, start_covariance=0.01 * np.eye(3), **sigmas
    )[-1]
    # dense: the last pose and the landmarks are all that is unknown
    q = len(marks)
    information = np.zeros((3 + 2 * q, 3 + 2 * q))
    end = poses[-1]

    def all_bearings(x):
        rows = []
        for pose in poses:
            home = np.array(end)
            c, s = np.cos(x[2] - home[2]), np.sin(x[2] - home[2])
            d = pose[:2] - home[:2]
            here = x[:2] + np.array([c * d[0] - s * d[1], s * d[0] + c * d[1]])
            m = x[3:].reshape(-1, 2) - here
            rows.append(np.arctan2(m[:, 1], m[:, 0]) - x[2])
        return np.array(rows)

    x = np.r_[end, marks.ravel()]
    for i in range(x.size):
        for j in range(i + 1):
            ji, jj = (
                (all_bearings(x + e) - all_bearings(x - e)) / 2e-6
                for e in (1e-6 * np.eye(x.size)[i], 1e-6 * np.eye(x.size)[j])
            )
            information[i, j] = information[j, i] = (ji * jj)[visible].sum() / 0.05**2
    for k, (mx, my) in enumerate(marks):
        g = np.array([-my, mx]) / (mx * mx + my * my) / 0.01
        information[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k] += np.outer(g, g)
    back = np.eye(3)
    back[0, 2], back[1, 2] = end[1] - poses[0, 1], poses[0, 0] - end[0]
    information[:3, :3] += back.T @ back / 0.01
    assert np.allclose(bound, np.linalg.inv(information)[:3, :3], rtol=1e-4)


def test_less_information_is_never_better():
    poses, twists, dt, marks, visible = scene()
    start = 0.01 * np.eye(3)
    full = posterior_bound(poses, twists, dt, marks, visible, start_covariance=start, **SIGMAS)
    moved = np.array([True, False, False, False, False])
    less = posterior_bound(
        poses, twists, dt, marks, visible, start_covariance=start, moved=moved, **SIGMAS
    )
    assert np.linalg.eigvalsh(less[-1] - full[-1])[0] > -1e-12
    none = posterior_bound(poses, twists, dt, marks, visible, **SIGMAS)
    assert np.isinf(none[0]).all()
    assert np.isfinite(none[-1]).all()
    assert np.linalg.eigvalsh(none[-1] - full[-1])[0] > -1e-9


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_a_further_landmark_never_grows_the_bound(seed):
    rng = np.random.default_rng(seed)
    poses, twists, dt, _, _ = scene(n=8)
    marks = rng.uniform(-2, 2, (6, 2))
    visible = rng.random((8, 6)) < 0.6
    args = {"start_covariance": 0.04 * np.eye(3), **SIGMAS}
    fewer = posterior_bound(poses, twists, dt, marks[:-1], visible[:, :-1], **args)
    more = posterior_bound(poses, twists, dt, marks, visible, **args)
    for small, large in zip(more, fewer, strict=True):
        # the bound's information spans ten powers of ten: few digits are left of its inverse
        assert np.linalg.eigvalsh(large - small)[0] > -1e-6 * np.trace(large)


@pytest.mark.parametrize(("bearing_deg", "turn"), [(0.3, 0.2), (1.0, 0.0)])
def test_an_efficient_estimator_reaches_the_bound(bearing_deg, turn):
    arc = Arc(np.radians(bearing_deg), turn)
    rng, bound, end = np.random.default_rng(5), arc.bound(), arc.poses(arc.truth)[-1]
    ratios = []
    for _ in range(120):
        data = arc.measured(arc.truth) + arc.scale * rng.standard_normal(arc.scale.size)
        error = arc.poses(arc.estimate(data))[-1] - end
        error[2] = wrap(error[2])
        ratios.append(error @ np.linalg.solve(bound, error) / 3)
    # 3.3 standard deviations of the mean of 120 chi-squares with 3 degrees of freedom
    assert np.mean(ratios) == pytest.approx(1.0, abs=3.3 * math.sqrt(2 / 3 / 120))


@pytest.mark.parametrize("mount", [Pose(0.0, 0.0, 0.0), Pose(0.3, -0.2, 0.5)])
def test_a_camera_elsewhere_and_a_robot_that_was_carried(mount):
    _, _, _, marks, _ = scene(q=6)
    poses = np.array([[0.7, -0.5, 0.3], [0.0, 0.0, 0.3], [-0.4, 0.6, -0.7]])
    v, dt, straight = 0.8, 0.5, 1e-4
    poses[1, :2] = poses[0, :2] + v * dt * np.array([math.cos(0.3), math.sin(0.3)])

    def measured(x):
        seen, (first, second, third) = [], (Pose(*p) for p in x[:9].reshape(3, 3))
        for pose in (Pose(0.0, 0.0, 0.0), first, second, third):
            camera, d = compose(pose, mount), x[9:].reshape(-1, 2)
            seen.append(wrap(np.arctan2(*(d - camera[:2]).T[::-1]) - camera.heading))
        ahead, aside, turn = between(first, second)
        return np.concatenate([*seen, [ahead, aside - 0.5 * v * dt * turn, turn]])

    driven = np.array([SIGMAS["speed_sigma"], straight, SIGMAS["turn_sigma"]]) * math.sqrt(dt)
    bearing_sigmas = np.repeat([SIGMAS["home_sigma"], SIGMAS["bearing_sigma"]], [6, 18])
    truth = np.concatenate([poses.ravel(), marks.ravel()])
    steps = 1e-6 * np.eye(truth.size)
    jacobian = np.stack([wrap(measured(truth + e) - measured(truth - e)) for e in steps], axis=-1)
    jacobian /= 2e-6 * np.concatenate([bearing_sigmas, driven])[:, None]
    dense = np.linalg.inv(jacobian.T @ jacobian)

    twists, intervals, seen = (
        np.array([[v, 0.0], [0.0, 0.0]]),
        np.full(2, dt),
        np.ones((3, 6), bool),
    )
    marked = {"mount": mount, "carried": np.array([False, True]), **SIGMAS}
    bound = posterior_bound(poses, twists, intervals, marks, seen, **marked)
    assert bound[-1] == pytest.approx(dense[6:9, 6:9], rel=1e-3)


def test_a_long_drive_has_a_bound_to_its_end():
    poses, twists, dt, marks, visible = scene(n=1000, q=12)
    bound = posterior_bound(poses, twists, dt, marks, visible, **SIGMAS)
    assert np.isfinite(bound[100:]).all()
    assert bound[500:, 0, 0].max() < 2.0 * bound[100:200, 0, 0].max()


def test_a_landmark_known_to_have_moved_adds_no_information_by_itself():
    poses, _, _, marks, _ = scene()
    bound = RunningBound(marks, **SIGMAS, start_covariance=0.01 * np.eye(3))
    everything = np.ones(len(marks), bool)
    bound.see(poses[0], marks, everything)
    known = bound.covariance()
    bound.move(0)
    np.testing.assert_allclose(bound.covariance(), known, rtol=1e-9, atol=1e-9)
    bound.see(poses[5], marks, np.arange(len(marks)) == 0)
    np.testing.assert_allclose(bound.covariance(), known, rtol=1e-9, atol=1e-9)
    bound.see(poses[5], marks, everything)
    assert np.linalg.eigvalsh(known - bound.covariance()).min() > 0
    bound.carry()
    assert np.isinf(bound.covariance()).all()
