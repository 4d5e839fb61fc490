"""Association of rows with columns, bearings with landmarks, by their joint covariance.

Errors of the odometry are common to all pairs. Each pair is therefore a hypothesis: given that
pair, the others are predicted, and the cheapest assignment is found. The best hypothesis is
accepted pair by pair, each time given those before (joint compatibility; Neira and Tardos, 2001),
as long as all assignments without the pair are worse by a margin. No column at all is an
alternative, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from homeward.localizer.tunables import ASSOCIATION_GATE, CLEAR_MARGIN


class PossiblePairs(NamedTuple):
    """Possible pairs of m rows and n columns, q of them, of which residuals have d components."""

    rows: np.ndarray
    """(q,), int"""
    columns: np.ndarray
    """(q,), int"""
    residuals: np.ndarray
    """(q, d)"""
    covariance: np.ndarray
    """(q, d, q, d): of the residuals."""
    penalty: np.ndarray
    """(q,): twice the negative log probability of the pair without its residual."""


class Association(NamedTuple):
    """Columns of m rows."""

    column: np.ndarray
    """(m,), int: -1 for none."""
    is_sure: np.ndarray
    """(m,), bool: whether the column, or none, is better than all others by the margin."""
    likely: np.ndarray
    """(m,), int: the columns of the best assignment, sure or not."""


def associate(
    pairs: PossiblePairs, shape: tuple[int, int], none: float, margin: float
) -> Association:
    """Associate rows with columns, (m, n) in number, one to one.

    `none` is the cost of a row without a column: twice the negative log density of other rows, less
    that of a Gaussian without its constant. `margin` is twice a log likelihood ratio.
    """
    m, n = shape
    column, is_sure, margins = np.full(m, -1), np.zeros(m, bool), np.full(m, np.inf)
    likely = column.copy()
    while pairs.rows.size and not is_sure.all():
        near = pairs_cost(pairs.residuals, _own(pairs), pairs.penalty) < none + margin
        if not near.any():
            margins[~is_sure], likely = np.inf, column
            break
        best, found = _best(chosen(pairs, near), (m, n), none)
        margins, likely = np.where(is_sure, np.inf, found), np.where(is_sure, column, best)
        good = np.flatnonzero((margins > margin) & (best >= 0) & ~is_sure)
        if not good.size:
            break
        clear = good[margins[good] > CLEAR_MARGIN]
        for row in clear if clear.size else good[[margins[good].argmax()]]:
            column[row], is_sure[row] = best[row], True
            pairs = _given(pairs, int(row), int(best[row]))
    return Association(column, is_sure | (margins > margin), np.where(is_sure, column, likely))


def pairs_cost(residuals: np.ndarray, covariance: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    """Return twice the negative log likelihoods (..., q), infinite outside the gate.

    Residuals have the shape (..., q, d), their covariances (..., q, d, d), with d of 1 or 2.
    """
    inverse, determinant = _inverse(covariance)
    square = np.einsum("...i,...ij,...j->...", residuals, inverse, residuals)
    return np.asarray(
        np.where(square < ASSOCIATION_GATE**2, square + np.log(determinant) + penalty, np.inf)
    )


def _best(
    pairs: PossiblePairs, shape: tuple[int, int], none: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns (m,) of the best assignment, -1 for none, and the margins (m,)."""
    own = _own(pairs)
    cost = pairs_cost(pairs.residuals, own, pairs.penalty)
    across = pairs.covariance.transpose(2, 0, 1, 3)  # (k, q, d, d): of pair k with the others
    gain = across @ _inverse(own)[0][:, None]
    given = pairs.residuals - (gain @ pairs.residuals[:, None, :, None])[..., 0]
    covariance = own - gain @ across.swapaxes(2, 3)
    d = np.arange(own.shape[-1])
    covariance[..., d, d] = np.maximum(covariance[..., d, d], 1e-3 * own[:, d, d])
    costs = pairs_cost(given, covariance, pairs.penalty)
    same = pairs.rows[:, None] == pairs.rows
    costs[same | (pairs.columns[:, None] == pairs.columns)] = np.inf
    k = np.arange(cost.size)
    costs[k, k] = cost
    table = np.full((cost.size, *shape), np.inf)
    table[:, pairs.rows, pairs.columns] = costs
    table[k, pairs.rows] = np.inf
    table[k, pairs.rows, pairs.columns] = cost
    lowest = table.min(axis=2)
    chosen = np.where(lowest < none, table.argmin(axis=2), -1)
    chosen[k, pairs.rows] = pairs.columns
    lowest = np.minimum(lowest, none)
    lowest[k, pairs.rows] = cost
    total = lowest.sum(axis=1)
    best, margins, least = assigned(table[int(total.argmin())], none)
    rival = np.where(chosen != best, total[:, None], np.inf).min(axis=0)
    return best, np.minimum(margins, np.maximum(rival - least, 0.0))


def assigned(cost: np.ndarray, none: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the cheapest assignment of m rows to n columns or none, its margins and its cost.

    The margin of a row is the additional cost of the best assignment with another column for it.
    """
    m, n = cost.shape
    own_none = np.where(np.eye(m, dtype=bool), none, np.inf)
    whole = np.concatenate([cost, own_none], axis=1)
    best = whole.argmin(axis=1)
    if np.unique(best).size < m:
        best = linear_sum_assignment(whole)[1]
    paid = whole[np.arange(m), best]
    is_free = np.ones(n + m, bool)
    is_free[best] = False
    leave = whole[:, is_free].min(axis=1) - paid
    replace = whole[:, best] - paid[:, None]  # a row takes the column of another one, which ...
    for k in range(m):  # ... takes that of a third (Floyd and Warshall)
        replace = np.minimum(replace, replace[:, k, None] + replace[k])
    leaving = np.minimum(leave, (replace + leave).min(axis=1))
    others = np.where(np.eye(m, dtype=bool), np.inf, replace)
    cycle = (others + others.T).min(axis=1)
    margins = np.minimum(cycle, leaving + np.minimum(others.min(axis=0), 0.0))
    return np.where(best < n, best, -1), margins, float(paid.sum())


def chosen(pairs: PossiblePairs, use: np.ndarray) -> PossiblePairs:
    """Return some of the pairs."""
    rows, columns, residuals, covariance, penalty = pairs
    return PossiblePairs(
        rows[use], columns[use], residuals[use], covariance[use][:, :, use], penalty[use]
    )


def _given(pairs: PossiblePairs, row: int, column: int) -> PossiblePairs:
    """Return the other pairs given one that is accepted."""
    p = int(np.flatnonzero((pairs.rows == row) & (pairs.columns == column))[0])
    across = pairs.covariance[:, :, p]
    gain = across @ _inverse(pairs.covariance[p, :, p])[0]
    rest = pairs._replace(
        residuals=pairs.residuals - gain @ pairs.residuals[p],
        covariance=pairs.covariance - np.einsum("qij,rkj->qirk", gain, across),
    )
    return chosen(rest, (pairs.rows != row) & (pairs.columns != column))


def _own(pairs: PossiblePairs) -> np.ndarray:
    """Return the covariance of each residual, (q, d, d)."""
    q = np.arange(pairs.rows.size)
    return pairs.covariance[q, :, q]


def _inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return inverses (..., d, d) and determinants (...,) of matrices, with d of 1 or 2."""
    if matrix.shape[-1] == 1:
        return 1.0 / matrix, matrix[..., 0, 0]
    (a, b), (c, d) = (matrix[..., 0, 0], matrix[..., 0, 1]), (matrix[..., 1, 0], matrix[..., 1, 1])
    determinant = a * d - b * c
    adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2)
    return adjugate / determinant[..., None, None], determinant
