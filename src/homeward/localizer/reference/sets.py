"""Sets of home bearings: linearised, fitted by Gauss-Newton, and weighed by their evidence.

With S = L L^T the covariance of a set's residuals, L^-1 makes them independent with unit variance.
Everything that depends on them or is correlated with them is whitened once in the same way. Least
squares needs products of these columns only: the information on home, the gain of the newest pose,
and predictions of the other home bearings.

The evidence, by Laplace's method, is the integral over all unknowns, home included, so that sets of
different size can be compared.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dtrtrs

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import compose, lever, sight
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.reference.labels import log_inlier, log_labels, log_outlier
from homeward.localizer.tunables import FIT_CONVERGED, MAX_HOME_TURN

POSE_AND_YAW = 4
"""Length of the state before the landmarks: newest pose (3) and camera yaw (1)."""
YAW = 3
HOME, RESIDUAL, POSE, REST = slice(0, 3), 3, slice(4, 7), slice(7, None)
"""Columns: Jacobian by home, residual, covariance with the newest pose, and with each other."""
IDENTITY = np.eye(3)


class Sighter(Protocol):
    """What predicts home bearings: the camera's pose on the robot at home."""

    @property
    def mount(self) -> np.ndarray:
        """(3,): pose of the camera on the robot, at home."""

    @property
    def same_camera(self) -> bool:
        """Whether the drive's camera was used at home, with the same unknown yaw."""


class HomeArrays(NamedTuple):
    """Arrays of a resection problem of home, in the order of the compiled core.

    They are those of `HomeProblem`, of q home bearings.
    """

    mean: np.ndarray
    covariance: np.ndarray
    bearings: np.ndarray
    sigmas: np.ndarray
    mount: np.ndarray
    offsets: np.ndarray | None
    prior: np.ndarray | None
    information: np.ndarray
    """(3, 3): information on home before its bearings."""
    walk_excess: np.ndarray
    members: np.ndarray
    """(b, q), bool: members of each body among the landmarks, and ..."""
    one_body: np.ndarray
    """(b,): ... the prior probability that they move as one."""
    same_camera: bool
    moved_prior: float
    max_step: float
    """Longest step of home in a fit [m]."""

    def prior_offset(self, home: np.ndarray) -> np.ndarray:
        """Return the offset of the start prior from a home (3,); zeros without a prior."""
        offset = np.zeros(3) if self.prior is None else self.prior - home
        offset[2] = wrap(offset[2])
        return offset


class Linear(NamedTuple):
    """Home bearings, linearised around a home and a map."""

    at: np.ndarray
    """(3,): linearisation point of home."""
    by_place: np.ndarray
    """(q, 2): Jacobian of each expected home bearing by its landmark ..."""
    by_yaw: np.ndarray
    """(q,): ... and by the camera yaw of the state."""
    cross_covariance: np.ndarray
    """(q, 4 + 2 q): their covariance with the state."""
    columns: np.ndarray
    """(q, 7 + q): columns for least squares, a row for each home bearing."""

    @property
    def by_home(self) -> np.ndarray:
        """(q, 3): Jacobian of the expected home bearings by home."""
        return self.columns[:, HOME]

    @property
    def residual(self) -> np.ndarray:
        """(q,): residuals, measured minus expected, at the mean of the map [rad]."""
        return self.columns[:, RESIDUAL]

    @property
    def residual_covariance(self) -> np.ndarray:
        """(q, q): covariance of the residuals given home."""
        return self.columns[:, REST]


class HomeSolution(NamedTuple):
    """Least-squares solution for one set of inliers, around a linearisation."""

    step: np.ndarray
    """(3,): step of home from the linearisation point."""
    information: np.ndarray
    """(3, 3): information on home ..."""
    inverse: np.ndarray
    """(3, 3): ... and its inverse."""
    weighted: np.ndarray
    """(q, 4): Jacobian by home and residual, times the inverse of the covariance of the set's
    residuals; zeros outside the set."""
    alone: np.ndarray
    """(q, 5): each home bearing given the others of the set and a home: Jacobian by home, residual,
    and its variance."""
    pose: np.ndarray
    """(3,): posterior of the newest pose, ..."""
    pose_by_home: np.ndarray
    """(3, 3): ... minus its Jacobian by home, ..."""
    pose_covariance: np.ndarray
    """(3, 3): ... and its covariance given home."""
    walk_information: np.ndarray
    """(3, 3): covariance of the gradient by home because landmarks may walk."""
    log_density: float
    """Log density of the set's home bearings, for a uniform prior of home."""


class Evidence(NamedTuple):
    """Evidence of a set of inliers, and for and against each home bearing."""

    innovation: np.ndarray
    """(q,): innovations, stored minus predicted by everything else [rad] ..."""
    variance: np.ndarray
    """(q,): ... and their variances."""
    odds: np.ndarray
    """(q,): log odds of each to be an inlier, given the rest of the set."""
    log_evidence: float
    """Log evidence for a uniform prior of home, up to a constant common to all sets."""


def expected(
    sighter: Sighter,
    home: np.ndarray,
    places: np.ndarray,
    camera_yaw: float,
    offsets: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | float]:
    """Return the bearings (k,) of places (k, 2) from `home` (3,), and their Jacobians.

    The latter are by the place, (k, 2), by home, (k, 3), and by the camera's yaw; `camera_yaw`
    [rad] is its correction, if home's camera is the same, and `offsets` (k, 3) are as in
    `HomeProblem`.
    """
    eye = compose(home, sighter.mount)
    if sighter.same_camera:
        eye[2] += camera_yaw
    eyes = eye if offsets is None else compose(eye[None], offsets)
    bearing, by_place, _ = sight(eyes, places)
    by_eye = np.full((len(places), 3), -1.0)
    np.negative(by_place, out=by_eye[:, :2])
    if offsets is None:
        return bearing, by_place, by_eye @ lever(eye - home), -1.0
    by_first = (by_eye[:, None] @ lever(eyes - eye))[:, 0]
    return bearing, by_place, by_first @ lever(eye - home), by_first[:, 2]


def linearised(given: HomeArrays, home: np.ndarray, state: np.ndarray) -> Linear:
    """Linearise the home bearings around `home` (3,) and pose, yaw, landmarks (4 + 2 q,)."""
    places = state[POSE_AND_YAW:].reshape(-1, 2)
    bearing, by_place, by_home, yaw = expected(given, home, places, state[YAW], given.offsets)
    by_yaw = np.zeros(bearing.size)
    if given.same_camera:
        by_yaw[:] = yaw
    residual = wrap(given.bearings - bearing) + _by_map(by_place, by_yaw, state - given.mean)
    return _linear(given, home, by_place, by_yaw, by_home, residual)


def propagated(
    given: HomeArrays, linear: Linear, mean: np.ndarray, inliers: np.ndarray
) -> tuple[Linear, HomeSolution] | None:
    """Solve for inliers (q,) at the same linearisation point after a small change of the map.

    `mean` (4 + 2 q,) is that of the map before. None when they do not determine home.
    """
    at, by_place, by_yaw = linear[:3]
    residual = linear.residual - _by_map(by_place, by_yaw, given.mean - mean)
    linear = _linear(given, at, by_place, by_yaw, linear.by_home, residual)
    found = solved(given, linear, inliers)
    return None if found is None else (linear, found)


def _by_map(by_place: np.ndarray, by_yaw: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the product (q, ...) of the Jacobian by the state with `columns` (4 + 2 q, ...)."""
    x, y, yaw = by_place[:, 0], by_place[:, 1], by_yaw
    if columns.ndim > 1:
        x, y, yaw = x[:, None], y[:, None], yaw[:, None]
    found = x * columns[POSE_AND_YAW::2] + y * columns[POSE_AND_YAW + 1 :: 2]
    return np.asarray(found + yaw * columns[YAW])


def _linear(
    given: HomeArrays,
    home: np.ndarray,
    by_place: np.ndarray,
    by_yaw: np.ndarray,
    by_home: np.ndarray,
    residual: np.ndarray,
) -> Linear:
    """Return the linearisation with the covariances that follow from it."""
    q, cross_covariance = residual.size, _by_map(by_place, by_yaw, given.covariance)
    columns = np.empty((q, REST.start + q))
    columns[:, HOME], columns[:, RESIDUAL] = by_home, residual
    columns[:, POSE] = cross_covariance[:, :3]
    columns[:, REST] = _by_map(by_place, by_yaw, cross_covariance.T)
    columns.ravel()[REST.start :: REST.start + q + 1] += given.sigmas**2
    return Linear(home, by_place, by_yaw, cross_covariance, columns)


def fit(
    given: HomeArrays, home: np.ndarray, inliers: np.ndarray, steps: int
) -> tuple[Linear, HomeSolution] | None:
    """Fit home (3,) to inlier home bearings (q,), by at most `steps` Gauss-Newton steps.

    None when they do not determine it.
    """
    linear = linearised(given, home, given.mean)
    found = solved(given, linear, inliers)
    for _ in range(steps - 1):
        if found is None or _step_length(given, found.step) < FIT_CONVERGED:
            break
        linear = linearised(given, linear.at + found.step, posterior(given, linear, found))
        found = solved(given, linear, inliers)
    return None if found is None else (linear, found)


def posterior(given: HomeArrays, linear: Linear, found: HomeSolution) -> np.ndarray:
    """Return the posterior of pose, camera yaw and landmarks (4 + 2 q,)."""
    correction = found.weighted[:, RESIDUAL] - found.weighted[:, HOME] @ found.step
    return np.asarray(given.mean + correction @ linear.cross_covariance)


def _step_length(given: HomeArrays, step: np.ndarray) -> float:
    """Return the length of a step of home (3,), over the longest one that is allowed."""
    dx, dy, turn = np.abs(step).tolist()
    return float(max(max(dx, dy) / given.max_step, turn / MAX_HOME_TURN))


def solved(given: HomeArrays, linear: Linear, inliers: np.ndarray) -> HomeSolution | None:
    """Solve the linearised problem for inliers (q,); None when they do not determine home."""
    members, rest, across, asked = _columns_of(inliers.tobytes())
    rows = linear.columns.take(members, axis=0)
    root, failed = dpotrf(rows.take(across, axis=1).T, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    columns = rows.take(asked, axis=1)
    if members.size:  # LAPACK accepts no empty matrix
        columns = dtrtrs(root, columns, lower=1)[0]
    products = columns.T @ columns
    information, slope = given.information + products[HOME, HOME], products[HOME, RESIDUAL]
    square = float(products[RESIDUAL, RESIDUAL])
    if given.prior is not None:
        offset = given.prior_offset(linear.at)
        slope = slope + given.information @ offset
        square += float(offset @ given.information @ offset)
    _, step, failed = dposv(information, slope)
    if failed or not math.isfinite(step @ step) or position_root(information) is None:
        return None
    step = step / max(1.0, _step_length(given, step))
    inverse, log_determinant = inverted(information)
    weighted, alone = np.zeros((inliers.size, 4)), np.empty((inliers.size, 5))
    if members.size:
        weighted[members] = dtrtrs(root, columns[:, : RESIDUAL + 1], lower=1, trans=1)[0]
        alone[members, 4] = 1.0 / dpotri(root, lower=1)[0].diagonal()
        alone[members, :4] = weighted[members] * alone[members, 4:]
    # The set corrects the map, and so predicts the others for a given home.
    alone[rest, :4] = linear.columns[rest, : RESIDUAL + 1] - products[REST, : RESIDUAL + 1]
    alone[rest, 4] = linear.residual_covariance[rest, rest] - products[REST, REST].diagonal()
    by_place, by_set = linear.by_place, weighted[:, HOME]
    walks = np.einsum("ki,kij,kj->k", by_place, given.walk_excess, by_place)
    log_volume = 2.0 * sum(map(math.log, root.diagonal().tolist()))
    square -= float(step @ information @ step)
    log_home = 3.0 * math.log(TWO_PI) - log_determinant
    return HomeSolution(
        step=step,
        information=information,
        inverse=inverse,
        weighted=weighted,
        alone=alone,
        pose=given.mean[:3] + products[POSE, RESIDUAL] - products[POSE, HOME] @ step,
        pose_by_home=products[POSE, HOME],
        pose_covariance=given.covariance[:3, :3] - products[POSE, POSE],
        walk_information=(by_set.T * walks) @ by_set,
        log_density=0.5 * (log_home - square - log_volume - members.size * math.log(TWO_PI)),
    )


@lru_cache(maxsize=64)
def _columns_of(inliers: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the set, the others, and the indices of their covariance and columns in a row."""
    of_set = np.frombuffer(inliers, bool)
    members, rest = of_set.nonzero()[0], (~of_set).nonzero()[0]
    asked = np.concatenate([np.arange(REST.start), REST.start + rest])
    return members, rest, REST.start + members, asked


def inverted(information: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of the information (3, 3) on home, and the latter's log determinant.

    `numpy.linalg.LinAlgError` if home is not determined.
    """
    root, inverse, failed = dposv(information, IDENTITY)
    if failed:
        raise np.linalg.LinAlgError("home is not determined")
    return inverse, 2.0 * math.log(math.prod(root.diagonal().tolist()))


def position_root(information: np.ndarray) -> tuple[float, float, float] | None:
    """Return the Cholesky factor [a, 0; b, c] of the information on home's position.

    It is the Schur complement of the heading in the information (3, 3) on home. None where only
    rounding remains of it, so that the position is not determined.
    """
    (m, n, along), (_, o, across), (_, _, turn) = information.tolist()
    if not turn > 0.0:
        return None
    square = m - along * along / turn
    if not square > ROUNDING * m:
        return None
    a = math.sqrt(square)
    b = (n - along * across / turn) / a
    square = o - across * across / turn - b * b
    return (a, b, math.sqrt(square)) if square > ROUNDING * o else None


def weighed(
    given: HomeArrays, linear: Linear, inliers: np.ndarray, found: HomeSolution
) -> Evidence:
    """Return the evidence of a set of inliers (q,), given its solution."""
    jacobian, residual, alone = found.alone[:, HOME], found.alone[:, RESIDUAL], found.alone[:, 4]
    off = residual - jacobian @ found.step
    by_home = ((jacobian @ found.inverse) * jacobian).sum(axis=1)
    # Home without a member of the set has less information.
    without = 1.0 / np.maximum((1.0 - by_home / alone) / alone, 1e-9)
    # Where the landmarks have a large common error, variances are differences of far larger terms.
    variance = np.maximum(np.where(inliers, without, alone + by_home), given.sigmas**2)
    innovation = np.where(inliers, off / alone * variance, wrap(off))
    right, wrong = log_inlier(innovation, variance), log_outlier(innovation, variance)
    more = _log_moved(given, linear.at, innovation, variance, wrong)
    labels = inliers ^ np.eye(1 + inliers.size, dtype=bool)[:, 1:]
    log_prior = log_labels(given.members, given.one_body, labels, given.moved_prior, more)
    gain = np.where(inliers, log_prior[0] - log_prior[1:], log_prior[1:] - log_prior[0])
    log_evidence = found.log_density + log_prior[0] + wrong[~inliers].sum()
    return Evidence(innovation, variance, gain + right - wrong, float(log_evidence))


def _log_moved(
    given: HomeArrays,
    home: np.ndarray,
    off: np.ndarray,
    variance: np.ndarray,
    wrong: np.ndarray,
) -> np.ndarray:
    """Return the log density of each body that moved, less that of its members as outliers, (b,).

    Bearings of one body are off by the same angle, but for its rotation. `off`, `variance` and
    `wrong` (q,) are innovations, their variances, and their log densities as outliers.
    """
    if not len(given.members):
        return np.zeros(0)
    body, each = given.members.nonzero()
    lead = given.members.argmax(axis=1)[body]
    body, each, lead = (column[each != lead] for column in (body, each, lead))
    places = given.mean[POSE_AND_YAW:].reshape(-1, 2)
    apart, away = places[each] - places[lead], places[lead] - home[:2]
    turned = (apart**2).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1e-12)
    both = turned + variance[each] + variance[lead]
    density = log_inlier(wrap(off[each] - off[lead]), both) - wrong[each]
    return np.bincount(body, density, len(given.members))
