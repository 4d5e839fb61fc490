"""Time-correlated bearing errors: a first-order Gauss-Markov process plus white noise.

A detector misses a landmark's axis alike from one place and the next. Treating each sighting as
independent overweights bearings: the map shrinks until odometry gives way, and poses are too
certain. So the autocorrelation of the residuals is estimated, and a sighting counts less the sooner
it follows the previous one of its landmark.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.localizer.tunables import (
    CORRELATION_TIMES_S,
    GATE,
    LAG_BOUNDS_S,
    MIN_GAP_S,
    MIN_PAIRS,
    NOTABLE_GAP_S,
    PAIR_STEPS,
)


class CorrelatedErrors:
    """First-order Gauss-Markov part of the bearing errors, the same for all landmarks."""

    def __init__(self) -> None:
        self.share = 0.0
        """Its variance over that of a single bearing [1]."""
        self.correlation_time = 1.0
        """Time after which the autocorrelation is down to 1 / e [s]."""
        self._correlations = np.full(len(LAG_BOUNDS_S) - 1, np.nan)

    def excess(self, gaps: np.ndarray) -> np.ndarray:
        """Return the excess variance of correlated sightings, over that of a single one [1].

        The mean of n samples, a gap apart, of a process of variance s has the variance s / n
        coth(gap / 2 time): so each counts as one of white noise with n times that. `gaps` (m,) are
        times since the last sighting of the same landmark [s], infinite for the first.
        """
        gaps = np.maximum(gaps, MIN_GAP_S)
        return np.asarray(self.share * (1.0 / np.tanh(gaps / (2.0 * self.correlation_time)) - 1.0))

    def notes(self, sigma: float) -> tuple[str, ...]:
        """Return a note for the user where correlation is notable; `sigma` is a bearing's [rad]."""
        if self.excess(np.array([NOTABLE_GAP_S]))[0] < 1.0:
            return ()
        slow, time = math.degrees(sigma * math.sqrt(self.share)), self.correlation_time
        return (
            f"Bearing errors of {slow:.1f} deg are correlated over {time:.1f} s, and the covariance"
            " is larger for that. Check the calibration and the stamps of bearings.",
        )

    def update(
        self, errors: np.ndarray, gaps: np.ndarray, landmarks: np.ndarray, weight: float
    ) -> None:
        """Update the autocorrelation of the errors (m,), normalised residuals in order of time.

        NaN: unknown. `gaps` (m,) are those of `excess`, since the one before it in `errors`;
        `landmarks` (m,) the landmark of each; `weight` is that of these against the present
        estimate.
        """
        order = np.argsort(landmarks, kind="stable")
        errors, landmarks = np.clip(errors, -GATE, GATE)[order], landmarks[order]
        t = np.cumsum(np.where(np.isfinite(gaps[order]), gaps[order], LAG_BOUNDS_S[-1]))
        lags, products = [], []
        for step in PAIR_STEPS:
            same = landmarks[step:] == landmarks[:-step]
            lags.append((t[step:] - t[:-step])[same])
            products.append((errors[step:] * errors[:-step])[same])
        of_class = np.searchsorted(LAG_BOUNDS_S, np.concatenate(lags), side="right") - 1
        product = np.concatenate(products)
        use = (of_class >= 0) & (of_class < len(LAG_BOUNDS_S) - 1) & np.isfinite(product)
        of_class, product = of_class[use], product[use]
        pairs = np.bincount(of_class, minlength=len(LAG_BOUNDS_S) - 1)
        sums = np.bincount(of_class, product, minlength=len(LAG_BOUNDS_S) - 1)
        enough = pairs >= MIN_PAIRS
        before = np.nan_to_num(self._correlations[enough])
        self._correlations[enough] = before + weight * (sums[enough] / pairs[enough] - before)
        self._fit()

    def _fit(self) -> None:
        """Fit an exponential to the correlations by least squares."""
        known = np.isfinite(self._correlations)
        if not known.any():
            return
        middle = np.sqrt(LAG_BOUNDS_S[:-1] * LAG_BOUNDS_S[1:])[known]
        shapes = np.exp(-middle / CORRELATION_TIMES_S[:, None])
        shares = np.clip(shapes @ self._correlations[known] / (shapes**2).sum(axis=1), 0.0, 1.0)
        off = ((shares[:, None] * shapes - self._correlations[known]) ** 2).sum(axis=1)
        best = int(off.argmin())
        self.share, self.correlation_time = float(shares[best]), float(CORRELATION_TIMES_S[best])
