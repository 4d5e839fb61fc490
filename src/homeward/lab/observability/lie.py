"""Rank of the paper's model from the codistribution of Lie derivatives.

The model has no drift: dX/dt = v g1(X) + omega g2(X). Its outputs are the bearings and optionally
the heading (a compass) and the landmarks' distances from home (a survey). The number of directions
that some v and omega can distinguish near a point is the rank of the gradients of the outputs and
of all their Lie derivatives along g1 and g2 (Hermann and Krener, 1977).

The paper prints part of that matrix, with wrong signs. Its rows for landmark i: the gradient of
beta_i is a unit vector; the gradient of its Lie derivative along v is [J_i, K_i, P_i, 0 .. Q_i ..
0] over (R, theta, alpha, beta), with phi_i = beta_i + alpha, at v = 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from homeward.geometry.frames import Polar, Pose, compose, from_polar, inverse
from homeward.lab.model import INPUTS, POLAR, PolarModel, landmark_distance
from homeward.lab.observability.ranks import Rank, rank
from homeward.lab.observability.scene import Scene, landmark_names

POINTS = 5
"""Number of random points; the largest rank among them counts."""
MAX_LANDMARKS = 40


@dataclass(frozen=True)
class ModelRank:
    """Observability of the model of q landmarks."""

    scene: Scene
    """The best point, as a scene with one pose of the robot, which is its origin."""
    rank: int
    order: int
    """Highest order of Lie derivatives that adds to the rank."""
    singular_values: np.ndarray
    """(n,), scaled, relative to the largest."""
    null: np.ndarray
    """(3 + 2 q, n - rank), unobservable directions, as changes of the scene's unknowns."""

    @property
    def n(self) -> int:
        """Size of the state, q + 3."""
        return len(self.scene.names) + POLAR


def observe_model(landmarks: int, compass: bool = False, distances: bool = False) -> ModelRank:
    """Return the rank of the codistribution of the paper's model, and its null space.

    With `compass` the heading is measured, with `distances` the landmarks' distances from home are.
    """
    points = [model_point(landmarks, seed) for seed in range(POINTS)]
    order, found = 0, _ranks(landmarks, compass, distances, 0, points)
    while found[0].value < landmarks + POLAR:
        further = _ranks(landmarks, compass, distances, order + 1, points)
        if further[0].value == found[0].value:
            break
        order, found = order + 1, further
    best, k = found
    state, stored = points[k]
    to_robot = _robot_chart(landmarks)
    chart, by_state = (np.array(m) for m in to_robot(state, stored))
    scene = Scene(
        names=landmark_names(landmarks),
        home=chart[:POLAR, 0],
        landmarks=chart[POLAR:, 0].reshape(-1, 2),
        poses=np.zeros((1, POLAR)),
        visible=np.ones((1, landmarks), bool),
        stored=np.ones(landmarks, bool),
        compass=compass,
        distances=distances,
        axis="the robot's heading",
    )
    return ModelRank(scene, best.value, order, best.singular_values, by_state @ best.null)


@lru_cache(maxsize=32)
def codistribution(q: int, compass: bool, distances: bool, order: int) -> ca.Function:
    """Return the gradients of the outputs and their Lie derivatives as a function.

    Its inputs are the state (q + 3,) and beta* (q,). Its output has one row per derivative: order 0
    first, and in each order the derivatives along g1 before those along g2.
    """
    model = PolarModel(q, guard=0.0)
    state, stored = ca.SX.sym("X", model.n), ca.SX.sym("s", q)
    fields = [model.rates(state, ca.SX.eye(INPUTS)[:, k], stored, ca.SX.ones(q)) for k in (0, 1)]
    beta = state[model.bearing_slice]
    outputs = [beta]
    if compass:
        outputs.append(state[2])
    if distances:
        outputs.append(landmark_distance(ca.vertsplit(state[:POLAR]), beta, stored))
    level = ca.vertcat(*outputs)
    gradients = [ca.jacobian(level, state)]
    for _ in range(order):
        level = ca.vertcat(*(ca.jtimes(level, state, field) for field in fields))
        gradients.append(ca.jacobian(level, state))
    return ca.Function("codistribution", [state, stored], [ca.densify(ca.vertcat(*gradients))])


def _ranks(
    q: int,
    compass: bool,
    distances: bool,
    order: int,
    points: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[Rank, int]:
    """Return the largest rank and the index of its point; `ArithmeticError` if it is unclear."""
    gradients = codistribution(q, compass, distances, order)
    found = [rank(np.array(gradients(*point))) for point in points]
    k = max(range(len(points)), key=lambda i: (found[i].value, found[i].gap))
    if not found[k].clear:
        raise ArithmeticError(
            f"double precision does not determine the rank for {q} landmarks; use fewer"
        )
    return found[k], k


def model_point(q: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random state (q + 3,) and beta* (q,): a robot among landmarks around home."""
    rng = np.random.default_rng([q, seed])
    angles = 2 * np.pi * (np.arange(q) + rng.uniform(-0.3, 0.3, q)) / q
    away = rng.uniform(1.0, 2.5, q)
    polar = Polar(rng.uniform(0.4, 0.9), *rng.uniform(-np.pi, np.pi, 2))
    here = from_polar(polar)
    seen = compose(inverse(here), Pose(away * np.cos(angles), away * np.sin(angles), 0.0))
    return np.concatenate([polar, np.arctan2(seen.y, seen.x)]), angles


@lru_cache(maxsize=32)
def _robot_chart(q: int) -> ca.Function:
    """Return home's pose and the landmarks in the robot frame, and their derivatives by X."""
    model = PolarModel(q, guard=0.0)
    state, stored = ca.SX.sym("X", model.n), ca.SX.sym("s", q)
    polar = Polar(state[0], state[1], state[2])
    home = inverse(from_polar(polar))
    parts = [home.x, home.y, home.heading]
    for i in range(q):
        away = landmark_distance(polar, state[POLAR + i], stored[i])
        mark = compose(home, Pose(away * ca.cos(stored[i]), away * ca.sin(stored[i]), 0.0))
        parts += [mark.x, mark.y]
    chart = ca.vertcat(*parts)
    return ca.Function("chart", [state, stored], [chart, ca.jacobian(chart, state)])


MAX_ROWS = 6
"""Largest number of landmarks in the table of ranks."""


@dataclass(frozen=True)
class Entry:
    """One term of the printed matrix."""

    name: str
    by: str
    """The variable of the derivative."""
    formula: str
    """The correct term."""
    printed_sign: int
    """-1 where the paper prints the wrong sign."""
    value: float
    """The formula at the point."""
    exact: float
    """The model's own derivative there."""

    @property
    def right(self) -> bool:
        """Whether the printed sign agrees with the model."""
        return bool(np.isclose(self.printed_sign * self.value, self.exact, rtol=1e-9))


POINT = (0.75, -0.872, 0.349, 1.3)
"""R [m], theta, alpha [rad] of the paper's start, and the bearing [rad] of one landmark."""
STORED = 0.9
"""Home bearing of that landmark [rad]."""


def printed_matrix() -> tuple[Entry, ...]:
    """Return the terms of the printed matrix, checked against the derivatives of the model.

    Q_i has two terms; the exact derivative of each is Q_i minus the other.
    """
    R, theta, alpha, beta = POINT
    S, C = np.sin(STORED - beta - alpha), np.cos(STORED - beta - alpha)
    T, TC = np.sin(STORED - theta), np.cos(STORED - theta)
    # Row 1 is the Lie derivative along g1: driving at v = 1.
    J, K, P, Q = np.array(codistribution(1, False, False, 1)(POINT, STORED))[1]
    first, second = -np.cos(beta) * S / (R * T), np.sin(beta) * C / (R * T)
    by_theta = -np.sin(beta) * S * TC / (R * T**2)
    now, home = "(beta*_i - phi_i)", "(beta*_i - theta)"
    entries = (
        ("J_i", "R", f"sin beta_i sin{now} / (R^2 sin{home})", 1, np.sin(beta) * S / (R**2 * T), J),
        ("K_i", "theta", f"-sin beta_i sin{now} cos{home} / (R sin^2{home})", -1, by_theta, K),
        ("P_i", "alpha", f"sin beta_i cos{now} / (R sin{home})", -1, second, P),
        ("Q_i, term 1", "beta_i", f"-cos beta_i sin{now} / (R sin{home})", 1, first, Q - second),
        ("Q_i, term 2", "beta_i", f"sin beta_i cos{now} / (R sin{home})", -1, second, Q - first),
    )
    return tuple(Entry(*entry[:4], float(entry[4]), float(entry[5])) for entry in entries)


def rank_table() -> list[tuple[int, ...]]:
    """Return the rank of the codistribution for q = 1 .. `MAX_ROWS` landmarks.

    A row has q, the size n of the state, and the rank with bearings alone, with a compass, and with
    the landmarks' distances from home.
    """
    known: tuple[dict[str, bool], ...] = ({}, {"compass": True}, {"distances": True})
    return [
        (q, q + POLAR, *(observe_model(q, **k).rank for k in known)) for q in range(1, MAX_ROWS + 1)
    ]
