"""Robust least squares: weights, loss and schedule of graduated non-convexity.

Graduated non-convexity (Blake and Zisserman, 1987; Yang et al., 2020) begins with a convex loss,
since the first guess has large errors, and ends with the robust loss of Geman and McClure, under
which outliers lose their weight.
"""

from __future__ import annotations

import numpy as np

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian errors divided by the median of their absolute values [1]."""
GNC_SCHEDULE = 1.0, 0.5, 0.25, 0.1, 0.0, 0.0
"""For each step of graduated non-convexity, the share of the first guess's a-priori error that is
added to the noise [1]."""


def robust_weight(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's weights of squared residuals, divided by their squared scale."""
    return np.asarray((1.0 + squares) ** -2)


def robust_loss(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's losses of squared residuals, divided by their squared scale."""
    return np.asarray(squares / (1.0 + squares))
