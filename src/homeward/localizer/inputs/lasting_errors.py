"""Time-correlated bearing errors: how much of them lasts, and for how long (Gauss-Markov process).

Errors of a camera's bearings are not white: a detector does not hit a landmark's axis, and misses
it alike from the next place. Who counts each sighting as new believes them too much: the map
shrinks until odometry gives way, and poses are too sure. So the autocorrelation of what the map
leaves of bearings is followed, as that of a first-order process beside white noise, and a sighting
counts the less the sooner it follows the last one of its landmark.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.localizer.tunables import GATE

LAGS_S = np.array([0.02, 0.15, 0.4, 1.0, 2.5, 6.0, 15.0])
"""Pairs of sightings are sorted by the time between them, into classes with these ends [s]."""
TIMES_S = np.geomspace(0.1, 20.0, 24)
"""How long errors may last [s]."""
STEPS = (1, 2, 3, 5, 8, 13, 21, 34, 55)
"""Each sighting is paired with the so many-th after it, of the same landmark."""
PAIRS = 40
"""So many pairs are needed to tell the correlation of a class."""
RARE_S = 0.5
"""They are worth telling where a sighting so long after the last one counts for half [s]."""
LEAST_GAP_S = 1e-3
"""Sightings of one landmark are not nearer to each other than that [s]."""


class LastingErrors:
    """First-order Gauss-Markov part of bearing errors, alike for all landmarks; none at first."""

    def __init__(self) -> None:
        self.share = 0.0
        """Its variance, over that which is believed of a single bearing [1]."""
        self.time = 1.0
        """After which it is down to 1 / e [s]."""
        self._correlations = np.full(len(LAGS_S) - 1, np.nan)

    def excess(self, gaps: np.ndarray) -> np.ndarray:
        """Return what sightings lose by not being new, as variance over that of a single one [1].

        The mean of n samples, a gap apart, of a process of variance s has the variance
        s / n coth(gap / 2 time): so each counts as one of white noise with n times that.

        Parameters
        ----------
        gaps : ndarray, shape (m,)
            Since the last sighting of the same landmark [s]; infinite for the first.
        """
        gaps = np.maximum(gaps, LEAST_GAP_S)
        return np.asarray(self.share * (1.0 / np.tanh(gaps / (2.0 * self.time)) - 1.0))

    def words(self, sigma: float) -> tuple[str, ...]:
        """Return what the user should know of it, where the deviation of a bearing is so [rad]."""
        if self.excess(np.array([RARE_S]))[0] < 1.0:
            return ()
        slow = math.degrees(sigma * math.sqrt(self.share))
        return (f"Errors of {slow:.1f} deg in the bearings last for some {self.time:.1f} s.",)

    def update(
        self, errors: np.ndarray, gaps: np.ndarray, landmarks: np.ndarray, weight: float
    ) -> None:
        """Follow the autocorrelation of errors.

        Parameters
        ----------
        errors : ndarray, shape (m,)
            Of sightings in order of time, over their standard deviations [1]; NaN: unknown.
        gaps : ndarray, shape (m,)
            As of `excess`, since the one before it in here.
        landmarks : ndarray, shape (m,)
            Which landmark each is of.
        weight : float
            Of these against what was learnt before [1].
        """
        order = np.argsort(landmarks, kind="stable")
        errors, landmarks = np.clip(errors, -GATE, GATE)[order], landmarks[order]
        t = np.cumsum(np.where(np.isfinite(gaps[order]), gaps[order], LAGS_S[-1]))
        lags, products = [], []
        for step in STEPS:
            same = landmarks[step:] == landmarks[:-step]
            lags.append((t[step:] - t[:-step])[same])
            products.append((errors[step:] * errors[:-step])[same])
        of_class = np.searchsorted(LAGS_S, np.concatenate(lags), side="right") - 1
        product = np.concatenate(products)
        use = (of_class >= 0) & (of_class < len(LAGS_S) - 1) & np.isfinite(product)
        of_class, product = of_class[use], product[use]
        pairs = np.bincount(of_class, minlength=len(LAGS_S) - 1)
        sums = np.bincount(of_class, product, minlength=len(LAGS_S) - 1)
        told = pairs >= PAIRS
        before = np.nan_to_num(self._correlations[told])
        self._correlations[told] = before + weight * (sums[told] / pairs[told] - before)
        self._fit()

    def _fit(self) -> None:
        """Fit an exponential to the correlations, by least squares."""
        known = np.isfinite(self._correlations)
        if not known.any():
            return
        middle = np.sqrt(LAGS_S[:-1] * LAGS_S[1:])[known]
        shapes = np.exp(-middle / TIMES_S[:, None])
        shares = np.clip(shapes @ self._correlations[known] / (shapes**2).sum(axis=1), 0.0, 1.0)
        off = ((shares[:, None] * shapes - self._correlations[known]) ** 2).sum(axis=1)
        best = int(off.argmin())
        self.share, self.time = float(shares[best]), float(TIMES_S[best])
