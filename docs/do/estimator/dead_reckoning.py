"""Dead reckoning from the start prior: a minimal estimator."""

import math

import numpy as np

from homeward import Counts, Estimate, Pose, Status
from homeward.geometry.frames import from_polar, polar_covariance_to_pose
from homeward.odometry.validity import TWIST_VALIDITY_S


class DeadReckoning:
    name = "dead-reckoning"
    notes = ("Bearings are ignored.",)

    def __init__(self, drive):
        start = drive.settings.start
        sigmas = start.sigma_R, start.sigma_theta, start.sigma_alpha
        self.pose = from_polar(start.polar)
        self.covariance = polar_covariance_to_pose(start.polar, np.diag(np.square(sigmas)))
        self.noise = drive.settings.odometry.speed_sigma or 0.05  # m/s/sqrt(Hz)
        self.twist = math.nan, 0.0, 0.0
        self.counts = Counts()

    def odometry(self, t, v, omega):  # the previous twist applied until now
        self.pose, self.covariance = self.predicted(t)
        self.twist = t, v, omega

    def predicted(self, t):
        since, v, omega = self.twist
        if math.isnan(since):
            return self.pose, self.covariance
        dt = min(t - since, TWIST_VALIDITY_S)
        x, y, heading = self.pose
        middle = heading + omega * dt / 2
        dx, dy = v * dt * math.cos(middle), v * dt * math.sin(middle)
        move = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        grown = move @ self.covariance @ move.T + np.eye(3) * self.noise**2 * dt
        return Pose(x + dx, y + dy, math.remainder(heading + omega * dt, math.tau)), grown

    def bearings(self, t, sightings, sigmas=None):  # {id: rad}: a real estimator would use them
        return self.estimate(t)

    def estimate(self, t):
        return Estimate(t, Status.COASTING, "odometry alone", *self.predicted(t))

    def landmarks(self):
        return []


DeadReckoning.needs_start = True  # from drive.yaml, --start, or ground truth
make = DeadReckoning
