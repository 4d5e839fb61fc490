"""Cramer-Rao bound of the pose, at thousands of places at once.

This is `homeward.lab.bounds.posterior_bound`, vectorised: at each place the robot drives a short
arc around it and takes bearings at some stops, with white noise of odometry and with home bearings;
landmarks are unknown except for these bearings (and a survey, if there is one). Each landmark's
position is eliminated, which leaves its information on the pose and on the errors of odometry.
These add up over landmarks, so that hiding a landmark is a subtraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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


@dataclass(frozen=True)
class Fix:
    """Bound on the pose after the arc, at n places."""

    position: np.ndarray
    """(n,), minimum position error [m], RMS; infinite where unobservable."""
    heading: np.ndarray
    """(n,), minimum heading error [rad], RMS; infinite where unobservable."""


@dataclass(frozen=True)
class Information:
    """Information from q landmarks at n places, in one direction."""

    each: np.ndarray
    """(n, q, d (d + 1) / 2), upper triangles of information matrices of the unknowns."""
    seen: np.ndarray
    """(n, q), bool: seen from the arc."""
    common: np.ndarray
    """(n, q), bool: seen from the arc and from home."""

    @cached_property
    def every(self) -> np.ndarray:
        """(n, d (d + 1) / 2), sum over all landmarks."""
        return np.asarray(self.each.sum(axis=1))

    @cached_property
    def count(self) -> np.ndarray:
        """(n,), number of landmarks in common with home."""
        return np.asarray(self.common.sum(axis=1))


class Arcs:
    """The arc of a plan in all directions, and the information of its bearings."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.d = POSE + 2 * (plan.drive.stops - 1)
        """Number of unknowns: the last pose, and the errors of odometry, in sigmas."""
        self.upper = np.triu_indices(self.d)
        count = HEADINGS if plan.sensor.field_of_view >= FULL else 2 * HEADINGS
        self.headings = np.arange(count) * 2 * np.pi / count
        self.stops = [_stops(plan, heading) for heading in self.headings]
        self.pairs = [(k, m) for k in range(plan.drive.stops) for m in range(k, plan.drive.stops)]
        self._maps = [self._feature_map(stops) for stops in self.stops]

    def _feature_map(self, stops: np.ndarray) -> np.ndarray:
        """Return the map from features, 9 a pair of stops, to information (.., d (d + 1) / 2)."""
        by_unknowns = _stop_by_unknowns(self.plan, stops)
        rows, columns = self.upper
        out = []
        for k, m in self.pairs:
            # The gradient of a bearing is -(a_x A_0 + a_y A_1 + A_2); by the landmark (a_x, a_y).
            for p in by_unknowns[k]:
                for r in by_unknowns[m]:
                    both = p[rows] * r[columns]
                    out.append(both if k == m else both + r[rows] * p[columns])
        return np.array(out) / self.plan.sensor.bearing_sigma**2

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
        features = np.empty((n.size, len(self.pairs), 3, 3))
        for f, (k, m) in enumerate(self.pairs):
            both = gradients[:, k, :, None] * gradients[:, m, None, :]
            features[:, f] = weights[f][:, None, None] * both
        size = self.upper[0].size
        information = np.zeros((*visible.shape, size))
        information[n, i] = features.reshape(n.size, 9 * len(self.pairs)) @ self._maps[h]
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
    ) -> list[np.ndarray]:
        """Return, for each pair of stops, the weight (m,) of the product of their bearings.

        With the derivatives by the landmark as rows of G, the projection I - G (G'G)^-1 G'
        eliminates its position. Its entries are computed as sums of products of cross products,
        which stay accurate where rows are nearly parallel.
        """
        plan = self.plan
        dx, dy = (marks - (plan.home.x, plan.home.y)).T
        weight = stored / (plan.sensor.home_sigma * np.maximum(dx * dx + dy * dy, 1e-6))
        known = np.full(len(marks), 1 / (plan.landmark_sigma or WEAK_PRIOR_M))
        zero = np.zeros(len(marks))
        rows = [tuple(g.T / plan.sensor.bearing_sigma) for g in np.moveaxis(gradients, 1, 0)]
        rows = [(g[0], g[1]) for g in rows]
        rows += [(-dy * weight, dx * weight), (known, zero), (zero, known)]
        count = len(rows)
        cross = [[g[0] * o[1] - g[1] * o[0] for o in rows] for g in rows]
        squares = {(k, m): cross[k][m] ** 2 for k in range(count) for m in range(k + 1, count)}
        determinant = sum(squares.values(), zero)
        weights = []
        for k, m in self.pairs:
            if k == m:
                entry = sum((v for pair, v in squares.items() if k not in pair), zero)
            else:
                entry = -sum((cross[k][o] * cross[m][o] for o in range(count)), zero)
            weights.append(entry / determinant)
        return weights

    def fix(self, information: np.ndarray) -> Fix:
        """Return the bound on the last pose from summed information (n, d (d + 1) / 2)."""
        size = self.d
        table = [[np.empty(0)] * size for _ in range(size)]
        for row, column, entry in zip(
            *self.upper, np.ascontiguousarray(information.T), strict=True
        ):
            table[row][column] = entry
        for i in range(POSE):
            table[i][i] = table[i][i] + 1 / WEAK_PRIOR_M**2
        for pivot in reversed(range(POSE, size)):
            inverse = 1 / (table[pivot][pivot] + 1.0)  # the prior variance of an error is 1
            for i in range(pivot):
                factor = table[i][pivot] * inverse
                for j in range(i, pivot):
                    table[i][j] = table[i][j] - factor * table[j][pivot]
        return _invert(table)

    def score(self, fix: Fix, common: np.ndarray) -> np.ndarray:
        """Return the larger error relative to its limit; infinite with too few landmarks."""
        limits = self.plan.limits
        worse = np.maximum(fix.position / limits.position, fix.heading / limits.heading)
        return np.asarray(np.where(common >= limits.landmarks, worse, np.inf))


def _invert(H: list[list[np.ndarray]]) -> Fix:
    """Return the bound on a pose from the upper triangle of its information (3, 3)."""
    # The heading before the position: stable for long lever arms.
    xx = np.maximum(H[0][0], 0.0) + 1 / WEAK_PRIOR_M**2
    yx, hx = H[0][1] / xx, H[0][2] / xx
    yy = np.maximum(H[1][1] - yx * H[0][1], 0.0) + 1 / WEAK_PRIOR_M**2
    hy = (H[1][2] - yx * H[0][2]) / yy
    hh = np.maximum(H[2][2] - hx * H[0][2] - hy * hy * yy, 0.0) + 1 / WEAK_PRIOR_M**2
    # L^-1 of the factors L D L'.
    lx, mx = yx, yx * hy - hx
    var_x = 1 / xx + lx * lx / yy + mx * mx / hh
    var_y = 1 / yy + hy * hy / hh
    position, heading = np.sqrt(var_x + var_y), np.sqrt(1 / hh)
    unknown = position > UNOBSERVABLE_M
    return Fix(np.where(unknown, np.inf, position), np.where(unknown, np.inf, heading))


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
