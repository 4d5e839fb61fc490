"""The colours, and the mark of home, that all pictures and pages share."""

from __future__ import annotations

import numpy as np

from homeward.estimator import Status

# Okabe and Ito's palette, told apart by colour-blind readers too.
INK = "#22262b"
MUTED = "#8a9097"
RULE = "#e3e6e9"
BLUE = "#0072b2"
SKY = "#56b4e9"
ORANGE = "#e69f00"
VERMILLION = "#d55e00"
GREEN = "#009e73"
CONTENDER_COLOURS = (BLUE, INK, VERMILLION, ORANGE, GREEN, SKY, "#cc79a7", MUTED)

STATUS_COLOURS = {
    Status.WAITING: "#d5d9dd",
    Status.MAPPING: "#aab1b8",
    Status.UNVERIFIED: ORANGE,
    Status.LOCALISED: BLUE,
    Status.COASTING: SKY,
}
MOVED = VERMILLION
HOUSE = [(-1.0, -1.0), (1.0, -1.0), (1.0, 0.25), (0.0, 1.2), (-1.0, 0.25), (-1.0, -1.0)]
"""Home."""
LEVELS = 10
"""Steps in which probabilities are drawn."""
UNJUDGED = -1
"""Level of a landmark that the estimator does not test."""


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


LEVEL_COLOURS = [colour(level) for level in range(LEVELS + 1)]
