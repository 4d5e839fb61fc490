"""Robust least squares: weights, loss and schedule of graduated non-convexity.

Graduated non-convexity (Blake and Zisserman, 1987; Yang et al., 2020) begins with a loss that is
convex, since all errors are expected to be large, and ends with the robust one: Geman and
McClure's, by which outliers lose their weight.
"""

from __future__ import annotations

import numpy as np

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian errors over the median of their sizes [1]."""
GNC_SCHEDULE = 1.0, 0.5, 0.25, 0.1, 0.0, 0.0
"""Graduated non-convexity: by step, the share of its error a priori that the first guess is
expected to have in addition to the noise [1]."""


def robust_weight(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's weights of squared residuals, each over its scale squared."""
    return np.asarray((1.0 + squares) ** -2)


def robust_loss(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's losses of squared residuals, each over its scale squared."""
    return np.asarray(squares / (1.0 + squares))
