"""Colours and the symbol of home, shared by all figures and pages."""

from __future__ import annotations

import numpy as np

from homeward.estimator import Status

# Okabe and Ito's palette, distinguishable for colour-blind readers.
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
"""Outline of the symbol of home."""
LEVELS = 10
"""Number of steps in which probabilities are drawn."""
UNTESTED = -1
"""Level of a landmark that the estimator does not test."""


def colour(level: int) -> str:
    """Return the colour of a level of the probability of having moved."""
    if level == UNTESTED:
        return MUTED
    share = level / LEVELS
    mixed = (
        round((1 - share) * int(BLUE[i : i + 2], 16) + share * int(MOVED[i : i + 2], 16))
        for i in (1, 3, 5)
    )
    return "#" + "".join(f"{part:02x}" for part in mixed)


def levels(chances: np.ndarray) -> np.ndarray:
    """Return the level of each probability, or `UNTESTED` where it is NaN."""
    tested = np.isfinite(chances)
    return np.where(tested, np.round(LEVELS * np.nan_to_num(chances)), UNTESTED).astype(int)


LEVEL_COLOURS = [colour(level) for level in range(LEVELS + 1)]
