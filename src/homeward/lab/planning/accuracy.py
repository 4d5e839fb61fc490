"""The Cramer-Rao bound of a fix, at thousands of places at once.

The scene of `homeward.lab.bounds.posterior_bound`, vectorised: at each place the robot drives a
short arc whose middle is there, takes bearings at some stops on it, knows its odometry up to white
noise, and home's bearings; landmarks are unknown but for what these tell (and a survey, where there
is one). Each landmark's own position is eliminated, which leaves its information on the pose and on
the odometry's errors; these add up over landmarks, so that hiding one is a subtraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.planning.floor import Floor
from homeward.lab.planning.settings import Plan

POSE = 3
VAGUE = 1e4
"""Nothing is further away than this [m], which keeps unobservable directions finite ..."""
UNTOLD = 1e2
"""... and a position less certain than this [m] counts as not told."""
HEADINGS = 4
"""Number of directions, twice it with a narrow camera, of which the robot takes the best."""
FULL = 2 * np.pi - 1e-3
"""A camera with this field of view sees all round [rad]."""


@dataclass(frozen=True)
class Fix:
    """What a robot knows after its arc, at n places."""

    position: np.ndarray
    """(n,), root mean square error of the position at best [m]; infinite where it is not told."""
    heading: np.ndarray
    """(n,), the same of the heading [rad]."""


@dataclass(frozen=True)
class Information:
    """Information from q landmarks at n places, in one direction, or in several: (H, n, ...)."""

    each: np.ndarray
    """(n, q, d (d + 1) / 2), upper triangles of informations on the unknowns."""
    seen: np.ndarray
    """(n, q), bool: seen from the arc at all."""
    common: np.ndarray
    """(n, q), bool: and from home."""

    @cached_property
    def every(self) -> np.ndarray:
        """(n, d (d + 1) / 2), of all landmarks together."""
        return np.asarray(self.each.sum(axis=-2))

    @cached_property
    def count(self) -> np.ndarray:
        """(n,), how many are in common with home."""
        return np.asarray(self.common.sum(axis=-1))


class Arcs:
    """The arc of a plan in every direction, and the information in bearings from it."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.d = POSE + 2 * (plan.drive.stops - 1)
        """Of the unknowns: the last pose, and the odometry's errors in units of their sigmas."""
        self.upper = np.triu_indices(self.d)
        count = HEADINGS if plan.sensor.field_of_view >= FULL else 2 * HEADINGS
        self.headings = np.arange(count) * 2 * np.pi / count
        self.stops = [_stops(plan, heading) for heading in self.headings]
        self.pairs = [(k, m) for k in range(plan.drive.stops) for m in range(k, plan.drive.stops)]
        self._maps = [self._feature_map(stops) for stops in self.stops]

    def _feature_map(self, stops: np.ndarray) -> np.ndarray:
        """Return what turns features, 9 a pair of stops, into information (.., d (d + 1) / 2)."""
        by_unknowns = _stop_by_unknowns(self.plan, stops)
        rows, columns = self.upper
        out = []
        for k, m in self.pairs:
            # A bearing's gradient is -(a_x A_0 + a_y A_1 + A_2), by the landmark it is (a_x, a_y).
            for p in by_unknowns[k]:
                for r in by_unknowns[m]:
                    both = p[rows] * r[columns]
                    out.append(both if k == m else both + r[rows] * p[columns])
        return np.array(out) / self.plan.sensor.bearing_sigma**2

    def told(
        self, places: np.ndarray, marks: np.ndarray, visible: np.ndarray, stored: np.ndarray, h: int
    ) -> Information:
        """Return the information from each landmark, for heading number `h`, at each place.

        Places (n, 2) are the middles of the arc, marks (q, 2) the landmarks [m]. `visible` (n, q)
        says which have a line of sight, `stored` (q,) which of them home sees; range and field of
        view are checked here.
        """
        n, i = np.nonzero(visible)
        gradients = self._gradients(places[n], marks[i], h)
        ok = gradients.any(axis=(1, 2))
        n, i, gradients = n[ok], i[ok], gradients[ok]
        weights = self._free_of_the_mark(gradients, marks[i], stored[i])
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

    def _free_of_the_mark(
        self, gradients: np.ndarray, marks: np.ndarray, stored: np.ndarray
    ) -> list[np.ndarray]:
        """Return, for each pair of stops, the weight (m,) of their bearings' product.

        With rows g of all derivatives by the mark, the bearings project to what the mark does not
        explain by I - G (G'G)^-1 G'. Its entries are sums of products of g x g: exact where the
        rows are nearly parallel, and matrices would cancel.
        """
        plan = self.plan
        dx, dy = (marks - (plan.home.x, plan.home.y)).T
        weight = stored / (plan.sensor.home_sigma * np.maximum(dx * dx + dy * dy, 1e-6))
        known = np.full(len(marks), 1 / (plan.landmark_sigma or VAGUE))
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
        """Return the bound on the last pose, given summed informations (n, d (d + 1) / 2)."""
        size = self.d
        table = [[np.empty(0)] * size for _ in range(size)]
        for row, column, entry in zip(
            *self.upper, np.ascontiguousarray(information.T), strict=True
        ):
            table[row][column] = entry
        for i in range(POSE):
            table[i][i] = table[i][i] + 1 / VAGUE**2
        for pivot in reversed(range(POSE, size)):
            inverse = 1 / (table[pivot][pivot] + 1.0)  # an error's own prior is 1
            for i in range(pivot):
                factor = table[i][pivot] * inverse
                for j in range(i, pivot):
                    table[i][j] = table[i][j] - factor * table[j][pivot]
        return _invert(table)

    def score(self, fix: Fix, common: np.ndarray) -> np.ndarray:
        """Return the larger error as a share of its limit; infinite with too few landmarks."""
        limits = self.plan.limits
        worse = np.maximum(fix.position / limits.position, fix.heading / limits.heading)
        return np.asarray(np.where(common >= limits.landmarks, worse, np.inf))


def _invert(H: list[list[np.ndarray]]) -> Fix:
    """Return the errors of a pose whose information (3, 3) has this upper triangle."""
    # The heading first, then the plane: stable where lever arms are long.
    xx = np.maximum(H[0][0], 0.0) + 1 / VAGUE**2
    yx, hx = H[0][1] / xx, H[0][2] / xx
    yy = np.maximum(H[1][1] - yx * H[0][1], 0.0) + 1 / VAGUE**2
    hy = (H[1][2] - yx * H[0][2]) / yy
    hh = np.maximum(H[2][2] - hx * H[0][2] - hy * hy * yy, 0.0) + 1 / VAGUE**2
    # L^-1 of the factors L D L'.
    lx, mx = yx, yx * hy - hx
    var_x = 1 / xx + lx * lx / yy + mx * mx / hh
    var_y = 1 / yy + hy * hy / hh
    position, heading = np.sqrt(var_x + var_y), np.sqrt(1 / hh)
    untold = position > UNTOLD
    return Fix(np.where(untold, np.inf, position), np.where(untold, np.inf, heading))


def _stops(plan: Plan, heading: float) -> np.ndarray:
    """Return the stops of the arc: offsets from its middle [m] and headings [rad], (s, 3)."""
    drive = plan.drive
    along = np.linspace(-0.5, 0.5, drive.stops) * drive.length
    arc = Twist(1.0, drive.turn / drive.length)
    return np.stack(advance(Pose(0.0, 0.0, heading), arc, along), axis=1)


def _stop_by_unknowns(plan: Plan, stops: np.ndarray) -> np.ndarray:
    """Return derivatives (s, 3, d) of the stops by the last one and the odometry's errors."""
    s = len(stops)
    d = POSE + 2 * (s - 1)
    dt = plan.drive.length / plan.drive.speed / (s - 1)
    rate = plan.drive.turn / (s - 1)
    out = np.zeros((s, POSE, d))
    out[-1, :, :POSE] = np.eye(POSE)
    for k in range(s - 2, -1, -1):
        middle, swing = stops[k, 2] + 0.5 * rate, 0.5 * plan.drive.speed * dt
        noise = np.array(
            [
                [np.cos(middle), -swing * np.sin(middle)],
                [np.sin(middle), swing * np.cos(middle)],
                [0.0, 1.0],
            ]
        )
        noise *= np.sqrt(dt) * np.array([plan.odometry.speed_sigma, plan.odometry.turn_sigma])
        step = out[k + 1].copy()
        step[:, POSE + 2 * k : POSE + 2 * k + 2] -= noise
        back = np.eye(POSE)
        back[:2, 2] = stops[k + 1, 1] - stops[k, 1], stops[k, 0] - stops[k + 1, 0]
        out[k] = back @ step
    return out


def home_sees(plan: Plan, floor: Floor, marks: np.ndarray) -> np.ndarray:
    """Return which marks (q, 2) the camera sees at home, shape (q,): in sight, range and view."""
    home = np.array([[plan.home.x, plan.home.y]])
    dx, dy = (marks - home).T
    return np.asarray(floor.sees(home, marks)[0] & _in_view(plan, dx, dy, plan.home.heading))


def _in_view(plan: Plan, dx: np.ndarray, dy: np.ndarray, heading: float) -> np.ndarray:
    """Return which offsets from the camera [m] are in its range and field of view."""
    (least, most), opening = plan.sensor.range, plan.sensor.field_of_view
    far = np.hypot(dx, dy)
    seen = (far >= least) & (far <= most)
    if opening < FULL:
        seen &= dx * np.cos(heading) + dy * np.sin(heading) >= np.cos(opening / 2) * far
    return np.asarray(seen)
