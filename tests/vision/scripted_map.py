"""A scripted map, and comparisons with home's picture for a scene."""

import math

import numpy as np

from homeward.estimator import Counts, Estimate, LandmarkEstimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, to_polar
from homeward.vision.comparison import Comparison
from homeward.vision.geometry.a_contrario import Acceptance
from homeward.vision.geometry.epipolar import Motion, Pairs

SIGMA = 0.002


def scene(n=24, seed=0):
    """Return landmarks all round, (n, 2) in the frame of home's camera [m]."""
    rng = np.random.default_rng(seed)
    azimuth, distance = rng.uniform(-math.pi, math.pi, n), rng.uniform(1.0, 5.0, n)
    return distance[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def bearings(points, camera):
    """Return the bearings (n,) of points from a camera's pose [rad]."""
    d = points - [camera.x, camera.y]
    return np.asarray(wrap(np.arctan2(d[:, 1], d[:, 0]) - camera.heading))


class Map:
    """An estimator with scripted results."""

    name, notes = "map", ()

    def __init__(self, points, pose=None, status=Status.LOCALISED, sigma=0.01):
        self.counts = Counts()
        self.pose, self.status, self.sigma = pose, status, sigma
        self.found = [
            LandmarkEstimate(f"h{i}", x, y, math.hypot(x, y), 0.05, moved=False)
            for i, (x, y) in enumerate(points.tolist())
        ]

    def odometry(self, t, v, omega):
        pass

    def bearings(self, t, sightings, sigmas=None):
        return self.estimate(t)

    def estimate(self, t):
        covariance = None if self.pose is None else self.sigma**2 * np.eye(3)
        return Estimate(t, self.status, "as scripted", self.pose, covariance)

    def landmarks(self):
        return self.found


def compared(points, camera, accepted=True, direction_sigma=0.01):
    """Return how a picture from a camera's pose compares with home's, every feature matched."""
    n, polar = len(points), to_polar(camera)
    angles = [bearings(points, p) for p in (Pose(0.0, 0.0, 0.0), camera)]
    flat, spread = np.zeros(n), np.tile(2 * SIGMA**2 * np.eye(2), (n, 1, 1))
    rows = np.arange(n)
    return Comparison(
        Acceptance(accepted, "", -10.0),
        Pairs.of(*(np.column_stack([a, flat]) for a in angles), spread, flat),
        rows,
        rows,
        np.zeros((n, 2)),
        np.full(n, accepted),
        np.zeros(n, bool),
        Motion(float(polar.theta), float(polar.alpha)),
        np.diag([direction_sigma, 0.005]) ** 2 if accepted else np.full((2, 2), np.inf),
        np.diag([0.001, 0.001]) ** 2 if accepted else np.full((2, 2), np.inf),
        parallax=50.0 if direction_sigma < 0.3 else 1.0,
    )
