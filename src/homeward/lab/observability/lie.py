"""The paper's question, answered: the codistribution of Lie derivatives, and its rank.

The model has no drift: dX/dt = v g1(X) + omega g2(X). Its outputs are the bearings, perhaps the
heading (a compass) and the landmarks' distances from home (a survey). What any choice of v and
omega can tell apart near a point is the rank of the derivatives of the outputs and of all their
Lie derivatives along g1 and g2 (Hermann and Krener, 1977). All of it is made from `PolarModel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from homeward.geometry.frames import Polar, Pose, compose, from_polar, inverse
from homeward.lab.model import INPUTS, POLAR, PolarModel, landmark_distance
from homeward.lab.observability.precise import evaluate, precise_rank
from homeward.lab.observability.ranks import Rank, rank

POINTS = 5
"""The rank is that at the best of so many random points."""
MOST_LANDMARKS = 40


@dataclass(frozen=True)
class ModelRank:
    """What the model of q landmarks can tell apart."""

    landmarks: int
    compass: bool
    distances: bool
    n: int
    """Size of the state, q + 3."""
    rank: int
    order: int
    """Lie derivatives up to this order were needed; one more adds nothing."""
    singular_values: np.ndarray
    """(n,), scaled, relative to the largest, at the best point."""
    precise: bool
    """Whether floats could not tell, and the rank was found in 60 digits."""
    home: np.ndarray
    """(3,), home as seen from the robot at that point: x [m], y [m], heading [rad]."""
    marks: np.ndarray
    """(q, 2), the landmarks as seen from the robot there [m]."""
    null: np.ndarray
    """(3 + 2 q, n - rank), what cannot be told, as changes of `home` and `marks`."""


def observe_model(landmarks: int, compass: bool = False, distances: bool = False) -> ModelRank:
    """Return the rank of the codistribution of the paper's model, and its null space.

    A compass measures the heading, too; `distances` are those of the landmarks from home, known.
    """
    points = [model_point(landmarks, seed) for seed in range(POINTS)]
    order, found = 0, _ranks(landmarks, compass, distances, 0, points)
    while found[0].value < landmarks + POLAR:
        further = _ranks(landmarks, compass, distances, order + 1, points)
        if further[0].value == found[0].value:
            break
        order, found = order + 1, further
    best, precise, k = found
    state, stored = points[k]
    to_robot = _robot_chart(landmarks)
    chart, by_state = (np.array(m) for m in to_robot(state, stored))
    return ModelRank(
        landmarks=landmarks,
        compass=compass,
        distances=distances,
        n=landmarks + POLAR,
        rank=best.value,
        order=order,
        singular_values=best.singular_values,
        precise=precise,
        home=chart[:POLAR, 0],
        marks=chart[POLAR:, 0].reshape(-1, 2),
        null=by_state @ best.null,
    )


@lru_cache(maxsize=32)
def codistribution(q: int, compass: bool, distances: bool, order: int) -> ca.Function:
    """Return the gradients of the outputs and their Lie derivatives as a function.

    Its inputs are the state (q + 3,) and beta* (q,); its output has a row per derivative, those of
    order 0 first, each order with all along g1 before all along g2.
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
) -> tuple[Rank, bool, int]:
    """Return the greatest rank over the points, whether digits were needed, and at which point."""
    gradients = codistribution(q, compass, distances, order)
    found = [rank(np.array(gradients(*point))) for point in points]
    k = max(range(len(points)), key=lambda i: (found[i].value, found[i].gap))
    if found[k].clear:
        return found[k], False, k
    return _settle(found[k], precise_rank(evaluate(gradients, points[k]))), True, k


def _settle(floats: Rank, value: int) -> Rank:
    """Return a rank with its null space cut to what is known of its size."""
    size = floats.singular_values.size
    if value >= floats.value:
        return Rank(value, floats.singular_values, floats.null[:, value - floats.value :])
    raise ArithmeticError(f"rank {floats.value} of {size} in floats but {value} in all digits")


def model_point(q: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random state (q + 3,) and beta* (q,): a robot among landmarks all round home."""
    rng = np.random.default_rng([q, seed])
    angles = 2 * np.pi * (np.arange(q) + rng.uniform(-0.3, 0.3, q)) / q
    away = rng.uniform(1.0, 2.5, q)
    polar = Polar(rng.uniform(0.4, 0.9), *rng.uniform(-np.pi, np.pi, 2))
    here = from_polar(polar)
    seen = compose(inverse(here), Pose(away * np.cos(angles), away * np.sin(angles), 0.0))
    return np.concatenate([polar, np.arctan2(seen.y, seen.x)]), angles


@lru_cache(maxsize=32)
def _robot_chart(q: int) -> ca.Function:
    """Return (home's pose, the landmarks) as seen from the robot, and their derivatives by X."""
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
