"""The invariant EKF in Cartesian form: an error that does not depend on the state, and no pole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.filters.carrier import (
    LOST_SIGMA,
    Angles,
    Held,
    LandmarkBelief,
    Outputs,
    nothing_said,
)
from homeward.lab.filters.settings import Engine
from homeward.lab.model import INPUTS, discretise, home_anchored_bearing, unicycle_rates

POSE = 3
"""Entries of the error in front of the landmarks: x, y, heading."""
ITERATIONS = 5
"""Of an update, at most."""
SMALL = 1e-4
"""An update that changes by less in its numbers (m, rad, 1/m) has converged."""


@dataclass(frozen=True)
class CartesianPrior:
    """All that the filter is given before the drive; q landmarks."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], heading [rad]."""
    home: np.ndarray
    """(q,), beta* as home stored them [rad]."""
    home_sigma: np.ndarray
    """(q,) [rad]"""
    inverse_distance: float
    """Of a landmark from home, expected [1/m]."""
    inverse_sigma: float
    """Its standard deviation [1/m]."""


@dataclass(frozen=True)
class SensorNoise:
    """What is believed of odometry and camera."""

    input_density: np.ndarray
    """(2,), of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz]."""
    bearing_sigma: float
    """Of a bearing that comes without one [rad]."""
    gate: float
    """Largest innovation^2 / variance accepted."""


@dataclass(frozen=True)
class CartesianBelief:
    """A pose, and of each landmark its home bearing and its inverse distance from home."""

    pose: np.ndarray
    """(3,), x [m], y [m], heading [rad]."""
    home: np.ndarray
    """(q,) [rad]"""
    inverse: np.ndarray
    """(q,) [1/m]"""
    covariance: np.ndarray
    """(3 + 2 q, 3 + 2 q), of the error: of the pose, of `home`, of `inverse`."""
    active: np.ndarray
    """(q,), 1 once a landmark has been seen, else 0."""


def moved(pose: ca.SX, error: ca.SX) -> ca.SX:
    """Return the pose that is off by a right-invariant error: turned about home, then shifted."""
    c, s = ca.cos(error[2]), ca.sin(error[2])
    x = c * pose[0] - s * pose[1] + error[0]
    return ca.vertcat(x, s * pose[0] + c * pose[1] + error[1], pose[2] + error[2])


def error_between(true: ca.SX, pose: ca.SX) -> ca.SX:
    """Return the error by which `moved` takes a pose to the true one."""
    turn = true[2] - pose[2]
    c, s = ca.cos(turn), ca.sin(turn)
    x = true[0] - c * pose[0] + s * pose[1]
    return ca.vertcat(x, true[1] - s * pose[0] - c * pose[1], turn)


@lru_cache(maxsize=1)
def motion_function() -> ca.Function:
    """Return pose, control, dt -> pose after it, and its error's Jacobian by the input (3, 2)."""
    pose, control, dt = ca.SX.sym("pose", POSE), ca.SX.sym("control", INPUTS), ca.SX.sym("dt")
    off = ca.SX.sym("off", INPUTS)
    after = discretise(unicycle_rates, pose, control, dt).state
    error = error_between(discretise(unicycle_rates, pose, control + off, dt).state, after)
    by_input = ca.substitute(ca.jacobian(error, off), off, ca.SX.zeros(INPUTS))
    return ca.Function("motion", [pose, control, dt], [after, ca.densify(by_input)])


@lru_cache(maxsize=8)
def sight_function(q: int) -> ca.Function:
    """Return pose (3,), home, inverse (1, q) -> bearings (1, q), by error of pose, home, inverse.

    The derivatives have the shape (5, q).
    """
    pose, own = ca.SX.sym("pose", POSE), ca.SX.sym("own", 2)
    error = ca.SX.sym("error", POSE)
    off = moved(pose, error)
    seen = home_anchored_bearing(Pose(off[0], off[1], off[2]), own[0], own[1])
    slope = ca.jacobian(seen, ca.vertcat(error, own)).T
    both = [ca.substitute(f, error, ca.SX.zeros(POSE)) for f in (seen, slope)]
    one = ca.Function("one", [pose, own[0], own[1]], [both[0], ca.densify(both[1])])
    return one.map("sight", "serial", q, [0], [])


class InvariantFilter:
    """The right-invariant EKF on SE(2), as a `homeward.lab.filters.carrier.FilterBackend`.

    The error of the pose is that motion of the whole plane that takes the estimate to the truth.
    Odometry moves both alike, so that the error stays what it was, exactly and wherever the robot
    is: the prediction's Jacobian is the identity. Landmarks stand at their home bearing and at an
    inverse distance from home, which may be zero, so that one is known from its first sighting on
    and nothing is singular at home; these two have ordinary errors.

    References
    ----------
    Barrau, Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv:1510.06263, 2015.
    Inverse distances: Civera, Davison, Montiel, "Inverse Depth Parametrization for Monocular
    SLAM", IEEE Trans. Robotics 24(5), 2008.
    """

    engine: Engine = "interpreter"
    notes: tuple[str, ...] = ()
    diverged = 0

    def __init__(self, prior: CartesianPrior, noise: SensorNoise, minimum_visible: int = 1) -> None:
        self.prior, self.noise, self.minimum_visible = prior, noise, minimum_visible
        self.stored = prior.home

    def start(self) -> CartesianBelief:
        """Return the belief of the prior."""
        prior, q = self.prior, self.stored.size
        turning = np.eye(POSE)  # of the error by the pose
        turning[:2, 2] = prior.pose.y, -prior.pose.x
        covariance = np.diag(
            np.r_[np.zeros(POSE), prior.home_sigma**2, np.full(q, prior.inverse_sigma**2)]
        )
        covariance[:POSE, :POSE] = turning @ prior.covariance @ turning.T
        inverse = np.full(q, prior.inverse_distance)
        return CartesianBelief(np.array(prior.pose), prior.home, inverse, covariance, np.zeros(q))

    def predict(self, belief: CartesianBelief, interval: float, twist: Held) -> CartesianBelief:
        """Return the belief `interval` [s] later; only the noise of the input is added."""
        if interval <= 0.0:
            return belief
        density = self.noise.input_density if twist else np.full(INPUTS, LOST_SIGMA**2)
        after, by_input = motion_function()(belief.pose, twist or (0.0, 0.0), interval)
        by_input = np.asarray(by_input)
        covariance = belief.covariance.copy()
        covariance[:POSE, :POSE] += by_input * (density / interval) @ by_input.T
        return replace(belief, pose=np.asarray(after)[:, 0], covariance=covariance)

    def update(
        self, belief: CartesianBelief, seen: Angles, sigmas: Angles
    ) -> tuple[CartesianBelief, Outputs]:
        """Return the belief after one stamp, and what the step said of each landmark."""
        out = nothing_said(self.stored.size)
        if len(seen) < max(self.minimum_visible, 1):
            return belief, out
        rows = np.array(list(seen))
        measured = np.array(list(seen.values()))
        own = np.array([sigmas.get(i, self.noise.bearing_sigma) for i in seen])
        innovation, H = self._look(belief, rows, measured)
        S = H @ belief.covariance @ H.T + np.diag(own**2)
        inside = innovation**2 <= self.noise.gate * np.diag(S)
        out["innovation"][rows], out["innovation_variance"][rows] = innovation, np.diag(S)
        out["accepted"][rows] = inside
        if inside.any():
            belief = self._correct(belief, rows[inside], measured[inside], own[inside])
        return replace(belief, active=np.maximum(belief.active, out["accepted"])), out

    def _correct(
        self, belief: CartesianBelief, rows: np.ndarray, measured: np.ndarray, own: np.ndarray
    ) -> CartesianBelief:
        """Return the most probable belief, by Gauss-Newton: a first sight is far from linear."""
        P, error = belief.covariance, np.zeros(len(belief.covariance))
        for _ in range(ITERATIONS):
            innovation, H = self._look(self._moved(belief, error), rows, measured)
            S = H @ P @ H.T + np.diag(own**2)
            gain = np.linalg.solve(S, H @ P).T
            before, error = error, gain @ (innovation + H @ error)
            if np.abs(error - before).max() < SMALL:
                break
        covariance = P - gain @ S @ gain.T
        return replace(self._moved(belief, error), covariance=(covariance + covariance.T) / 2)

    def pose(self, belief: CartesianBelief) -> tuple[Pose, np.ndarray]:
        """Return the pose and its covariance (3, 3)."""
        x, y, heading = belief.pose.tolist()
        turning = np.eye(POSE)  # of the pose by the error
        turning[:2, 2] = -y, x
        covariance = turning @ belief.covariance[:POSE, :POSE] @ turning.T
        return Pose(x, y, float(wrap(heading))), covariance

    def landmarks(self, belief: CartesianBelief) -> LandmarkBelief:
        """Return what is known of the landmarks; one may lie beyond infinity, at less than zero."""
        q = self.stored.size
        sigma = np.sqrt(np.diag(belief.covariance)[POSE + q :])
        with np.errstate(divide="ignore"):
            return LandmarkBelief(wrap(belief.home), 1 / belief.inverse, sigma / belief.inverse**2)

    def _look(
        self, belief: CartesianBelief, rows: np.ndarray, measured: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the innovations of some landmarks, and the bearings' Jacobian by the error."""
        q = self.stored.size
        sight = sight_function(q)
        bearings, slopes = sight(belief.pose, belief.home[None], belief.inverse[None])
        own = np.asarray(slopes)[:, rows]
        H = np.zeros((rows.size, POSE + 2 * q))
        H[:, :POSE] = own[:POSE].T
        H[np.arange(rows.size), POSE + rows] = own[POSE]
        H[np.arange(rows.size), POSE + q + rows] = own[POSE + 1]
        return np.asarray(wrap(measured - np.asarray(bearings)[0, rows])), H

    def _moved(self, belief: CartesianBelief, error: np.ndarray) -> CartesianBelief:
        """Return the belief moved by an error; see `moved`."""
        q, (x, y, heading) = self.stored.size, belief.pose
        c, s = np.cos(error[2]), np.sin(error[2])
        turned = np.array([c * x - s * y, s * x + c * y, heading])
        return replace(
            belief,
            pose=turned + error[:POSE],
            home=belief.home + error[POSE : POSE + q],
            inverse=belief.inverse + error[POSE + q :],
        )
