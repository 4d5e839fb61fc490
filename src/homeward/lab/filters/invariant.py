"""The invariant EKF in Cartesian form: its error does not depend on the state, and has no pole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from homeward.geometry import se2
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose, from_polar, inverse, polar_covariance_to_pose
from homeward.lab.filters.backend import (
    LOST_SIGMA,
    Angles,
    CartesianFilter,
    LandmarkBelief,
    MaybeTwist,
    Outputs,
    empty_outputs,
)
from homeward.lab.model import INPUTS, discretise, home_anchored_bearing, unicycle_rates

POSE = 3
"""Number of error entries before the landmarks: x, y, heading."""
MAX_ITERATIONS = 5
"""Largest number of iterations of an update."""
TOLERANCE = 1e-4
"""An update has converged when no entry (m, rad, 1/m) changes by more."""


@dataclass(frozen=True)
class CartesianBelief:
    """Pose, and home bearing and inverse distance from home of each landmark."""

    pose: np.ndarray
    """(3,), x [m], y [m], heading [rad]."""
    home: np.ndarray
    """(q,) [rad]"""
    inverse: np.ndarray
    """(q,) [1/m]"""
    covariance: np.ndarray
    """(3 + 2 q, 3 + 2 q), of the errors of the pose, of `home` and of `inverse`."""
    active: np.ndarray
    """(q,), 1 once a landmark has been seen, otherwise 0."""


def moved(pose: ca.SX, error: ca.SX) -> ca.SX:
    """Return the pose after a right-invariant error: a rotation about home, then a translation."""
    after: ca.SX = ca.vertcat(*compose(Pose(*ca.vertsplit(error)), Pose(*ca.vertsplit(pose))))
    return after


def error_between(true: ca.SX, pose: ca.SX) -> ca.SX:
    """Return the error with which `moved` maps a pose to the true one."""
    back = inverse(Pose(*ca.vertsplit(pose)))
    error: ca.SX = ca.vertcat(*compose(Pose(*ca.vertsplit(true)), back))
    return error


@lru_cache(maxsize=1)
def motion_function() -> ca.Function:
    """Return pose, control, dt -> next pose, and the Jacobian of its error by the input (3, 2)."""
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


class InvariantFilter(CartesianFilter):
    """The right-invariant EKF on SE(2), as a `homeward.lab.filters.backend.FilterBackend`.

    The error of the pose is the motion of the whole plane that maps the estimate to the true pose.
    Odometry moves both by the same motion, so the error stays constant, exactly and at any pose:
    the Jacobian of a prediction is the identity. A landmark has a home bearing and an inverse
    distance from home, with ordinary errors. The inverse distance may be zero, so a landmark can be
    used from its first sighting on, and nothing is singular at home.

    References
    ----------
    Barrau, Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv:1510.06263, 2015.
    Inverse distances: Civera, Davison, Montiel, "Inverse Depth Parametrization for Monocular
    SLAM", IEEE Trans. Robotics 24(5), 2008.
    """

    def start(self) -> CartesianBelief:
        """Return the belief of the prior."""
        prior, q, pose = self.setup, self.stored.size, from_polar(self.setup.polar)
        (expected, sigma), square = self.inverse, np.diag(prior.sigmas**2)
        spread = polar_covariance_to_pose(prior.polar, square)
        by_pose = se2.lever(np.negative(pose))  # derivative of the error
        covariance = np.diag(np.r_[np.zeros(POSE), self.home_sigma**2, np.full(q, sigma**2)])
        covariance[:POSE, :POSE] = by_pose @ spread @ by_pose.T
        inverse = np.full(q, expected)
        return CartesianBelief(np.array(pose), self.stored, inverse, covariance, np.zeros(q))

    def predict(
        self, belief: CartesianBelief, interval: float, twist: MaybeTwist
    ) -> CartesianBelief:
        """Return the belief `interval` [s] later, with the noise of the input added."""
        if interval <= 0.0:
            return belief
        density = self.setup.input_density if twist else np.full(INPUTS, LOST_SIGMA**2)
        after, by_input = motion_function()(belief.pose, twist or (0.0, 0.0), interval)
        by_input = np.asarray(by_input)
        covariance = belief.covariance.copy()
        covariance[:POSE, :POSE] += by_input * (density / interval) @ by_input.T
        return replace(belief, pose=np.asarray(after)[:, 0], covariance=covariance)

    def update(
        self, belief: CartesianBelief, seen: Angles, sigmas: Angles
    ) -> tuple[CartesianBelief, Outputs]:
        """Return the belief after one stamp, and the outputs of the update."""
        out = empty_outputs(self.stored.size)
        if len(seen) < max(self.minimum_visible, 1):
            return belief, out
        rows, measured, own = self.sighted(seen, sigmas)
        innovation, H = self._innovations(belief, rows, measured)
        S = H @ belief.covariance @ H.T + np.diag(own**2)
        inside = innovation**2 <= self.setup.gate * np.diag(S)
        out["innovation"][rows], out["innovation_variance"][rows] = innovation, np.diag(S)
        out["accepted"][rows] = inside
        if inside.any():
            belief = self._correct(belief, rows[inside], measured[inside], own[inside])
        return replace(belief, active=np.maximum(belief.active, out["accepted"])), out

    def _correct(
        self, belief: CartesianBelief, rows: np.ndarray, measured: np.ndarray, own: np.ndarray
    ) -> CartesianBelief:
        """Return the most probable belief by Gauss-Newton: first sightings are far from linear."""
        P, error = belief.covariance, np.zeros(len(belief.covariance))
        for _ in range(MAX_ITERATIONS):
            innovation, H = self._innovations(self._moved(belief, error), rows, measured)
            S = H @ P @ H.T + np.diag(own**2)
            gain = np.linalg.solve(S, H @ P).T
            before, error = error, gain @ (innovation + H @ error)
            if np.abs(error - before).max() < TOLERANCE:
                break
        covariance = P - gain @ S @ gain.T
        return replace(self._moved(belief, error), covariance=(covariance + covariance.T) / 2)

    def pose(self, belief: CartesianBelief) -> tuple[Pose, np.ndarray]:
        """Return the pose and its covariance (3, 3)."""
        x, y, heading = belief.pose.tolist()
        by_error = se2.lever(belief.pose)  # derivative of the pose
        covariance = by_error @ belief.covariance[:POSE, :POSE] @ by_error.T
        return Pose(x, y, float(wrap(heading))), covariance

    def landmarks(self, belief: CartesianBelief) -> LandmarkBelief:
        """Return the estimates of the landmarks; an inverse distance may be negative."""
        q = self.stored.size
        sigma = np.sqrt(np.diag(belief.covariance)[POSE + q :])
        with np.errstate(divide="ignore"):
            return LandmarkBelief(wrap(belief.home), 1 / belief.inverse, sigma / belief.inverse**2)

    def _innovations(
        self, belief: CartesianBelief, rows: np.ndarray, measured: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the innovations of some landmarks, and the Jacobian of bearings by the error."""
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
        q = self.stored.size
        return replace(
            belief,
            pose=se2.compose(error[:POSE], belief.pose),
            home=belief.home + error[POSE : POSE + q],
            inverse=belief.inverse + error[POSE + q :],
        )
