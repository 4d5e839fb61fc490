"""The colour of a probability: from in place to moved, in few steps."""

from __future__ import annotations

import numpy as np

from homeward.report.palette import BLUE, MOVED, MUTED

LEVELS = 10
"""Probabilities are told apart in so many steps."""
UNJUDGED = -1
"""The level of what an estimator does not judge."""


def colour(level: int) -> str:
    """Return the colour of a probability of `level` in `LEVELS` of having moved."""
    if level == UNJUDGED:
        return MUTED
    share = level / LEVELS
    mixed = (
        round((1 - share) * int(BLUE[i : i + 2], 16) + share * int(MOVED[i : i + 2], 16))
        for i in (1, 3, 5)
    )
    return "#" + "".join(f"{part:02x}" for part in mixed)


def levels(chances: np.ndarray) -> np.ndarray:
    """Return the level of each probability, or `UNJUDGED` where it is NaN."""
    judged = np.isfinite(chances)
    return np.where(judged, np.round(LEVELS * np.nan_to_num(chances)), UNJUDGED).astype(int)


COLOURS = [colour(level) for level in range(LEVELS + 1)]
