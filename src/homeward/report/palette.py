"""The colours, and the mark of home, that all pictures and pages share."""

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
