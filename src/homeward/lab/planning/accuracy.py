"""Cramer-Rao bound of the pose, at thousands of places at once.

This is `homeward.lab.bounds.posterior_bound`, vectorised: at each place the robot drives a short
arc around it and takes bearings at some stops, with white noise of odometry and with home bearings;
landmarks are unknown except for these bearings (and a survey, if there is one). Each landmark's
position is eliminated, which leaves its information on the pose and on the errors of odometry.
These add up over landmarks, so that hiding a landmark is a subtraction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.geometry.frames import Pose, Twist, advance
from homeward.geometry.se2 import lever
from homeward.lab.bounds import odometry_noise
from homeward.lab.planning.floor import Floor
from homeward.lab.planning.settings import Plan

POSE = 3
WEAK_PRIOR_M = 1e4
"""Prior standard deviation, which keeps unobservable directions finite [m]."""
UNOBSERVABLE_M = 1e2
"""Positions with a larger standard deviation count as unobservable [m]."""
HEADINGS = 4
"""Number of directions of the arc, doubled for a narrow camera; the best one counts."""
FULL = 2 * np.pi - 1e-3
"""Minimum field of view of a panoramic camera [rad]."""


class Information(NamedTuple):
    """Information from q landmarks at n places, in one direction."""

    each: np.ndarray
    """(n, q, d, d), of the unknowns."""
    seen: np.ndarray
    """(n, q), bool: seen from the arc."""
    common: np.ndarray
    """(n, q), bool: seen from the arc and from home."""


class Arcs:
    """The arc of a plan in all directions, and the information of its bearings."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.d = POSE + 2 * (plan.drive.stops - 1)
        """Number of unknowns: the last pose, and the errors of odometry, in sigmas."""
        count = HEADINGS if plan.sensor.field_of_view >= FULL else 2 * HEADINGS
        self.headings = np.arange(count) * 2 * np.pi / count
        self.stops = [_stops(plan, heading) for heading in self.headings]
        self._by_unknowns = [_stop_by_unknowns(plan, stops) for stops in self.stops]

    def information(
        self, places: np.ndarray, marks: np.ndarray, visible: np.ndarray, stored: np.ndarray, h: int
    ) -> Information:
        """Return the information from each landmark at each place, for heading number `h`.

        Places (n, 2) are the centres of the arc, marks (q, 2) the landmarks [m]. `visible` (n, q)
        are those in line of sight, `stored` (q,) those with a home bearing; range and field of view
        are tested here.
        """
        n, i = np.nonzero(visible)
        gradients = self._gradients(places[n], marks[i], h)
        ok = gradients.any(axis=(1, 2))
        n, i, gradients = n[ok], i[ok], gradients[ok]
        weights = self._eliminate_landmark(gradients, marks[i], stored[i])
        # The gradient of a bearing is -(a_x A_0 + a_y A_1 + A_2); by the landmark (a_x, a_y).
        by_unknowns = np.einsum("nsi,sid->nsd", gradients, self._by_unknowns[h])
        information = np.zeros((*visible.shape, self.d, self.d))
        information[n, i] = by_unknowns.swapaxes(1, 2) @ weights @ by_unknowns
        seen = np.zeros(visible.shape, bool)
        seen[n, i] = True
        return Information(information, seen, seen & stored)

    def _gradients(self, places: np.ndarray, marks: np.ndarray, h: int) -> np.ndarray:
        """Return (a_x, a_y, 1) of the bearings of m marks at all stops, (m, s, 3); 0 if unseen."""
        stops = self.stops[h]
        out = np.empty((len(places), len(stops), 3))
        for k, (ox, oy, heading) in enumerate(stops):
            dx, dy = (marks - places - (ox, oy)).T
            square = np.maximum(dx * dx + dy * dy, 1e-6)
            ok = _in_view(self.plan, dx, dy, heading)
            out[:, k] = np.stack([-dy / square * ok, dx / square * ok, ok], axis=1)
        return out

    def _eliminate_landmark(
        self, gradients: np.ndarray, marks: np.ndarray, stored: np.ndarray
    ) -> np.ndarray:
        """Return the information (m, s, s) of bearings without the landmark's position.

        With the derivatives by the landmark as rows of G, the projection I - G (G'G)^-1 G'
        eliminates its position. For C, the cross products of all pairs of rows, it is
        I - 2 C C' / |C|^2, which is accurate where rows are nearly parallel.
        """
        plan = self.plan
        dx, dy = (marks - (plan.home.x, plan.home.y)).T
        weight = stored / (plan.sensor.home_sigma * np.maximum(dx * dx + dy * dy, 1e-6))
        known = np.eye(2) / (plan.landmark_sigma or WEAK_PRIOR_M)
        rows = np.concatenate(
            [
                gradients[..., :2] / plan.sensor.bearing_sigma,
                (np.stack([-dy, dx], axis=1) * weight[:, None])[:, None],
                np.broadcast_to(known, (len(marks), 2, 2)),
            ],
            axis=1,
        )
        x, y = np.moveaxis(rows, -1, 0)
        cross = x[:, :, None] * y[:, None] - y[:, :, None] * x[:, None]
        half = (cross**2).sum(axis=(1, 2), keepdims=True) / 2
        stops = gradients.shape[1]
        lost = cross[:, :stops] @ cross[:, :stops].swapaxes(1, 2) / half
        return np.asarray((np.eye(stops) - lost) / plan.sensor.bearing_sigma**2)

    def errors(self, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the minimum errors of position [m] and heading [rad] after the arc, (n,) each.

        They are RMS errors, from summed information (n, d, d); infinite where unobservable.
        """
        # The prior variance of an error of odometry, in sigmas, is 1.
        prior = np.diag(np.r_[np.full(POSE, 1 / WEAK_PRIOR_M**2), np.ones(self.d - POSE)])
        covariance = np.linalg.inv(information + prior)
        x, y, heading = (covariance[:, k, k] for k in range(POSE))
        known = (x + y > 0) & (x + y <= UNOBSERVABLE_M**2) & (heading > 0)
        position, heading = (np.sqrt(np.where(known, v, np.inf)) for v in (x + y, heading))
        return position, heading

    def score(self, position: np.ndarray, heading: np.ndarray, common: np.ndarray) -> np.ndarray:
        """Return the larger error relative to its limit; infinite with too few landmarks."""
        limits = self.plan.limits
        worse = np.maximum(position / limits.position, heading / limits.heading)
        return np.asarray(np.where(common >= limits.landmarks, worse, np.inf))


def _stops(plan: Plan, heading: float) -> np.ndarray:
    """Return the stops of the arc: offsets from its centre [m] and headings [rad], (s, 3)."""
    drive = plan.drive
    along = np.linspace(-0.5, 0.5, drive.stops) * drive.length
    arc = Twist(1.0, drive.turn / drive.length)
    return np.stack(advance(Pose(0.0, 0.0, heading), arc, along), axis=1)


def _stop_by_unknowns(plan: Plan, stops: np.ndarray) -> np.ndarray:
    """Return derivatives (s, 3, d) of the stops by the last stop and the errors of odometry."""
    s = len(stops)
    d = POSE + 2 * (s - 1)
    dt = plan.drive.length / plan.drive.speed / (s - 1)
    rate = plan.drive.turn / (s - 1)
    sigmas = plan.odometry.speed_sigma, plan.odometry.turn_sigma
    out = np.zeros((s, POSE, d))
    out[-1, :, :POSE] = np.eye(POSE)
    for k in range(s - 2, -1, -1):
        step = out[k + 1].copy()
        middle = stops[k, 2] + 0.5 * rate
        step[:, POSE + 2 * k : POSE + 2 * k + 2] -= odometry_noise(
            middle, plan.drive.speed, dt, sigmas
        )
        out[k] = lever(stops[k] - stops[k + 1]) @ step
    return out


def home_sees(plan: Plan, floor: Floor, marks: np.ndarray) -> np.ndarray:
    """Return which marks (q, 2) are in line of sight, range and field of view at home, (q,)."""
    home = np.array([[plan.home.x, plan.home.y]])
    dx, dy = (marks - home).T
    return np.asarray(floor.sees(home, marks)[0] & _in_view(plan, dx, dy, plan.home.heading))


def _in_view(plan: Plan, dx: np.ndarray, dy: np.ndarray, heading: float) -> np.ndarray:
    """Return which offsets from the camera [m] are in its range and field of view."""
    (near, far), opening = plan.sensor.range, plan.sensor.field_of_view
    distance = np.hypot(dx, dy)
    seen = (distance >= near) & (distance <= far)
    if opening < FULL:
        seen &= dx * np.cos(heading) + dy * np.sin(heading) >= np.cos(opening / 2) * distance
    return np.asarray(seen)
