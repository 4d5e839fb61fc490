"""The matrix that the paper prints, its entries by hand and by the model, and their signs.

Rows of the codistribution for landmark i: the gradient of beta_i is a unit vector, that of its Lie
derivative along v is [J_i, K_i, P_i, 0 .. Q_i .. 0] over (R, theta, alpha, beta). With phi_i =
beta_i + alpha, and at v = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.lab.model import POLAR
from homeward.lab.observability.lie import codistribution, observe_model

LARGEST = 6
"""The table of ranks goes up to so many landmarks."""


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
    now, home = "(beta*_i - phi_i)", "(beta*_i - theta)"
    entries = (
        ("J_i", "R", f"sin beta_i sin{now} / (R^2 sin{home})", 1, np.sin(beta) * S / (R**2 * T), J),
        (
            "K_i",
            "theta",
            f"-sin beta_i sin{now} cos{home} / (R sin^2{home})",
            -1,
            -np.sin(beta) * S * TC / (R * T**2),
            K,
        ),
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
    return tuple(
        RankRow(
            q,
            q + POLAR,
            observe_model(q).rank,
            observe_model(q, compass=True).rank,
            observe_model(q, distances=True).rank,
        )
        for q in range(1, LARGEST + 1)
    )
