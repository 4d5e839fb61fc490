"""Survey of landmarks: what of it agrees with the map, by the evidence of sets.

What is wrong is found before it touches the map: landmarks move after they were surveyed, and
surveys have slips of the pen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import betaln

from homeward.drives.drive import KnownLandmarks
from homeward.drives.text.table import quoted
from homeward.localizer.geometry import lever, rotation
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    apart_along,
    columns,
    turned,
)
from homeward.localizer.motion.preintegration import NC, SPEED_SCALE
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import NEGLIGIBLE, UPHEAVAL

MOST_JUDGED = 48
"""Of so many landmarks at most the survey is used; those that came first."""
MOST_FLIPS = 2 * MOST_JUDGED
"""Steps of a search for what is wrong: of another place it is everything."""
ANYWHERE = 10.0
"""Beforehand the datum is so vague [size of the survey; rad]."""


class Survey:
    """What is known of landmarks beforehand, and what of it agrees with the map.

    Parameters
    ----------
    known : KnownLandmarks
        As the user told it.
    settings : LocalizerSettings
        Of which `moved_prior` is the probability that one of it is wrong, and `sure` that which
        one of it needs to be used.
    """

    def __init__(self, known: KnownLandmarks, settings: LocalizerSettings) -> None:
        self.known, self._prior, self._sure = known, settings.moved_prior, settings.sure
        self._index = {name: i for i, name in enumerate(known.landmarks)}
        self._covariance = known.joint_covariance
        places = np.array([(s.x, s.y) for s in known.landmarks.values()]).reshape(-1, 2)
        if known.frame == "own" and places.size:
            places = places - places.mean(axis=0)  # the map asks nothing of a grid's coordinates
        self.places = dict(zip(known.landmarks, places, strict=True))
        """By landmark, (2,) in the frame of the survey [m]."""
        apart = [d.distance for d in known.distances]
        self.size = float(max(np.ptp(places, axis=0).max() if places.size else 0.0, *apart, 1e-3))
        """About how large the site is [m]."""
        self.wrong: dict[str, float] = {}
        """Probability that a landmark stands elsewhere than the survey says, if judged ..."""
        self.wrong_distances: dict[int, float] = {}
        """... and that a distance, by its place in the list, is wrong."""
        self.used: list[str] = []
        """The surveyed landmarks that are taken for right."""

    def judge(self, free: Marginal, numbers: Mapping[str, int], ids: np.ndarray) -> SurveyFactors:
        """Judge what is known by the map without it; return what is right for sure.

        Parameters
        ----------
        free : Marginal
            The map without it.
        numbers : mapping of str to int
            Ids of the mapped landmarks by name, where they stood first.
        ids : ndarray, shape (n,)
            All of the map, ascending.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the map is too vague to judge by; then nothing is changed.
        """
        names = [n for n in self.places if n in numbers][:MOST_JUDGED]
        names = names if len(names) >= 2 else []
        pairs = [i for i, d in enumerate(self.known.distances) if {*d.between} <= {*numbers}]
        if not names and not pairs:
            self.wrong, self.wrong_distances, self.used = {}, {}, []
            return SurveyFactors.none()
        factors, k = self.factors(names, pairs, numbers), len(names)
        prior = [1.0 - self.stays(n) for n in names] + [self._prior] * len(pairs)
        wrong = wrong_probabilities(factors, free, ids, np.array(prior), self.size)
        self.wrong = dict(zip(names, wrong[:k].tolist(), strict=True))
        self.wrong_distances = dict(zip(pairs, wrong[k:].tolist(), strict=True))
        used = [n for n in names if self.wrong[n] <= 1.0 - self._sure]
        self.used = used if len(used) >= 2 else []
        right = [i for i in pairs if self.wrong_distances[i] <= 1.0 - self._sure]
        return self.factors(self.used, right, numbers)

    def factors(
        self, names: list[str], pairs: list[int], numbers: Mapping[str, int]
    ) -> SurveyFactors:
        """Return the factors of surveyed landmarks, and of distances by their place in the list."""
        known, apart = self.known, [self.known.distances[i] for i in pairs]
        return SurveyFactors(
            np.array([numbers[n] for n in names], int),
            np.array([self.places[n] for n in names]).reshape(-1, 2),
            self.covariance_of(names),
            np.array([[numbers[n] for n in d.between] for d in apart], int).reshape(-1, 2),
            np.array([d.distance for d in apart]),
            np.array([d.sigma or known.sigma for d in apart]),
        )

    def stays(self, name: str) -> float:
        """Return how probable it is beforehand that a landmark stands where it was surveyed."""
        told = self.known.landmarks[name].stays
        return 1.0 - self._prior if told is None else told

    def covariance_of(self, names: list[str]) -> np.ndarray:
        """Return the covariance of the surveyed coordinates of some, (2 k, 2 k) [m^2]."""
        at = np.array([[2 * self._index[n], 2 * self._index[n] + 1] for n in names], int).ravel()
        return np.asarray(self._covariance[np.ix_(at, at)])

    def words(self, state: Marginal) -> tuple[str, ...]:
        """Return what the user must know of it, the map being in a state; sentences."""
        speed, sigma = state.calibration[SPEED_SCALE], state.calibration_variances[SPEED_SCALE]
        words = [f"By the known landmarks, speeds are {1.0 + speed:.3f} +- {math.sqrt(sigma):.3f}"]
        words[0] += " times what odometry says."
        if self.places:
            off = ", ".join(quoted(n) for n, p in self.wrong.items() if p > 0.5)
            words.append(f"{len(self.used)} of {len(self.places)} surveyed landmarks agree")
            words[-1] += f"; not where they were surveyed: {off}." if off else "."
        for i in (i for i, p in self.wrong_distances.items() if p > 0.5):
            a, b = map(quoted, self.known.distances[i].between)
            words.append(f"{a} and {b} are not {self.known.distances[i].distance:g} m apart.")
        return tuple(words)


def wrong_probabilities(
    factors: SurveyFactors, free: Marginal, ids: np.ndarray, prior: np.ndarray, size: float
) -> np.ndarray:
    """Return the probability of each of k places and m distances to be wrong, shape (k + m,).

    Each is right, or wrong and then anywhere on the site. Sets of right ones are weighed by their
    evidence, with which they follow from each other, datum and map being unknown as far as they
    are; a local search from all of them flips the one that gains most, as long as any does.

    Parameters
    ----------
    factors : SurveyFactors
        The places and distances.
    free : Marginal
        The map without any of it.
    ids : ndarray, shape (n,)
        Of the map's landmarks, ascending.
    prior : ndarray, shape (k + m,)
        Of each to be wrong.
    size : float
        Of the site [m].

    Raises
    ------
    numpy.linalg.LinAlgError
        When the map is too vague to judge by.
    """
    index, pairs = np.searchsorted(ids, factors.ids), np.searchsorted(ids, factors.pairs)
    k, m, mapped = index.size, len(pairs), free.positions[index]
    jacobian, off = np.zeros((2 * k + m, free.mean.size - HEAD)), np.zeros(m)
    jacobian[np.arange(2 * k), columns(index) - NC] = 1.0
    for i, pair in enumerate(pairs):
        apart, jacobian[2 * k + i, columns(pair) - NC] = apart_along(free.positions[pair])
        off[i] = apart - factors.distances[i]
    of_map = jacobian @ free.covariance[HEAD:, HEAD:] @ jacobian.T
    of_map[2 * k :, 2 * k :] += np.diag(factors.distance_sigmas**2)
    item = np.concatenate([np.repeat(np.arange(k), 2), k + np.arange(m)])
    log_wrong = -np.bincount(item) * math.log(size)

    def linear(right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what all are off, and its covariance, the datum being free around a set's."""
        if not k:
            return off, of_map
        some = right[:k] if right[:k].sum() >= 2 else np.ones(k, bool)
        of_some = factors.covariance[np.ix_(np.repeat(some, 2), np.repeat(some, 2))]
        pose = align(mapped[some], factors.places[some], of_some).pose
        rotate = rotation(pose[2])[:2, :2]
        out = factors.places @ rotate.T
        vague = np.zeros((len(item), 3))
        vague[: 2 * k] = lever(out)[:, :2].reshape(-1, 3) * (size, size, 1.0)
        known = of_map + ANYWHERE**2 * vague @ vague.T
        known[: 2 * k, : 2 * k] += turned(factors.covariance, rotate)
        residual = (mapped - out - pose[:2]).ravel()
        return np.concatenate([residual, off]), known

    found: dict[bytes, float] = {}
    right = np.ones(k + m, bool)
    for _ in range(MOST_FLIPS):
        before, labels = _log_labels(right, prior)
        evidence, gains = _weigh(right, item, *linear(right), labels - log_wrong)
        evidence += before + float(log_wrong[~right].sum())
        found[right.tobytes()] = evidence
        for i, gain in enumerate(gains.tolist()):
            flipped = right.copy()
            flipped[i] ^= True
            found.setdefault(flipped.tobytes(), evidence + gain)
        i = int(gains.argmax())
        if not gains[i] > 0.0:
            break
        right[i] ^= True
    log = np.array(list(found.values()))
    weights = np.exp(np.maximum(log - log.max(), 2.0 * math.log(NEGLIGIBLE)))
    wrong = ~np.array([np.frombuffer(key, bool) for key in found])
    return np.asarray(weights @ wrong / weights.sum())


def _log_labels(right: np.ndarray, prior: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log probability that just these are right, and the log odds of each of them.

    As a rule each is wrong with a probability of its own (k,); after an upheaval, or in another
    place, any share may be, as of home's bearings (`homeward.localizer.home.outliers`).
    """
    odds = np.log1p(-prior) - np.log(prior)
    rule, number = float(np.where(right, np.log1p(-prior), np.log(prior)).sum()), right.sum()
    step = np.where(right, -1, 1)
    now = _mixed(np.array(rule), number, right.size)
    then = _mixed(rule + step * odds, number + step, right.size)
    return float(now), step * (then - now)


def _mixed(rule: np.ndarray, right: np.ndarray, of: int) -> np.ndarray:
    """Return the log probability by a rule, or by an upheaval, of so many right ones."""
    upheaval = math.log(UPHEAVAL) + betaln(1.0 + right, 1.0 + of - right)
    return np.asarray(np.logaddexp(math.log1p(-UPHEAVAL) + rule, upheaval))


def _weigh(
    right: np.ndarray, item: np.ndarray, z: np.ndarray, covariance: np.ndarray, labels: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log evidence of a set, up to a constant, and what flipping each one gains."""
    at = right[item]
    # By triangular factors: vague as the datum is, what is left of a covariance is small.
    root = np.linalg.cholesky(covariance[np.ix_(at, at)])
    of_set = np.column_stack([np.eye(len(z)), z, covariance])[at]
    whitened = solve_triangular(root, of_set, lower=True)
    left, residual, across = whitened[:, : len(z)], whitened[:, len(z)], whitened[:, len(z) + 1 :]
    inverse, weighted = left.T @ left, left.T @ residual
    off, spread = z - across.T @ residual, covariance - across.T @ across
    odds = labels.copy()
    for i in range(right.size):
        mine = item == i
        if right[i]:  # by the others of the set
            own = np.linalg.inv(inverse[np.ix_(mine, mine)])
            odds[i] += _log_normal(own @ weighted[mine], own)
        else:
            odds[i] += _log_normal(off[mine], spread[np.ix_(mine, mine)])
    log_volume = np.log(root.diagonal()).sum() + 0.5 * at.sum() * math.log(math.tau)
    evidence = float(-0.5 * residual @ residual - log_volume)
    return evidence, np.where(right, -odds, odds)


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of a normal distribution."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off)
    return float(-math.pi * white @ white - np.log(root.diagonal()).sum())
