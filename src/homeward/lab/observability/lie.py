"""Rank of the paper's model: the codistribution of Lie derivatives, in floats or in 60 digits.

The model has no drift: dX/dt = v g1(X) + omega g2(X). Its outputs are the bearings, perhaps the
heading (a compass) and the landmarks' distances from home (a survey). What any choice of v and
omega can distinguish near a point is the rank of the derivatives of the outputs and of all their
Lie derivatives along g1 and g2 (Hermann and Krener, 1977). All of it is made from `PolarModel`.

The paper prints part of that matrix, with wrong signs; rows of the codistribution for landmark i:
the gradient of beta_i is a unit vector, that of its Lie derivative along v is [J_i, K_i, P_i,
0 .. Q_i .. 0] over (R, theta, alpha, beta), with phi_i = beta_i + alpha, at v = 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import mpmath
import numpy as np
from numpy.typing import ArrayLike

from homeward.geometry.frames import Polar, Pose, compose, from_polar, inverse
from homeward.lab.model import INPUTS, POLAR, PolarModel, landmark_distance
from homeward.lab.observability.ranks import Rank, rank

DIGITS = 60
ZERO_DIGITS = 30
"""A pivot below this number of digits counts as zero."""

_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_TWICE: lambda a, _: 2 * a,
    ca.OP_INV: lambda a, _: 1 / a,
    ca.OP_SIN: lambda a, _: mpmath.sin(a),
    ca.OP_COS: lambda a, _: mpmath.cos(a),
    ca.OP_SQRT: lambda a, _: mpmath.sqrt(a),
    ca.OP_ASSIGN: lambda a, _: a,
}


def evaluate(function: ca.Function, arguments: Sequence[ArrayLike]) -> list[list[Any]]:
    """Return the output of a function of SX row by row, computed in numbers of `DIGITS` digits.

    The function has one dense output, made of sums, products, quotients, sines, cosines and roots.
    Its arguments, each (k,), are taken as exact.
    """
    rows, columns = function.size_out(0)
    numbers = [np.asarray(a, float).tolist() for a in arguments]
    work: dict[int, Any] = {}
    out: list[Any] = [mpmath.mpf(0)] * (rows * columns)
    with mpmath.workdps(DIGITS):
        for k in range(function.n_instructions()):
            kind = function.instruction_id(k)
            sources, targets = function.instruction_input(k), function.instruction_output(k)
            if kind == ca.OP_CONST:
                work[targets[0]] = mpmath.mpf(function.instruction_constant(k))
            elif kind == ca.OP_INPUT:
                work[targets[0]] = mpmath.mpf(numbers[sources[0]][sources[1]])
            elif kind == ca.OP_OUTPUT:
                out[targets[1]] = work[sources[0]]
            else:
                first, last = work[sources[0]], work[sources[-1]]
                work[targets[0]] = _OPERATIONS[kind](first, last)
    return [out[row::rows] for row in range(rows)]


def precise_rank(matrix: list[list[Any]]) -> int:
    """Return the rank by elimination with full pivoting; rows must be of similar size."""
    with mpmath.workdps(DIGITS):
        rest = [list(row) for row in matrix]
        limit = mpmath.mpf(10) ** -ZERO_DIGITS * max(abs(v) for row in rest for v in row)
        found = 0
        while rest:
            size, i, j = max(
                (abs(v), i, j) for i, row in enumerate(rest) for j, v in enumerate(row)
            )
            if size <= limit:
                break
            found += 1
            pivot = rest.pop(i)
            for row in rest:
                factor = row[j] / pivot[j]
                row[:] = [a - factor * b for a, b in zip(row, pivot, strict=True)]
        return found


POINTS = 5
"""Number of random points; the rank is that at the best of them."""
MOST_LANDMARKS = 40


@dataclass(frozen=True)
class ModelRank:
    """Observability of the model of q landmarks."""

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
    """Whether floats were not precise enough, and the rank was computed in 60 digits."""
    home: np.ndarray
    """(3,), home as seen from the robot at that point: x [m], y [m], heading [rad]."""
    marks: np.ndarray
    """(q, 2), the landmarks as seen from the robot there [m]."""
    null: np.ndarray
    """(3 + 2 q, n - rank), unobservable directions, as changes of `home` and `marks`."""


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
    model = landmarks, compass, distances, landmarks + POLAR
    seen = chart[:POLAR, 0], chart[POLAR:, 0].reshape(-1, 2), by_state @ best.null
    return ModelRank(*model, best.value, order, best.singular_values, precise, *seen)


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


LARGEST = 6
"""Number of landmarks up to which the table of ranks goes."""


@dataclass(frozen=True)
class Entry:
    """One term of the printed matrix."""

    name: str
    by: str
    """The variable of the derivative."""
    formula: str
    """As it should be."""
    printed_sign: int
    """-1 where the paper prints it with the wrong sign."""
    value: float
    """Of the formula at the point."""
    exact: float
    """Of the model's own derivative there."""

    @property
    def right(self) -> bool:
        """Whether the sign that is printed agrees with the model."""
        return bool(np.isclose(self.printed_sign * self.value, self.exact, rtol=1e-9))


POINT = (0.75, -0.872, 0.349, 1.3)
"""R [m], theta, alpha [rad] of the paper's start, and a bearing [rad] ..."""
STORED = 0.9
"""... of a landmark with this home bearing [rad]."""


def printed_matrix() -> tuple[Entry, ...]:
    """Return the terms of the printed matrix, checked against the derivatives of the model.

    Q_i has two terms; the exact derivative of each is what is left of Q_i without the other.
    """
    R, theta, alpha, beta = POINT
    S, C = np.sin(STORED - beta - alpha), np.cos(STORED - beta - alpha)
    T, TC = np.sin(STORED - theta), np.cos(STORED - theta)
    # Row 1 is the Lie derivative along g1, which is the drive at v = 1.
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


@dataclass(frozen=True)
class RankRow:
    """A row of the table of ranks."""

    landmarks: int
    n: int
    bearings: int
    """Rank with bearings alone ..."""
    compass: int
    """... with a compass as well ..."""
    distances: int
    """... and with the landmarks' distances from home instead."""


def rank_table() -> tuple[RankRow, ...]:
    """Return the rank of the codistribution for q = 1 .. `LARGEST` landmarks."""
    known: tuple[dict[str, bool], ...] = ({}, {"compass": True}, {"distances": True})
    return tuple(
        RankRow(q, q + POLAR, *(observe_model(q, **k).rank for k in known))
        for q in range(1, LARGEST + 1)
    )
