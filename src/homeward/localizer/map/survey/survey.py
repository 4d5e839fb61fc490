"""Survey of landmarks: prior knowledge of positions and distances, and its inliers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from homeward.drives.settings import KnownLandmarks
from homeward.io.table import quoted
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import outlier_probabilities
from homeward.localizer.map.survey.factors import SurveyFactors
from homeward.localizer.motion.preintegration import SPEED_SCALE
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import MAX_TESTED


class Survey:
    """Prior knowledge of landmarks, and which of it agrees with the map.

    Parameters
    ----------
    known : KnownLandmarks
        As given by the user.
    settings : LocalizerSettings
        `moved_prior` is the prior probability of an outlier, `sure` the posterior probability
        that an inlier needs.
    """

    def __init__(self, known: KnownLandmarks, settings: LocalizerSettings) -> None:
        self.known, self._prior, self._sure = known, settings.moved_prior, settings.sure
        self._index = {name: i for i, name in enumerate(known.landmarks)}
        self._covariance = known.joint_covariance
        places = np.array([(s.x, s.y) for s in known.landmarks.values()]).reshape(-1, 2)
        if known.frame == "own" and places.size:
            places = places - places.mean(axis=0)  # large grid coordinates would cost precision
        self.places = dict(zip(known.landmarks, places, strict=True))
        """Positions by landmark, (2,) in the frame of the survey [m]."""
        apart = [d.distance for d in known.distances]
        self.size = float(max(np.ptp(places, axis=0).max() if places.size else 0.0, *apart, 1e-3))
        """Size of the site [m]."""
        self.wrong: dict[str, float] = {}
        """Probability that a landmark is not at its surveyed position, if tested ..."""
        self.wrong_distances: dict[int, float] = {}
        """... and that a distance, by its index in the list, is wrong."""
        self.used: list[str] = []
        """Inliers among the surveyed landmarks."""

    def evaluate(
        self, free: Marginal, numbers: Mapping[str, int], ids: np.ndarray
    ) -> SurveyFactors:
        """Test the survey against the map without it; return the factors of certain inliers.

        Parameters
        ----------
        free : Marginal
            The map without it.
        numbers : mapping of str to int
            Ids of the mapped landmarks by name, at their first positions.
        ids : ndarray, shape (n,)
            All ids of the map, ascending.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the map is too uncertain for a test; then nothing is changed.
        """
        names = [n for n in self.places if n in numbers][:MAX_TESTED]  # the oldest ones
        names = names if len(names) >= 2 else []
        pairs = [i for i, d in enumerate(self.known.distances) if {*d.between} <= {*numbers}]
        if not names and not pairs:
            self.wrong, self.wrong_distances, self.used = {}, {}, []
            return SurveyFactors.none()
        factors, k = self.factors(names, pairs, numbers), len(names)
        prior = [1.0 - self.p_stayed(n) for n in names] + [self._prior] * len(pairs)
        wrong = outlier_probabilities(factors, free, ids, np.array(prior), self.size)
        self.wrong = dict(zip(names, wrong[:k].tolist(), strict=True))
        self.wrong_distances = dict(zip(pairs, wrong[k:].tolist(), strict=True))
        used = [n for n in names if self.wrong[n] <= 1.0 - self._sure]
        self.used = used if len(used) >= 2 else []
        right = [i for i in pairs if self.wrong_distances[i] <= 1.0 - self._sure]
        return self.factors(self.used, right, numbers)

    def factors(
        self, names: list[str], pairs: list[int], numbers: Mapping[str, int]
    ) -> SurveyFactors:
        """Return the factors of surveyed landmarks, and of distances by their index in the list."""
        known, apart = self.known, [self.known.distances[i] for i in pairs]
        return SurveyFactors(
            np.array([numbers[n] for n in names], int),
            np.array([self.places[n] for n in names]).reshape(-1, 2),
            self.covariance_of(names),
            np.array([[numbers[n] for n in d.between] for d in apart], int).reshape(-1, 2),
            np.array([d.distance for d in apart]),
            np.array([d.sigma or known.sigma for d in apart]),
        )

    def p_stayed(self, name: str) -> float:
        """Return the prior probability that a landmark is still where it was surveyed."""
        given = self.known.landmarks[name].stays
        return 1.0 - self._prior if given is None else given

    def covariance_of(self, names: list[str]) -> np.ndarray:
        """Return the covariance of surveyed coordinates, (2 k, 2 k) [m^2]."""
        at = np.array([[2 * self._index[n], 2 * self._index[n] + 1] for n in names], int).ravel()
        return np.asarray(self._covariance[np.ix_(at, at)])

    def notes(self, state: Marginal) -> tuple[str, ...]:
        """Return notes for the user, the map being in `state`."""
        speed, sigma = state.calibration[SPEED_SCALE], state.calibration_variances[SPEED_SCALE]
        words = ["Speed scale estimated from the known landmarks: true speeds are"]
        words[0] += f" {1.0 + speed:.3f} +- {math.sqrt(sigma):.3f} x those of odometry."
        if self.places:
            off = ", ".join(quoted(n) for n, p in self.wrong.items() if p > 0.5)
            words.append(f"{len(self.used)} of {len(self.places)} surveyed landmarks agree")
            words[-1] += f"; not at the surveyed position: {off}" if off else ""
            words[-1] += ". Correct or remove them in landmarks.yaml." if off else "."
        for i in (i for i, p in self.wrong_distances.items() if p > 0.5):
            a, b = map(quoted, self.known.distances[i].between)
            given = f"{self.known.distances[i].distance:g} m"
            words.append(f"{a} and {b} are not {given} apart. Correct it in landmarks.yaml.")
        return tuple(words)
