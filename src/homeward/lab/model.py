"""Symbolic model of the unicycle and its bearings, shared by all filters and bounds.

The state is the paper's, X = [R, theta, alpha, beta_1 .. beta_q], the input U = [v, omega]. The
stored home bearings beta*_i eliminate the distances of the landmarks. An augmented state ends with
some of the beta*_i, as constants to be estimated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import casadi as ca

from homeward.geometry.angles import apply, clipped_inverse, guarded_inverse, wrap
from homeward.geometry.frames import Integration, Pose, bearing

POLAR = 3
"""Number of states before the bearings: R, theta, alpha."""
INPUTS = 2
"""Number of inputs: v, omega."""
Inverse = Literal["smooth", "clipped"]
"""Form of 1/x near a singularity: x / (x^2 + guard^2), or with the size of x at least the guard."""


def landmark_distance(polar: Any, beta: Any, stored: Any, guard: float = 0.0) -> Any:
    """Return D*_i, a landmark's distance from home [m], from two bearings and the pose.

    `polar` is the robot's R [m], theta, alpha [rad]; `beta` and `stored` are the bearings from the
    robot and from home [rad]; for `guard` see `homeward.geometry.angles.guarded_inverse`.
    """
    R, theta, alpha = polar
    phi = beta + alpha
    return R * apply("sin", theta - phi) * guarded_inverse(apply("sin", stored - phi), guard)


def home_anchored_bearing(pose: Pose, home: Any, inverse: Any) -> Any:
    """Return the bearing [rad] of a landmark on its home ray; it is not singular at home.

    `home` is its home bearing beta* [rad], `inverse` its inverse distance from home [1/m], zero at
    infinity.
    """
    x = apply("cos", home) - inverse * pose.x
    y = apply("sin", home) - inverse * pose.y
    return wrap(apply("arctan2", y, x) - pose.heading)


@dataclass(frozen=True)
class PolarModel:
    """The paper's model of q landmarks, with any of their home bearings as states.

    It is singular where R = 0 and where landmark, home and robot are in line. `guard` keeps it
    finite there: 1/R and 1/(R sin(beta* - theta)), both 1/x, become x / (x^2 + guard^2). Bearing
    rates are then too small by the fraction guard^2 / (x^2 + guard^2): 4 % at x = 5 cm with a guard
    of 1 cm. The `inverse` "clipped" is exact beyond the guard, and constant within it.
    """

    q: int
    """Number of landmarks."""
    estimated: tuple[int, ...] = ()
    """Indices of the home bearings that are states."""
    guard: float = 0.01
    """[m]"""
    inverse: Inverse = "smooth"

    @property
    def n(self) -> int:
        """Size of the state."""
        return POLAR + self.q + len(self.estimated)

    @property
    def bearing_slice(self) -> slice:
        """Position of the bearings in the state."""
        return slice(POLAR, POLAR + self.q)

    def home_bearings(self, state: ca.SX, stored: ca.SX) -> ca.SX:
        """Return all beta* (q,): from `state` where they are estimated, otherwise from `stored`."""
        known = [stored[i] for i in range(self.q)]
        for k, i in enumerate(self.estimated):
            known[i] = state[POLAR + self.q + k]
        return ca.vertcat(*known)

    def rates(self, state: ca.SX, control: ca.SX, stored: ca.SX, active: ca.SX) -> ca.SX:
        """Return dX/dt, shape (n,), with bearings in [rad] and R in [m].

        The control is v [m/s], omega [rad/s]; `stored` (q,) are the beta* of home [rad]; `active`
        (q,) is 1 where a landmark has been seen. The bearings of the others are constant.
        """
        R, theta, alpha = state[0], state[1], state[2]
        v, omega = control[0], control[1]
        beta = state[self.bearing_slice]
        home = self.home_bearings(state, stored)
        phi = beta + alpha
        inverse = guarded_inverse if self.inverse == "smooth" else clipped_inverse
        inverse_distance = ca.sin(home - phi) * inverse(R * ca.sin(home - theta), self.guard)
        return ca.vertcat(
            v * ca.cos(alpha - theta),
            v * ca.sin(alpha - theta) * inverse(R, self.guard),
            omega,
            -(active * v) * (ca.sin(beta) * inverse_distance) - active * omega,
            ca.SX.zeros(len(self.estimated)),
        )


class Step(NamedTuple):
    """A discrete step of a model and its exact Jacobians."""

    state: ca.SX
    """F(X, U), shape (n,)."""
    by_state: ca.SX
    """G = dF/dX, shape (n, n)."""
    by_input: ca.SX
    """Gu = dF/dU, shape (n, m)."""


_STAGES: dict[str, tuple[float, tuple[tuple[float, float], ...]]] = {
    # The weight of the sum, and for each stage its fraction of dt and its weight in the sum.
    "euler": (1.0, ((1.0, 1.0),)),
    "rk4": (1 / 3, ((0.5, 1.0), (0.5, 2.0), (1.0, 1.0), (0.5, 1.0))),
}


def discretise(
    rates: Callable[[ca.SX, ca.SX], ca.SX],
    state: ca.SX,
    control: ca.SX,
    dt: ca.SX,
    method: Integration = "rk4",
) -> Step:
    """Integrate rates dX/dt over `dt` [s] at constant input, and differentiate stage by stage.

    The rates are a function of state (n,) and input (m,). Chaining the Jacobians of the stages
    costs a fifth less than differentiating the whole step.
    """
    x = ca.SX.sym("x", state.shape[0])
    u = ca.SX.sym("u", control.shape[0])
    f = rates(x, u)
    own = [v[i] for v in (x, u) for i in range(v.shape[0])]
    free = [s for s in ca.symvar(f) if not any(ca.is_equal(s, mine) for mine in own)]
    stage = ca.Function("stage", [x, u, *free], [f, _by_rows(f, x), _by_rows(f, u)])

    n, m = x.shape[0], u.shape[0]
    piece, piece_x, piece_u = ca.SX(n, 1), ca.SX(n, n), ca.SX(n, m)
    whole, whole_x, whole_u = ca.SX(n, 1), ca.SX(n, n), ca.SX(n, m)
    share, stages = _STAGES[method]
    for reach, times in stages:
        h = reach * dt
        slope, by_x, by_u = stage(state + piece, control, *free)
        piece, piece_u = h * slope, h * (by_x @ piece_u + by_u)
        piece_x = h * (by_x @ piece_x + by_x)
        whole, whole_x, whole_u = (
            whole + times * piece,
            whole_x + times * piece_x,
            whole_u + times * piece_u,
        )
    return Step(state + share * whole, ca.SX.eye(n) + share * whole_x, share * whole_u)


def _by_rows(f: ca.SX, x: ca.SX) -> ca.SX:
    """Return df/dx by reverse differentiation of each row, which shares terms between entries."""
    return ca.sparsify(ca.vertcat(*(ca.gradient(f[i], x).T for i in range(f.shape[0]))))


def unicycle_rates(pose: ca.SX, control: ca.SX) -> ca.SX:
    """Return d(x, y, heading)/dt of the unicycle for v [m/s] and omega [rad/s]; never singular."""
    return ca.vertcat(control[0] * ca.cos(pose[2]), control[0] * ca.sin(pose[2]), control[1])


def true_bearings(pose: ca.SX, landmarks: ca.SX) -> ca.SX:
    """Return the bearings [rad], shape (q,), of landmarks (q, 2) [m] seen from a pose (3,)."""
    here = Pose(pose[0], pose[1], pose[2])
    seen: ca.SX = bearing(here, landmarks[:, 0], landmarks[:, 1])
    return seen
