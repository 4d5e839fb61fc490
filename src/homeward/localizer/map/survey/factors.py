"""Survey and home factors: positions and distances of landmarks, and their bearings from home.

A survey in its own frame is a rigid body whose pose in the map, the datum, is unknown: for given
landmarks it follows by weighted least squares (Procrustes; a 2-D Helmert transformation without
scale), and is eliminated.

Home factors, bearings of landmarks that home saw, close the loop where a robot comes home after a
long way, on which the map has bent by more than bearings are linear. Home bearings may turn out to
be wrong, so they are never marginalised; home's hypotheses are tested on the map without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import between, composition, lever, rotation, sight
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD, NC
from homeward.localizer.reference.factors import NormalEquations
from homeward.localizer.tunables import (
    CENTRE_CONVERGED,
    CLOSE_STEPS,
    HOME_ROUNDING,
    MINIMAL,
    ONE_PLACE,
)


class Datum(NamedTuple):
    """Datum: pose of a survey in the map by k landmarks, linear in their positions."""

    pose: np.ndarray
    """(3,): pose of its frame."""
    residual: np.ndarray
    """(k, 2): residuals of the landmarks, mapped less surveyed [m]."""
    by_pose: np.ndarray
    """(2 k, 3): Jacobian of the surveyed positions by the pose."""
    by_places: np.ndarray
    """(3, 2 k): Jacobian of the pose by the mapped positions."""
    covariance: np.ndarray
    """(3, 3): covariance of the pose for exact mapped positions."""
    weights: np.ndarray
    """(2 k, 2 k): inverse of the covariance of the surveyed positions, in their frame."""
    weighted: np.ndarray
    """(2 k, 3): `by_pose`, multiplied by the weights in the map's frame."""

    @property
    def information(self) -> np.ndarray:
        """(2 k, 2 k): information on the mapped positions, the datum being eliminated."""
        rotate = rotation(self.pose[2])[:2, :2]
        return np.asarray(rotated(self.weights, rotate) - self.weighted @ self.by_places)


def align(
    mapped: np.ndarray,
    surveyed: np.ndarray,
    covariance: np.ndarray,
    weights: np.ndarray | None = None,
) -> Datum:
    """Align a survey with the map by the rigid motion that fits best.

    In closed form for independent coordinates, then by Gauss-Newton with their full covariance.
    `mapped` and `surveyed` (k, 2) [m] are positions of the same landmarks, at least two, in the map
    and in the survey's frame; `covariance` (2 k, 2 k) is of the latter, and `weights` its inverse,
    if known. A step is computed in the survey's frame, where the weights are constant.
    """
    weights = np.linalg.inv(covariance) if weights is None else weights
    independent = 2.0 / covariance.diagonal().reshape(-1, 2).sum(axis=1)
    p, q = (np.ascontiguousarray(a).view(complex)[:, 0] for a in (mapped, surveyed))
    p0, q0 = (np.average(a, weights=independent) for a in (p, q))
    turn = np.exp(1j * np.angle((independent * (p - p0) * (q - q0).conj()).sum()))
    origin = p0 - turn * q0
    pose, step = np.array([origin.real, origin.imag, np.angle(turn)]), np.zeros(3)
    for _ in range(CLOSE_STEPS):
        pose = pose + step
        rotate = rotation(pose[2])[:2, :2]
        out = surveyed @ rotate.T
        by_pose, residual = lever(out)[:, :2], mapped - pose[:2] - out
        local = (rotate.T @ by_pose).reshape(-1, 3)
        weighted = weights @ local
        of_pose = np.linalg.inv(local.T @ weighted + np.diag([0.0, 0.0, ONE_PLACE]))
        step = of_pose @ (weighted.T @ (residual @ rotate).ravel())
    weighted = (rotate @ weighted.reshape(-1, 2, 3)).reshape(-1, 3)
    by_places = of_pose @ weighted.T
    return Datum(pose, residual, by_pose.reshape(-1, 3), by_places, of_pose, weights, weighted)


def rotated(matrix: np.ndarray, rotate: np.ndarray) -> np.ndarray:
    """Return a matrix (2 k, 2 k) on positions, in a rotated frame."""
    n = len(matrix)
    rows = rotate @ matrix.reshape(-1, 2, n)
    return np.asarray((rows.reshape(-1, 2) @ rotate.T).reshape(n, n))


@dataclass(frozen=True)
class SurveyFactors:
    """Inliers of the survey: positions of k landmarks, and m distances."""

    ids: np.ndarray
    """(k,): ids of the landmarks in the smoother; none, or at least two."""
    places: np.ndarray
    """(k, 2): positions in the frame of the survey [m]."""
    covariance: np.ndarray
    """(2 k, 2 k): covariance of their coordinates [m^2]."""
    pairs: np.ndarray
    """(m, 2): ids of the landmarks whose distance is known."""
    distances: np.ndarray
    """(m,) [m]"""
    distance_sigmas: np.ndarray
    """(m,) [m]"""

    @property
    def is_given(self) -> bool:
        """Whether there are any."""
        return bool(self.ids.size or self.distances.size)

    def datum(self, positions: np.ndarray, index: np.ndarray) -> Datum:
        """Return the datum by positions (n, 2) of a state, those of `ids` at `index` (k,)."""
        return align(positions[index], self.places, self.covariance, self._weights)

    @cached_property
    def _weights(self) -> np.ndarray:
        return np.linalg.inv(self.covariance)

    def add_to(self, e: NormalEquations, positions: np.ndarray, ids: np.ndarray) -> None:
        """Add them to normal equations of poses, calibration and n landmarks.

        `positions` (n, 2) and `ids` (n,), ascending, are of the landmarks.
        """
        if self.ids.size:
            index = np.searchsorted(ids, self.ids)
            datum, at = self.datum(positions, index), columns(index)
            e.common[np.ix_(at, at)] += datum.information
            e.common_slope[at] -= datum.information @ datum.residual.ravel()
        for pair, distance, sigma in zip(
            np.searchsorted(ids, self.pairs), self.distances, self.distance_sigmas, strict=True
        ):
            at, (apart, along) = columns(pair), distance_and_jacobian(positions[pair])
            e.common[np.ix_(at, at)] += np.outer(along, along) / sigma**2
            e.common_slope[at] += along * (distance - apart) / sigma**2

    def among(self, ids: np.ndarray) -> SurveyFactors:
        """Return the factors of landmarks that are still in the smoother."""
        k, m = np.isin(self.ids, ids), np.isin(self.pairs, ids).all(axis=1)
        k &= k.sum() >= 2
        pairs, distances, sigmas = self.pairs[m], self.distances[m], self.distance_sigmas[m]
        some = self.only(k.nonzero()[0])
        return replace(some, pairs=pairs, distances=distances, distance_sigmas=sigmas)

    def only(self, places: np.ndarray) -> SurveyFactors:
        """Return the factors of some places, by their indices (j,), and of all distances."""
        at = coordinates(places)
        covariance = self.covariance[np.ix_(at, at)]
        return replace(
            self, ids=self.ids[places], places=self.places[places], covariance=covariance
        )

    @staticmethod
    def none() -> SurveyFactors:
        """Return no factors."""
        nothing, two = np.zeros(0), np.zeros((0, 2))
        none = nothing.astype(int), two, np.zeros((0, 0))
        return SurveyFactors(*none, two.astype(int), nothing, nothing)


def in_survey_frame(state: Marginal, factors: SurveyFactors, ids: np.ndarray) -> Marginal:
    """Return a state of the map in the frame of the survey, with the uncertainty of the datum.

    At least two landmarks are surveyed; `ids` (n,) are those of the state's, ascending.
    """
    index = np.searchsorted(ids, factors.ids)
    datum = factors.datum(state.positions, index)
    points = np.zeros((1 + len(ids), 3))
    points[0], points[1:, :2] = state.mean[:3], state.positions
    transformed = between(datum.pose, points)
    back = rotation(datum.pose[2]).T
    mean, jacobian = state.mean.copy(), np.eye(state.mean.size)
    mean[:3], mean[HEAD:] = transformed[0], transformed[1:, :2].ravel()
    by_datum = np.zeros((state.mean.size, 3))
    by_datum[:3] = -back @ lever(points[0] - datum.pose)
    by_datum[HEAD:] = (-back @ lever(points[1:] - datum.pose))[:, :2].reshape(-1, 3)
    jacobian[:3, :3] = back
    at = np.arange(HEAD, mean.size).reshape(-1, 2)
    jacobian[at[:, :, None], at[:, None, :]] = back[:2, :2]
    jacobian[:, 3 + columns(index)] += by_datum @ datum.by_places
    covariance = jacobian @ state.covariance @ jacobian.T
    covariance += by_datum @ datum.covariance @ by_datum.T
    return Marginal(mean, 0.5 * (covariance + covariance.T))


def columns(index: np.ndarray) -> np.ndarray:
    """Return the indices of landmarks (k,) among the shared unknowns, (2 k,)."""
    return NC + coordinates(index)


def coordinates(index: np.ndarray) -> np.ndarray:
    """Return the indices of the coordinates of landmarks (k,), (2 k,)."""
    return np.asarray((2 * index[:, None] + np.arange(2)).ravel())


def distance_and_jacobian(two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (...) of two positions (..., 2, 2), and the Jacobians by them, (..., 4)."""
    off = two[..., 1, :] - two[..., 0, :]
    apart = np.maximum(np.hypot(off[..., 0], off[..., 1]), 1e-6)
    return apart, np.concatenate([-off, off], axis=-1) / apart[..., None]


class HomeFactors(NamedTuple):
    """Home bearings of m landmarks, from a camera whose pose is unknown."""

    ids: np.ndarray
    """(m,): ids of the landmarks in the smoother."""
    bearings: np.ndarray
    """(m,): from the camera's axis [rad]."""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad]."""
    camera: np.ndarray
    """(3,): about the pose of the camera, in the odometry frame."""
    offsets: np.ndarray
    """(m, 3): poses of the bearings' cameras in the frame of that one."""

    def among(self, ids: np.ndarray) -> HomeFactors | None:
        """Return those of landmarks in a state; None if they do not constrain these."""
        kept = np.isin(self.ids, ids)
        if kept.sum() <= MINIMAL:
            return None
        ids, bearings, sigmas = self.ids[kept], self.bearings[kept], self.sigmas[kept]
        return HomeFactors(ids, bearings, sigmas, self.camera, self.offsets[kept])

    def linear(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the Jacobian of the landmarks (2 m, m - 3), and the residuals (m - 3,).

        Both are normalised, and the camera's pose is eliminated; the third value is that pose,
        (3,). `places` (m, 2) [m].
        """
        camera = self.camera
        for _ in range(CLOSE_STEPS):
            eyes, by_camera, _ = composition(camera, self.offsets)
            seen = sight(eyes, places)
            residual = wrap(self.bearings - seen.bearing) / self.sigmas
            by_eye = np.column_stack([-seen.by_place, -np.ones(len(places))])
            by_camera = (by_eye[:, None] @ by_camera)[:, 0] / self.sigmas[:, None]
            step = np.linalg.lstsq(by_camera, residual)[0]
            camera = camera + step
            if np.abs(by_camera @ step).max() < CENTRE_CONVERGED:
                break
        rest = np.linalg.qr(by_camera, mode="complete")[0][:, 3:]
        by_place = seen.by_place / self.sigmas[:, None]
        jacobian = (by_place[:, :, None] * rest[:, None]).reshape(-1, rest.shape[1])
        return jacobian, rest.T @ residual, camera

    def add_to(
        self, e: NormalEquations, positions: np.ndarray, ids: np.ndarray
    ) -> tuple[HomeInformation, HomeFactors]:
        """Add them to normal equations of poses, calibration and n landmarks.

        `positions` (n, 2) and `ids` (n,), ascending, are of the landmarks. Returns the addition,
        and the factors with the camera where these landmarks have it.
        """
        places = positions[np.searchsorted(ids, self.ids)]
        jacobian, residual, camera = self.linear(places)
        added = HomeInformation(self.ids, jacobian, residual + jacobian.T @ places.ravel())
        at = added.columns(ids, NC)
        e.common[np.ix_(at, at)] += jacobian @ jacobian.T
        e.common_slope[at] += jacobian @ residual
        return added, self._replace(camera=camera)


class HomeInformation(NamedTuple):
    """Home factors, linearised: k measurements of m landmarks, independent with unit variance."""

    ids: np.ndarray
    """(m,): ids of the landmarks in the smoother."""
    jacobian: np.ndarray
    """(2 m, k): Jacobian by their positions, transposed [1/m]."""
    measured: np.ndarray
    """(k,): their measured linear combinations [1]."""

    def columns(self, ids: np.ndarray, first: int) -> np.ndarray:
        """Return the columns (2 m,) of the landmarks, those of `ids` (n,) being from `first` on."""
        order = ids.argsort()
        index = order[ids.searchsorted(self.ids, sorter=order)]
        return (first + 2 * index[:, None] + np.arange(2)).ravel()

    def removed_from(self, state: Marginal, ids: np.ndarray) -> Marginal:
        """Return a state without it that was solved with it; `ids` (n,) are its landmarks."""
        if not np.isin(self.ids, ids).all():
            return state
        at = self.columns(ids, HEAD)
        gain = state.covariance[:, at] @ self.jacobian
        shares, axes = np.linalg.eigh(self.jacobian.T @ gain[at])
        gain = gain @ (axes / np.sqrt(np.maximum(1.0 - shares, HOME_ROUNDING)))
        covariance = state.covariance + gain @ gain.T
        residual = self.measured - self.jacobian.T @ state.mean[at]
        step = covariance[:, at] @ (self.jacobian @ residual)
        return Marginal(state.mean - step, covariance)
